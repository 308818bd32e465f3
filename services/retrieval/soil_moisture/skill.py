"""How good the regression is where it has not been fitted: held-out days, held-out blocks of cells, other seasons.

Always beside a baseline that looks at no reflectivity: the cell's mean (days, seasons) or the mean of the other cells
(blocks). Intervals are made as in use: the sd of the fit times a factor from errors on folds other than the judged one
(as in cross-conformal prediction, Vovk 2015; Barber et al. 2021, jackknife+).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.looks.baseline import incidence_slope
from services.retrieval.soil_moisture.conformal import COVERAGE, Z90
from services.retrieval.soil_moisture.regression import CELL, LIMITS, MIN_SD, fit_cells, match, on_grid, predict

FOLDS = 5
BLOCK_KM = 150
SEASON_GAP_DAYS = 30


def train_reference(looks: pd.DataFrame, soil_moisture: pd.DataFrame, resolution_km: int = 9) -> pd.DataFrame:
    """The reference table that retrieval needs, one row a cell: as ``fit_cells``, with ``sd`` brought to the errors on
    held-out days, ``incidence_slope_db_per_deg``, ``resolution_km``.

    ``looks`` on 9 km cells, ``soil_moisture`` on those of ``resolution_km``.
    """
    slope = incidence_slope(looks)
    pairs = match(on_grid(looks, resolution_km), soil_moisture, slope)
    fitted = fit_cells(pairs, resolution_km)
    factor = interval_factor(hold_out(pairs, day_folds(pairs), resolution_km))
    sd = np.clip(fitted["sd"] * factor, MIN_SD, 1.0)
    return fitted.assign(sd=sd, incidence_slope_db_per_deg=slope, resolution_km=resolution_km)


def skill(
    truth: NDArray[np.float64], estimate: NDArray[np.float64], sd: NDArray[np.float64] | None = None
) -> dict[str, float]:
    """R, ubRMSE, bias (m3/m3), count, and the share of truths within the 90 % interval where ``sd`` is given."""
    error = estimate - truth
    known = len(truth) > 2 and np.std(truth) > 0 and np.std(estimate) > 0
    result = {
        "count": len(truth),
        "bias": float(error.mean()),
        "ubrmse": float(np.sqrt(np.mean((error - error.mean()) ** 2))),
        "r": float(np.corrcoef(truth, estimate)[0, 1]) if known else float("nan"),
    }
    if sd is not None:
        result["interval90_coverage"] = float(np.mean(np.abs(error) <= Z90 * sd))
    return result


def day_folds(pairs: pd.DataFrame, folds: int = FOLDS) -> NDArray[np.int64]:
    """Runs of whole days, as many as ``folds`` (or the days there are), (n,)."""
    days, index = np.unique(pairs["day"], return_inverse=True)
    return index * min(folds, days.size) // max(days.size, 1)


def block_folds(pairs: pd.DataFrame, resolution_km: int = 9) -> NDArray[np.int64]:
    """Blocks of about 150 km a side, (n,)."""
    side = max(1, round(BLOCK_KM / resolution_km))
    return pairs.groupby([pairs["row"] // side, pairs["column"] // side]).ngroup().to_numpy()


def hold_out(pairs: pd.DataFrame, fold: NDArray, resolution_km: int = 9) -> pd.DataFrame:
    """Pairs predicted from the other folds, where their cell is known there: ``estimate``, ``sd``, ``baseline`` (the
    cell's mean), ``fold``.
    """
    parts = []
    for held in np.unique(fold):
        rest = pairs[fold != held]
        if len(rest) >= 3:
            found = predict(pairs[fold == held], fit_cells(rest, resolution_km), ["day"], resolution_km)
            parts.append(found.assign(baseline=found["soil_moisture_mean"], fold=held))
    return _joined(pairs, parts)


def leave_days_out(pairs: pd.DataFrame, resolution_km: int = 9) -> pd.DataFrame:
    """``hold_out`` of each day."""
    return hold_out(pairs, pairs["day"].to_numpy(), resolution_km)


def leave_blocks_out(pairs: pd.DataFrame, resolution_km: int = 9) -> pd.DataFrame:
    """Pairs of blocks of cells predicted from the other blocks: places without any soil moisture of their own.

    Their mean moisture is taken from their mean reflectivity by the regression over the other cells' means, their
    slopes are the common ones. ``baseline`` is the mean of the other cells.
    """
    fold = block_folds(pairs, resolution_km)
    parts = []
    for held in np.unique(fold):
        rest, away = pairs[fold != held], pairs[fold == held]
        if rest[CELL].drop_duplicates().shape[0] >= 3:
            model = fit_cells(rest, resolution_km)
            found = predict(away, _unseen_cells(away, model), ["day"], resolution_km)
            parts.append(found.assign(baseline=float(model["soil_moisture_mean"].mean()), fold=held))
    return _joined(pairs, parts)


def _unseen_cells(pairs: pd.DataFrame, model: pd.DataFrame) -> pd.DataFrame:
    """What the cells of ``pairs`` would be by what is common to the cells of ``model``."""
    g, m = model["reflectivity_mean_db"].to_numpy(), model["soil_moisture_mean"].to_numpy()
    across = float(np.cov(g, m)[0, 1] / max(float(np.var(g, ddof=1)), 1e-9))
    between = float(np.std(m - m.mean() - across * (g - g.mean()), ddof=1))
    mean = pairs.groupby(CELL, as_index=False)["reflectivity_db"].mean()
    mean = mean.rename(columns={"reflectivity_db": "reflectivity_mean_db"})
    return mean.assign(
        soil_moisture_mean=m.mean() + across * (mean["reflectivity_mean_db"] - g.mean()),
        slope=float(model["slope"].mean()),
        area_slope=float(model["area_slope"].iloc[0]),
        area_mean_db=0.0,
        sd=float(np.hypot(between, np.sqrt(np.mean(model["sd"] ** 2)))),
    )


def _joined(pairs: pd.DataFrame, parts: list[pd.DataFrame]) -> pd.DataFrame:
    if not parts:
        return pairs.iloc[:0].assign(estimate=[], baseline=[], sd=[], fold=[])
    held = pd.concat(parts, ignore_index=True)
    return held.assign(estimate=held["estimate"].clip(*LIMITS))


def interval_factor(held: pd.DataFrame) -> float:
    """What the sd must be multiplied by so that 90 % of held-out truths lie within 1.645 sd; 1 with fewer than 20."""
    if len(held) < 20:
        return 1.0
    score = np.sort((np.abs(held["estimate"] - held["soil_moisture"]) / held["sd"]).to_numpy())
    rank = int(np.ceil(COVERAGE * (len(score) + 1))) - 1
    return float(score[min(rank, len(score) - 1)] / Z90)


def with_intervals(held: pd.DataFrame) -> pd.DataFrame:
    """``sd`` of each fold times the factor from the errors on the other folds."""
    factor = pd.Series(1.0, index=held.index)
    for fold in np.unique(held["fold"]):
        factor[held["fold"] == fold] = interval_factor(held[held["fold"] != fold])
    return held.assign(sd=(held["sd"] * factor).clip(MIN_SD, 1.0))


def beside_baseline(held: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Skill of held-out estimates and of their baseline; empty with fewer than three."""
    if len(held) < 3:
        return {}
    truth = held["soil_moisture"].to_numpy()
    return {
        "regression": skill(truth, held["estimate"].to_numpy(), held["sd"].to_numpy()),
        "cell_mean_baseline": skill(truth, held["baseline"].to_numpy()),
    }


def skill_report(pairs: pd.DataFrame, resolution_km: int = 9) -> dict[str, dict[str, float]]:
    """Skill with each day predicted from the others, beside the cell mean; empty if too few."""
    return beside_baseline(with_intervals(leave_days_out(pairs, resolution_km)))


def transfer(training: pd.DataFrame, judged: pd.DataFrame, resolution_km: int = 9) -> pd.DataFrame:
    """``judged`` pairs predicted from ``training`` pairs of other days, sd as ``train_reference`` would give it."""
    factor = interval_factor(hold_out(training, day_folds(training), resolution_km))
    found = predict(judged, fit_cells(training, resolution_km), ["day"], resolution_km)
    sd = (found["sd"] * factor).clip(MIN_SD, 1.0)
    return found.assign(estimate=found["estimate"].clip(*LIMITS), baseline=found["soil_moisture_mean"], sd=sd)


def summary(reference: pd.DataFrame, pairs: pd.DataFrame) -> dict[str, float]:
    """What was fitted: cells, cell-days, slopes (m3/m3 per dB)."""
    return {
        "cells": len(reference),
        "cell_days": len(pairs),
        "resolution_km": int(reference["resolution_km"].iloc[0]),
        "median_slope_m3_m3_db": float(reference["slope"].median()),
        "area_slope_m3_m3_db": float(reference["area_slope"].iloc[0]),
    }


def evaluate(pairs: pd.DataFrame, resolution_km: int = 9) -> dict[str, Any]:
    """Every way of holding out: ``leave_a_day_out``, ``leave_a_block_out``, and either ``transfer`` between seasons (30
    days without pairs part them) both ways, or ``forward_in_time`` from the first half of the days to the second.
    """
    report: dict[str, Any] = {
        "leave_a_day_out": skill_report(pairs, resolution_km),
        "leave_a_block_out": beside_baseline(with_intervals(leave_blocks_out(pairs, resolution_km))),
    }
    days = np.unique(pairs["day"])
    gap = np.flatnonzero(np.diff(days) > SEASON_GAP_DAYS)
    cut = days[gap[0] + 1] if gap.size else days[days.size // 2]
    early, late = pairs[pairs["day"] < cut], pairs[pairs["day"] >= cut]
    if gap.size:
        ways = {"first_to_second": (early, late), "second_to_first": (late, early)}
        report["transfer"] = {name: _transfer_report(*way, resolution_km) for name, way in ways.items()}
    else:
        report["forward_in_time"] = _transfer_report(early, late, resolution_km)
    return report


def _transfer_report(training: pd.DataFrame, judged: pd.DataFrame, resolution_km: int) -> dict[str, dict[str, float]]:
    return beside_baseline(transfer(training, judged, resolution_km)) if len(training) >= 3 else {}
