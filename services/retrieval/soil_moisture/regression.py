"""Soil moisture from reflectivity: one linear regression per EASE-Grid cell, slopes partially pooled.

The UCAR/CU form (Chew and Small 2020, Remote Sensing 12, 1558): moisture = cell mean + slope x (reflectivity - cell
mean). A cell has few looks, so its slope is drawn towards the mean of all slopes by as much as its own error says
(empirical Bayes). What the neighbourhood has in common on a day has a slope of its own: single looks differ mostly by
the spot they fall on, which draws a cell's slope to zero and would make a drying land look as wet as it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.looks.baseline import REFERENCE_INCIDENCE_DEG
from services.retrieval.soil_moisture.area import Neighbourhoods, area_anomaly
from services.retrieval.soil_moisture.conformal import Z90
from shared.errors import DomainError

Interval = Callable[[pd.DataFrame], NDArray[np.float64]]

CELL = ["row", "column"]
LIMITS = (0.02, 0.60)  # m3/m3: from residual moisture to saturation of mineral soils
REFERENCE_COLUMNS = ("row", "column", "soil_moisture_mean", "reflectivity_mean_db", "slope", "sd")
MIN_SD = 0.01
BACKFITTING_ROUNDS = 10
# A peak falls between bins: triangle in delay and sinc in Doppler lose 0.88 dB on average with bins of 0.2552 chip and
# 500 Hz, 0.14 dB with 0.0638 chip and 50 Hz.
FINE_BINS_DB = {"nominal": 0.0, "raw-if": 0.74}


def flat_reflectivity(looks: pd.DataFrame, slope_db_per_deg: NDArray | float) -> pd.Series:
    """Reflectivity (dB) brought to 30 deg incidence and to the bins of nominal maps, aligned to ``looks``."""
    flat = looks["reflectivity_db"] - slope_db_per_deg * (looks["incidence_deg"] - REFERENCE_INCIDENCE_DEG)
    return flat - looks["mode"].map(FINE_BINS_DB) if "mode" in looks.columns else flat


def match(looks: pd.DataFrame, soil_moisture: pd.DataFrame, slope_db_per_deg: float = 0.0) -> pd.DataFrame:
    """Pairs of a cell and a UTC day: ``row``, ``column``, ``day``, ``soil_moisture``, ``reflectivity_db``, ``count``.

    ``soil_moisture`` has ``time``, ``row``, ``column``, ``soil_moisture`` on the same cells as the looks.
    """
    missing = [n for n in ("time", "row", "column", "soil_moisture") if n not in soil_moisture.columns]
    if missing:
        raise DomainError(
            f"The soil-moisture table lacks {', '.join(missing)}.",
            field=f"soil_moisture.{missing[0]}",
            accepted="time, row, column, soil_moisture",
        )
    truth = soil_moisture.assign(day=_days(pd.to_datetime(soil_moisture["time"], utc=True).dt.tz_localize(None)))
    truth = truth.groupby([*CELL, "day"], as_index=False)["soil_moisture"].mean()
    daily = looks.assign(flat=flat_reflectivity(looks, slope_db_per_deg), day=_days(looks["time"]))
    daily = daily.groupby([*CELL, "day"], as_index=False).agg(reflectivity_db=("flat", "mean"), count=("flat", "size"))
    return daily.merge(truth, on=[*CELL, "day"], how="inner")


def fit_cells(pairs: pd.DataFrame, resolution_km: int = 9) -> pd.DataFrame:
    """Per cell: means, slopes (m3/m3 per dB) and residual sd (m3/m3), from ``match`` pairs.

    moisture = mean + area_slope x A + slope x (g - A), where g is the anomaly of the cell's reflectivity and A that
    of its neighbourhood, both against their means over the cell's days. ``area_slope`` is common; the cells' own
    slopes are least squares weighted by looks, shrunk to their common mean with the between-cell variance of
    DerSimonian and Laird (1986). Neither is negative: wetter soil reflects more. Residual variances are shrunk
    likewise, with the weight of five days. A cell of one day takes the common slope.
    """
    if len(pairs) < 3:
        raise DomainError(
            f"Only {len(pairs)} cell-days hold both looks and soil moisture.",
            field="soil_moisture",
            accepted="at least 3 cell-days in common with the observations",
        )
    weight = pairs["count"].to_numpy(dtype=np.float64)
    cell = pairs.groupby(CELL, sort=True).ngroup().to_numpy()
    cells = pairs[CELL].drop_duplicates().sort_values(CELL, ignore_index=True)
    mean = _CellMeans(cell, weight)
    mean_m = mean.of(pairs["soil_moisture"].to_numpy())
    m = pairs["soil_moisture"].to_numpy() - mean_m[cell]
    mean_g, area = _levels(pairs, mean, resolution_km)
    mean_area = mean.of(area)
    near = area - mean_area[cell]
    own = pairs["reflectivity_db"].to_numpy() - mean_g[cell] - area
    days = np.bincount(cell).astype(np.float64)
    area_slope = _area_slope(weight, near, own, m)
    rest = m - area_slope * near
    slope = np.maximum(_pooled_slopes(cell, weight, own, rest, days), 0.0)
    residual = rest - slope[cell] * own
    return cells.assign(
        soil_moisture_mean=mean_m,
        reflectivity_mean_db=mean_g,
        slope=slope,
        area_slope=area_slope,
        area_mean_db=mean_area,
        sd=_pooled_sd(residual, cell, days),
        days=days.astype(np.int32),
    )


@dataclass(frozen=True)
class _CellMeans:
    """Means over the days of each cell, weighted by looks."""

    cell: NDArray[np.int64]
    weight: NDArray[np.float64]

    def of(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(self.cell, self.weight * value) / np.bincount(self.cell, self.weight)


def _levels(pairs: pd.DataFrame, mean: _CellMeans, resolution_km: int) -> tuple[NDArray, NDArray]:
    """Level of each cell (cell,) and anomaly of each cell-day's neighbourhood (n,), fitted in turn (backfitting).

    Cells are seen on different days: the mean of one seen on wet days only is no level to compare dry days with.
    """
    value = pairs["reflectivity_db"].to_numpy()
    area = np.zeros(len(pairs))
    level = mean.of(value)
    around = Neighbourhoods(pairs, ["day"], resolution_km)
    for _ in range(BACKFITTING_ROUNDS):
        area = around.anomaly(value - level[mean.cell])
        level = mean.of(value - area)
    return level, area


def _area_slope(weight: NDArray, near: NDArray, own: NDArray, m: NDArray) -> float:
    """Slope on the neighbourhood's anomaly, fitted together with one on the cell's own rest (ridge of 1 dB2)."""
    design = np.stack([near, own], axis=1)
    normal = design.T @ (design * weight[:, None]) + np.eye(2)
    return max(float(np.linalg.solve(normal, design.T @ (weight * m))[0]), 0.0)


def _pooled_slopes(cell: NDArray, weight: NDArray, g: NDArray, m: NDArray, days: NDArray) -> NDArray[np.float64]:
    sxx, sxy = (np.bincount(cell, weight * g * value) for value in (g, m))
    common = float(sxy.sum() / max(float(sxx.sum()), 1e-9))
    residual_variance = float((weight * (m - common * g) ** 2).sum() / max(float(days.sum() - len(days) - 1), 1.0))
    usable = (sxx > 1e-6) & (days >= 2)
    own = np.where(usable, sxy / np.where(usable, sxx, 1.0), common)
    precision = np.where(usable, sxx / max(residual_variance, 1e-12), 0.0)
    total = max(float(precision.sum()), 1e-12)
    centre = float((precision * own).sum() / total)
    scatter = float((precision * (own - centre) ** 2).sum())
    degrees = max(int(usable.sum()) - 1, 0)
    between = max(0.0, (scatter - degrees) / max(total - float((precision**2).sum()) / total, 1e-12))
    if between == 0.0:
        return np.full(len(days), centre)
    return (precision * own + centre / between) / (precision + 1.0 / between)


def _pooled_sd(residual: NDArray, cell: NDArray, days: NDArray) -> NDArray[np.float64]:
    squares = np.bincount(cell, residual**2)
    pooled = float(squares.sum() / max(float(days.sum() - len(days) - 1.0), 1.0))
    variance = (squares + 5.0 * pooled) / (np.maximum(days - 1.0, 0.0) + 5.0)
    # the two means of the cell are themselves estimates from its days
    return np.maximum(np.sqrt(variance * (1.0 + 1.0 / days)), MIN_SD)


def predict(cell_days: pd.DataFrame, model: pd.DataFrame, groups: list[str], resolution_km: int = 9) -> pd.DataFrame:
    """Cell-days whose cell the model knows, with its columns, ``estimate`` (m3/m3, unclipped) and ``anomaly_db``.

    ``cell_days``: ``row``, ``column``, ``reflectivity_db`` (at 30 deg), ``count`` and the columns of ``groups``, within
    which neighbourhoods are taken.
    """
    joined = cell_days.merge(model, on=CELL, how="inner")
    joined["anomaly_db"] = joined["reflectivity_db"] - joined["reflectivity_mean_db"]
    near = area_anomaly(joined, groups, resolution_km) - joined["area_mean_db"]
    within = joined["slope"] * (joined["anomaly_db"] - near)
    return joined.assign(estimate=joined["soil_moisture_mean"] + joined["area_slope"] * near + within)


def check_reference(reference: pd.DataFrame) -> pd.DataFrame:
    """The reference with its optional column filled in; DomainError names a missing or empty column."""
    missing = [name for name in REFERENCE_COLUMNS if name not in reference.columns]
    empty = [name for name in REFERENCE_COLUMNS if name not in missing and reference[name].isna().all()]
    if missing or empty:
        raise DomainError(
            f"The soil-moisture reference lacks {', '.join(missing or empty)}.",
            field=f"reference.{(missing or empty)[0]}",
            accepted=", ".join(REFERENCE_COLUMNS),
        )
    full = reference.dropna(subset=list(REFERENCE_COLUMNS))
    for name, value in (("incidence_slope_db_per_deg", 0.0), ("area_slope", full["slope"]), ("area_mean_db", 0.0)):
        full = full if name in full.columns else full.assign(**{name: value})
    return full.drop_duplicates(CELL)


def grid_of(reference: pd.DataFrame) -> int:
    """The grid (km) that a reference is made for: its column ``resolution_km``, 9 without; DomainError if mixed."""
    found = sorted(set(reference["resolution_km"])) if "resolution_km" in reference.columns else [9]
    if len(found) > 1:
        raise DomainError("The reference mixes grids.", field="reference.resolution_km", value=found, accepted="one")
    return int(found[0]) if found else 9


def daily_cells(looks: pd.DataFrame, reference: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, int]]:
    """Means of looks per UTC day, cell of the reference and mode; and how many looks had no cell there.

    Columns: ``day``, ``row``, ``column``, ``mode``, ``time`` (of the last look), ``reflectivity_db`` (at 30 deg, as
    nominal bins would have it), ``count``, and the means of further numeric columns of the looks.
    """
    table = check_reference(reference)[[*CELL, "incidence_slope_db_per_deg"]]
    joined = on_grid(looks, grid_of(reference)).merge(table, on=CELL, how="inner")
    counts = {"looks": len(looks), "without_reference": len(looks) - len(joined)}
    flat = flat_reflectivity(joined, joined["incidence_slope_db_per_deg"])
    joined = joined.assign(day=_days(joined["time"]), reflectivity_db=flat)
    keys = ["day", *CELL, "mode"]
    numbers = joined.drop(columns=[*keys, "time", "incidence_slope_db_per_deg"]).select_dtypes("number").columns
    groups = joined.groupby(keys, sort=True)
    daily = groups[list(numbers)].mean()
    return daily.assign(time=groups["time"].max(), count=groups.size()).reset_index(), counts


def on_grid(looks: pd.DataFrame, resolution_km: int) -> pd.DataFrame:
    """Looks or soil moisture on 9 km cells, brought to the 36 km cells that hold four by four of them."""
    if resolution_km == 9:
        return looks
    if resolution_km != 36:
        raise DomainError(
            "Soil moisture has no such grid.", field="resolution_km", value=resolution_km, accepted="9, 36"
        )
    return looks.assign(row=looks["row"] // 4, column=looks["column"] // 4)


def retrieve(
    looks: pd.DataFrame, reference: pd.DataFrame, raw_if_interval: Interval | None = None
) -> tuple[pd.DataFrame, dict[str, int]]:
    """Soil moisture per UTC day, cell and mode (the soil_moisture contract), and counts of what was left out.

    ``looks`` lie on 9 km cells; the cells are those of the reference. ``time`` is the last look that went in. The sd
    is that of the regression for a day's mean; values outside 0.02..0.60 are clipped. ``raw_if_interval`` gives lower
    bound, estimate and upper bound of raw-IF cell-days; without it the regression holds for them, too.
    """
    daily, counts = daily_cells(looks, reference)
    found = predict(daily, check_reference(reference), ["day", "mode"], grid_of(reference))
    bounds = found["estimate"].to_numpy()[:, None] + found["sd"].to_numpy()[:, None] * np.array([-Z90, 0.0, Z90])
    raw_if = (found["mode"] == "raw-if").to_numpy()
    if raw_if_interval is not None and raw_if.any():
        bounds[raw_if] = raw_if_interval(found[raw_if])
    return as_table(found, bounds, counts)


def as_table(
    cells: pd.DataFrame, bounds: NDArray[np.float64], counts: dict[str, int]
) -> tuple[pd.DataFrame, dict[str, int]]:
    """The soil_moisture contract from cell-days and their lower bound, estimate and upper bound (n, 3).

    ``soil_moisture_low`` and ``soil_moisture_high`` bound the 90 % interval. Estimates that are clipped are counted.
    """
    low, estimate, high = bounds.T
    limited = np.clip(estimate, *LIMITS)
    table = cells.assign(
        soil_moisture=limited,
        soil_moisture_sd=np.clip((high - low) / (2.0 * Z90), MIN_SD, 1.0),
        soil_moisture_low=np.clip(np.minimum(low, limited), 0.0, 1.0),
        soil_moisture_high=np.clip(np.maximum(high, limited), 0.0, 1.0),
    )
    interval = ["soil_moisture_low", "soil_moisture_high"]
    columns = ["time", *CELL, "soil_moisture", "soil_moisture_sd", "count", "mode", *interval]
    result = table.sort_values(["time", *CELL, "mode"], kind="stable", ignore_index=True)[columns]
    kinds = {"row": np.int32, "column": np.int32, "count": np.int32, "mode": object}
    return result.astype(kinds), {**counts, "clipped": int((limited != estimate).sum())}


def _days(time: pd.Series) -> NDArray[np.int64]:
    return time.to_numpy().astype("datetime64[D]").astype(np.int64)
