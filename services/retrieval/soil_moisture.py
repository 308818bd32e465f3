"""Soil moisture from reflectivity: one linear regression per EASE-Grid cell, slopes partially pooled.

The UCAR/CU form (Chew and Small 2020, Remote Sensing 12, 1558): moisture = cell mean + slope x (reflectivity - cell
mean). A cell has few looks, so its slope is drawn towards the mean of all slopes by as much as its own error says
(empirical Bayes).
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.baseline import REFERENCE_INCIDENCE_DEG, incidence_slope
from shared.errors import DomainError

CELL = ["row", "column"]
LIMITS = (0.02, 0.60)  # m3/m3: from residual moisture to saturation of mineral soils
REFERENCE_COLUMNS = ("row", "column", "soil_moisture_mean", "reflectivity_mean_db", "slope", "sd")
MIN_SD = 0.01


def flat_reflectivity(looks: pd.DataFrame, slope_db_per_deg: NDArray | float) -> pd.Series:
    """Reflectivity brought to 30 deg incidence, aligned to ``looks``."""
    return looks["reflectivity_db"] - slope_db_per_deg * (looks["incidence_deg"] - REFERENCE_INCIDENCE_DEG)


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


def fit_cells(pairs: pd.DataFrame) -> pd.DataFrame:
    """Per cell: means, pooled slope (m3/m3 per dB) and residual sd (m3/m3), from ``match`` pairs.

    Slopes: least squares weighted by looks, shrunk to their common mean with the between-cell variance of
    DerSimonian and Laird (1986). Residual variances are shrunk likewise, with the weight of five days. A cell with
    one pair takes the common slope.
    """
    if len(pairs) < 3:
        raise DomainError(
            f"Only {len(pairs)} cell-days hold both looks and soil moisture.",
            field="soil_moisture",
            accepted="at least 3 cell-days in common with the observations",
        )
    weight = pairs["count"].astype(np.float64)
    keys = [pairs[name] for name in CELL]
    total = weight.groupby(keys).sum()
    frame = pairs.assign(w=weight, wg=weight * pairs["reflectivity_db"], wm=weight * pairs["soil_moisture"])
    sums = frame.groupby(CELL)[["wg", "wm"]].sum()
    mean_g, mean_m = sums["wg"] / total, sums["wm"] / total
    index = pd.MultiIndex.from_frame(pairs[CELL])
    g = pairs["reflectivity_db"].to_numpy() - mean_g.reindex(index).to_numpy()
    m = pairs["soil_moisture"].to_numpy() - mean_m.reindex(index).to_numpy()
    sxx, sxy = (pd.Series(weight.to_numpy() * g * v, index=index).groupby(level=[0, 1]).sum() for v in (g, m))
    days = pairs.groupby(CELL).size().astype(np.float64)
    common = float(sxy.sum() / max(float(sxx.sum()), 1e-9))
    slope = _pooled_slopes(sxx, sxy, common, weight.to_numpy(), g, m, days)
    residual = m - slope.reindex(index).to_numpy() * g
    return pd.DataFrame(
        {
            "soil_moisture_mean": mean_m,
            "reflectivity_mean_db": mean_g,
            "slope": slope,
            "sd": _pooled_sd(residual, index, days),
            "days": days.astype(np.int32),
        }
    ).reset_index()


def _pooled_slopes(sxx, sxy, common: float, weight, g, m, days) -> pd.Series:
    residual_variance = float((weight * (m - common * g) ** 2).sum() / max(float(days.sum() - len(days) - 1), 1.0))
    usable = (sxx > 1e-6) & (days >= 2)
    own = (sxy / sxx.where(usable)).fillna(common)
    precision = (sxx / max(residual_variance, 1e-12)).where(usable, 0.0)
    total = max(float(precision.sum()), 1e-12)
    centre = float((precision * own).sum() / total)
    scatter = float((precision * (own - centre) ** 2).sum())
    degrees = max(int(usable.sum()) - 1, 0)
    between = max(0.0, (scatter - degrees) / max(total - float((precision**2).sum()) / total, 1e-12))
    if between == 0.0:
        return pd.Series(centre, index=sxx.index)
    return (precision * own + centre / between) / (precision + 1.0 / between)


def _pooled_sd(residual: NDArray, index: pd.MultiIndex, days: pd.Series) -> pd.Series:
    squares = pd.Series(residual**2, index=index).groupby(level=[0, 1]).sum()
    pooled = float(squares.sum() / max(float(days.sum() - len(days) - 1.0), 1.0))
    free = (days - 1.0).clip(lower=0.0)
    variance = (squares + 5.0 * pooled) / (free + 5.0)
    # the two means of the cell are themselves estimates from its days
    return np.sqrt(variance * (1.0 + 1.0 / days)).clip(lower=MIN_SD)


def train_reference(looks: pd.DataFrame, soil_moisture: pd.DataFrame) -> pd.DataFrame:
    """The reference table that retrieval needs, one row a cell: REFERENCE_COLUMNS, ``days``,
    ``incidence_slope_db_per_deg``.
    """
    slope = incidence_slope(looks)
    return fit_cells(match(looks, soil_moisture, slope)).assign(incidence_slope_db_per_deg=slope)


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
    if "incidence_slope_db_per_deg" not in full.columns:
        full = full.assign(incidence_slope_db_per_deg=0.0)
    return full.drop_duplicates(CELL)


def retrieve(looks: pd.DataFrame, reference: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, int]]:
    """Soil moisture per UTC day, 9 km cell and mode (the soil_moisture contract), and counts of what was left out.

    ``time`` is the last look that went in. The sd is that of the regression for a day's mean; values outside
    0.02..0.60 are clipped.
    """
    table = check_reference(reference)
    joined = looks.merge(table, on=CELL, how="inner", suffixes=("", "_cell"))
    counts = {"looks": len(looks), "without_reference": len(looks) - len(joined)}
    columns = ["time", *CELL, "soil_moisture", "soil_moisture_sd", "count", "mode"]
    if not len(joined):
        empty = pd.DataFrame({name: [] for name in columns})
        kinds = {"time": "datetime64[ms]", "row": "int32", "column": "int32", "count": "int32", "mode": object}
        return empty.astype(kinds), counts
    joined["flat"] = flat_reflectivity(joined, joined["incidence_slope_db_per_deg"]) - joined["reflectivity_mean_db"]
    daily = joined.assign(day=_days(joined["time"])).groupby(["day", *CELL, "mode"], as_index=False, sort=True).agg(
        time=("time", "max"), flat=("flat", "mean"), count=("flat", "size"),
        mean=("soil_moisture_mean", "first"), slope=("slope", "first"), sd=("sd", "first"),
    )  # fmt: skip
    raw = daily["mean"] + daily["slope"] * daily["flat"]
    daily["soil_moisture"] = raw.clip(*LIMITS)
    daily["soil_moisture_sd"] = daily["sd"].clip(MIN_SD, 1.0)
    counts["clipped"] = int((raw != daily["soil_moisture"]).sum())
    result = daily.sort_values(["time", *CELL, "mode"], kind="stable", ignore_index=True)[columns]
    return result.astype({"row": np.int32, "column": np.int32, "count": np.int32}), counts


def skill(truth: NDArray[np.float64], estimate: NDArray[np.float64], sd: NDArray[np.float64] | None = None):
    """R, ubRMSE, bias (m3/m3), count, and the share of truths within the 90 % interval where ``sd`` is given."""
    error = estimate - truth
    result = {
        "count": len(truth),
        "bias": float(error.mean()),
        "ubrmse": float(np.sqrt(np.mean((error - error.mean()) ** 2))),
        "r": float(np.corrcoef(truth, estimate)[0, 1]) if len(truth) > 2 else float("nan"),
    }
    if sd is not None:
        result["interval90_coverage"] = float(np.mean(np.abs(error) <= 1.645 * sd))
    return result


def leave_days_out(pairs: pd.DataFrame) -> pd.DataFrame:
    """Out-of-sample estimates of every pair: each day predicted from the others, beside the cell-mean baseline.

    Returns the pairs that have a cell in the other days, with ``estimate``, ``sd`` and ``baseline`` (the cell's mean).
    """
    parts = []
    for day in np.unique(pairs["day"]):
        rest, held = pairs[pairs["day"] != day], pairs[pairs["day"] == day]
        if len(rest) < 3:
            continue
        model = fit_cells(rest)
        joined = held.merge(model, on=CELL, how="inner")
        estimate = joined["soil_moisture_mean"] + joined["slope"] * (
            joined["reflectivity_db"] - joined["reflectivity_mean_db"]
        )
        parts.append(joined.assign(estimate=estimate.clip(*LIMITS), baseline=joined["soil_moisture_mean"]))
    return pd.concat(parts, ignore_index=True) if parts else pairs.iloc[:0].assign(estimate=[], baseline=[], sd=[])


def skill_report(pairs: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Skill of the regression and of the cell-mean baseline, each day predicted from the others; empty if too few."""
    held = leave_days_out(pairs)
    if len(held) < 3:
        return {}
    truth = held["soil_moisture"].to_numpy()
    return {
        "regression": skill(truth, held["estimate"].to_numpy(), held["sd"].to_numpy()),
        "cell_mean_baseline": skill(truth, held["baseline"].to_numpy()),
    }


def _days(time: pd.Series) -> NDArray[np.int64]:
    return time.to_numpy().astype("datetime64[D]").astype(np.int64)
