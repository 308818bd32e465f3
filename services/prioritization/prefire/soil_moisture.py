"""Soil moisture that the satellites saw, brought into relative greenness (WFPI-x).

RG_x = clip(RG [1 + 2 w alpha (s - 1/2)], 0, 1): s is where the soil moisture lies between the cell's own 5 and 95 %
values, w = quality x exp(-age / tau), 0 beyond the satellites' latitudes or where nothing was seen. So w = 0 or s = 1/2
leaves RG as it is, exactly. alpha is positive in the growing season (dry soil, less green) and slightly negative in the
dormant one (moist soil then grew the fuel that is now dry: Krueger et al. 2016); its size is a choice, not a fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from shared.errors import DomainError

Array = npt.NDArray[np.floating[Any]]
Index = npt.NDArray[np.int64]

EASE_X0_M, EASE_Y0_M = -17367530.445161372, 7314540.830638599
EASE_CELL_M: dict[int, float] = {9: 9008.055210146, 36: 36032.220840584}
EASE_SHAPE: dict[int, tuple[int, int]] = {9: (1624, 3856), 36: (406, 964)}
_WGS84_A_M, _WGS84_E = 6378137.0, 0.0818191908426215
_EASE_PARALLEL_DEG = 30.0
SATELLITE_LATITUDE_LIMIT_DEG = 38.5


@dataclass(frozen=True)
class SoilMoistureEffect:
    """Strength of the soil-moisture term: alpha in full growth and in dormancy, days of memory, sd that halves w."""

    alpha_growing: float = 0.6
    alpha_dormant: float = -0.15
    tau_days: float = 4.0
    halving_sd: float = 0.06
    typical_live_share: float = 0.4


def ease_cells(longitude_deg: Array, latitude_deg: Array, resolution_km: int = 9) -> tuple[Index, Index]:
    """Row and column of the global EASE-Grid 2.0 (EPSG:6933) of 9 or 36 km that hold the places (they broadcast).

    Snyder (1987) 3-12 and 10-14, 10-15: the grid is cylindrical, so the column is the longitude's and the row the
    latitude's.
    """
    parallel = np.radians(_EASE_PARALLEL_DEG)
    scale = np.cos(parallel) / np.sqrt(1 - (_WGS84_E * np.sin(parallel)) ** 2)
    sine = np.sin(np.radians(np.asarray(latitude_deg, dtype=np.float64)))
    squeezed = _WGS84_E * sine
    authalic = (1 - _WGS84_E**2) * (sine / (1 - squeezed**2) + np.arctanh(squeezed) / _WGS84_E)
    y_m = _WGS84_A_M * authalic / (2 * scale)
    x_m = _WGS84_A_M * scale * np.radians(np.asarray(longitude_deg, dtype=np.float64))
    cell_m = EASE_CELL_M[resolution_km]
    row = np.floor((EASE_Y0_M - y_m) / cell_m).astype(np.int64)
    column = np.floor((x_m - EASE_X0_M) / cell_m).astype(np.int64)
    return row, column


def growing_season(day_of_year: float, latitude_deg: Array) -> Array:
    """1 at midsummer, 0 at midwinter of the hemisphere (cosine of the day of the year, peak on day 180)."""
    cycle = np.cos(2 * np.pi * (day_of_year - 180) / 365.25)
    return 0.5 * (1 + cycle * np.sign(np.asarray(latitude_deg, dtype=np.float64)))


def alpha(growing: Array, live_load: Array, dead_load: Array, effect: SoilMoistureEffect) -> Array:
    """Strength by season and fuel: between dormant and growing, more where more of the fuel is live."""
    share = live_load / np.maximum(live_load + dead_load, 1e-9)
    fuel = np.clip(share / effect.typical_live_share, 0.5, 1.5)
    return (effect.alpha_dormant + (effect.alpha_growing - effect.alpha_dormant) * growing) * fuel


def position(soil_moisture: Array, q05: Array, q95: Array) -> Array:
    """s in 0..1 between the cell's 5 and 95 % soil moisture; 1/2 (no effect) where any of them is unknown."""
    span = np.where(q95 > q05, q95 - q05, np.nan)
    found = np.clip((soil_moisture - q05) / span, 0, 1)
    return np.where(np.isnan(found), 0.5, found)


def greenness_with_soil_moisture(greenness: Array, weight: Array, alpha: Array, position: Array) -> Array:
    """RG_x in 0..1; RG itself, to the last bit, where the weight is 0 or the position 1/2."""
    return np.clip(greenness * (1 + 2 * weight * alpha * (position - 0.5)), 0, 1)


@dataclass(frozen=True)
class SoilMoistureLayer:
    """Latest soil moisture (m3/m3, NaN where none) and its weight w (0 where none) on a window of the EASE grid."""

    resolution_km: int
    first_row: int
    first_column: int
    soil_moisture: Array
    weight: Array

    def at(self, longitude_deg: Array, latitude_deg: Array, kind: Any) -> tuple[Array, Array]:
        """Soil moisture and weight at places that broadcast to (y, x); weight 0 beyond the satellites' latitudes."""
        row, column = ease_cells(longitude_deg, latitude_deg, self.resolution_km)
        row, column = row - self.first_row, column - self.first_column
        height, width = self.soil_moisture.shape
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        flat = np.where(inside, row * width + column, 0)
        seen = inside & (np.abs(latitude_deg) <= SATELLITE_LATITUDE_LIMIT_DEG)
        soil = np.where(inside, self.soil_moisture.ravel().take(flat), np.nan).astype(kind)
        return soil, np.where(seen, self.weight.ravel().take(flat), 0).astype(kind)


def latest_layer(
    tables: list[pd.DataFrame], time: pd.Timestamp, effect: SoilMoistureEffect, resolution_km: int = 9
) -> SoilMoistureLayer | None:
    """The latest known value of each EASE cell with its weight; None where nothing is known at ``time``.

    ``tables`` follow the soil_moisture contract; rows after ``time`` are not yet known and left out, and so are rows
    without a value or its standard deviation. DomainError for cells or values that no such grid holds.
    """
    if not tables:
        return None
    joined = pd.concat(tables, ignore_index=True)
    joined = joined[(joined["time"] <= time) & (joined["count"] > 0)].dropna(
        subset=["soil_moisture", "soil_moisture_sd"]
    )
    if joined.empty:
        return None
    _check(joined, resolution_km)
    latest = joined.sort_values(["time", "soil_moisture_sd"], ascending=[True, False], kind="stable").drop_duplicates(
        ["row", "column"], keep="last"
    )
    row, column = latest["row"].to_numpy(np.int64), latest["column"].to_numpy(np.int64)
    first = int(row.min()), int(column.min())
    shape = int(row.max()) - first[0] + 1, int(column.max()) - first[1] + 1
    soil, weight = np.full(shape, np.nan), np.zeros(shape)
    age_days = (time - latest["time"]).dt.total_seconds().to_numpy() / 86400
    quality = 1 / (1 + (latest["soil_moisture_sd"].to_numpy() / effect.halving_sd) ** 2)
    soil[row - first[0], column - first[1]] = latest["soil_moisture"].to_numpy()
    weight[row - first[0], column - first[1]] = quality * np.exp(-age_days / effect.tau_days)
    return SoilMoistureLayer(resolution_km, *first, soil, weight)


def _check(table: pd.DataFrame, resolution_km: int) -> None:
    rows, columns = EASE_SHAPE[resolution_km]
    off = ~table["row"].between(0, rows - 1) | ~table["column"].between(0, columns - 1)
    if off.any():
        cell = table.loc[off, ["row", "column"]].iloc[0].tolist()
        raise DomainError(
            f"The soil moisture table holds cell {cell}, which the {resolution_km} km EASE grid lacks.",
            field="soil_moisture",
            value=cell,
            accepted=f"rows 0..{rows - 1}, columns 0..{columns - 1}; see soil_moisture_resolution_km",
        )
    impossible = ~table["soil_moisture"].between(0, 1) | (table["soil_moisture_sd"] < 0)
    if impossible.any():
        worst = table.loc[impossible, ["soil_moisture", "soil_moisture_sd"]].iloc[0].tolist()
        raise DomainError(
            f"The soil moisture table holds {worst[0]:g} with standard deviation {worst[1]:g}.",
            field="soil_moisture",
            value=worst[0],
            accepted="0..1 m3/m3, standard deviation 0 or more",
        )
