"""What the satellites saw of the land, brought into the danger grid: soil moisture (WFPI-x) and fresh burn scars.

RG_x = clip(RG [1 + 2 w alpha (s - 1/2)], 0, 1): s is where the soil moisture lies between the cell's own 5 and 95 %
values, w = quality x exp(-age / tau), 0 beyond the satellites' latitudes or where nothing was seen. So w = 0 or s = 1/2
leaves RG as it is, exactly. alpha is positive in the growing season (dry soil, less green) and slightly negative in the
dormant one (moist soil then grew the fuel that is now dry: Krueger et al. 2016); its size is a choice, not a fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.prefire import burn_evidence

Array = npt.NDArray[np.float64]

EASE_X0_M, EASE_Y0_M = -17367530.445161372, 7314540.830638599
EASE_CELL_M: dict[int, float] = {9: 9008.055210146, 36: 36032.220840584}
SATELLITE_LATITUDE_LIMIT_DEG = 38.5


@dataclass(frozen=True)
class SoilMoistureEffect:
    """Strength of the soil-moisture term: alpha in full growth and in dormancy, days of memory, sd that halves w."""

    alpha_growing: float = 0.6
    alpha_dormant: float = -0.15
    tau_days: float = 4.0
    halving_sd: float = 0.06
    typical_live_share: float = 0.4


@dataclass(frozen=True)
class BurnScarEffect:
    """A fresh scar takes ``loss`` of the fuel where it is certain; regrowth gives it back with ``regrowth_days``."""

    loss: float = 0.9
    regrowth_days: float = 365.0


def ease_cells(
    longitude_deg: Array, latitude_deg: Array, resolution_km: int = 9
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Row and column of the global EASE-Grid 2.0 (EPSG:6933) of 9 or 36 km that hold the places."""
    from pyproj import Transformer

    transform = Transformer.from_crs("EPSG:4326", "EPSG:6933", always_xy=True)
    x_m, y_m = transform.transform(longitude_deg, latitude_deg)
    cell_m = EASE_CELL_M[resolution_km]
    row = np.floor((EASE_Y0_M - np.asarray(y_m)) / cell_m).astype(np.int64)
    column = np.floor((np.asarray(x_m) - EASE_X0_M) / cell_m).astype(np.int64)
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


@dataclass(frozen=True)
class SoilMoistureOnGrid:
    """Latest soil moisture of each grid cell (m3/m3, NaN where none) and its weight w (0 where none)."""

    soil_moisture: Array
    weight: Array


def soil_moisture_on_grid(
    tables: list[pd.DataFrame],
    longitude_deg: Array,
    latitude_deg: Array,
    time: pd.Timestamp,
    effect: SoilMoistureEffect,
    resolution_km: int = 9,
) -> SoilMoistureOnGrid:
    """Latest value of the EASE cell under each grid cell; ``longitude_deg`` and ``latitude_deg`` are (y, x).

    ``tables`` follow the soil_moisture contract; rows after ``time`` are not yet known and left out.
    """
    empty = SoilMoistureOnGrid(np.full(latitude_deg.shape, np.nan), np.zeros(latitude_deg.shape))
    if not tables:
        return empty
    joined = pd.concat(tables, ignore_index=True)
    joined = joined[(joined["time"] <= time) & (joined["count"] > 0)]
    if joined.empty:
        return empty
    latest = joined.sort_values(["time", "soil_moisture_sd"], ascending=[True, False]).drop_duplicates(
        ["row", "column"], keep="last"
    )
    row, column = ease_cells(longitude_deg.ravel(), latitude_deg.ravel(), resolution_km)
    cells = pd.DataFrame({"row": row, "column": column})
    found = cells.merge(latest, on=["row", "column"], how="left")
    age_days = (time - found["time"]).dt.total_seconds().to_numpy() / 86400
    quality = 1 / (1 + (found["soil_moisture_sd"].to_numpy() / effect.halving_sd) ** 2)
    weight = np.nan_to_num(quality * np.exp(-age_days / effect.tau_days)).reshape(latitude_deg.shape)
    weight = np.where(np.abs(latitude_deg) <= SATELLITE_LATITUDE_LIMIT_DEG, weight, 0.0)
    return SoilMoistureOnGrid(found["soil_moisture"].to_numpy().reshape(latitude_deg.shape), weight)


def soil_position(soil_moisture: Array, q05: Array, q95: Array) -> Array:
    """s in 0..1 between the cell's 5 and 95 % soil moisture; 1/2 (no effect) where any of them is unknown."""
    span = np.where(q95 > q05, q95 - q05, np.nan)
    position = np.clip((soil_moisture - q05) / span, 0, 1)
    return np.where(np.isnan(position), 0.5, position)


def greenness_with_soil_moisture(greenness: Array, weight: Array, alpha: Array, position: Array) -> Array:
    """RG_x in 0..1; RG itself, to the last bit, where the weight is 0 or the position 1/2."""
    return np.clip(greenness * (1 + 2 * weight * alpha * (position - 0.5)), 0, 1)


def burn_scar(
    tables: list[pd.DataFrame],
    longitude_deg: Array,
    latitude_deg: Array,
    time: pd.Timestamp,
    cell_deg: tuple[float, float],
    effect: BurnScarEffect,
) -> Array:
    """Share of the fuel (0..1) that fresh scars took from each grid cell (y, x); 0 where none is known.

    ``tables`` follow the burned_area contract. A look marks the cells within its footprint (half its length along the
    track, at least half a cell), in proportion to the area it covers of the cell and to how far its probability lies
    above the share that burns anyway: a look that says no more than that takes nothing.
    """
    scar = np.zeros(latitude_deg.shape)
    for table in tables:
        burned = table[(burn_evidence.excess_probability(table) > 0) & (table["time"] <= time)]
        excess = burn_evidence.excess_probability(burned)
        points = burned.geometry.representative_point()
        for x, y, certain, row in zip(points.x, points.y, excess, burned.itertuples(), strict=True):
            radius_m = max(row.along_m, row.across_m) / 2
            height_m, width_m = 111195 * cell_deg[0], 111195 * cell_deg[1] * np.cos(np.radians(y))
            half_diagonal_m = 0.505 * np.hypot(height_m, width_m)
            east = (longitude_deg - x) * np.cos(np.radians(y))
            near = 111195 * np.hypot(east, latitude_deg - y) <= max(radius_m, half_diagonal_m)
            age_days = (time - row.time).total_seconds() / 86400
            covered = min(1.0, row.along_m * row.across_m / (height_m * width_m))
            lost = effect.loss * certain * covered * np.exp(-age_days / effect.regrowth_days)
            scar[near] = 1 - (1 - scar[near]) * (1 - lost)
    return np.minimum(scar, effect.loss)
