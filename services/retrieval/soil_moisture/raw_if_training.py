"""Cell-days of raw-IF looks to learn from and to judge by, none of which has seen its own day's soil moisture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.soil_moisture.conformal import site_folds
from services.retrieval.soil_moisture.quantiles import MIN_ROWS, MIN_SITES, RawIfModel, train_raw_if
from services.retrieval.soil_moisture.regression import CELL, LIMITS, daily_cells, fit_cells, match, on_grid, predict
from services.retrieval.soil_moisture.skill import day_folds, skill

SITE_KM = 50  # the side of a site: looks nearer to each other share soils and rain
OUTER_FOLDS = 4
KEYS = ["day", *CELL]


def sites(table: pd.DataFrame, resolution_km: int = 9) -> NDArray[np.int64]:
    """The site of each cell-day: squares of about 50 km, (n,)."""
    side = max(1, round(SITE_KM / resolution_km))
    return (table["row"] // side).to_numpy(np.int64) * 10_000 + (table["column"] // side).to_numpy(np.int64)


def cell_days(looks: pd.DataFrame, reference: pd.DataFrame, pairs: pd.DataFrame, resolution_km: int) -> pd.DataFrame:
    """Raw-IF cell-days with soil moisture, each with the regression's estimate by ``pairs`` of other days.

    ``reference`` lends the cells and the incidence slope; ``pairs`` are those of ``match``.
    """
    daily, _ = daily_cells(looks[looks["mode"] == "raw-if"], reference)
    truth = pairs[[*KEYS, "soil_moisture"]]
    fold_of_day = pd.Series(day_folds(pairs), index=pairs["day"]).groupby(level=0).first()
    parts = []
    for fold in np.unique(fold_of_day):
        days = fold_of_day.index[fold_of_day == fold]
        rest = pairs[~pairs["day"].isin(days)]
        if len(rest) >= 3:
            held = daily[daily["day"].isin(days)]
            parts.append(predict(held, fit_cells(rest, resolution_km), ["day"], resolution_km))
    known = [part.merge(truth, on=KEYS, how="inner") for part in parts]
    return pd.concat(known, ignore_index=True) if known else daily.iloc[:0]


def train(
    looks: pd.DataFrame, reference: pd.DataFrame, truth: pd.DataFrame, method: str, resolution_km: int = 9
) -> tuple[RawIfModel | None, dict[str, Any]]:
    """The raw-IF model, or None with too few looks, and its report: counts, skill on held-out places and dates."""
    slope = float(reference["incidence_slope_db_per_deg"].iloc[0])
    pairs = match(on_grid(looks, resolution_km), truth, slope)
    table = cell_days(looks, reference, pairs, resolution_km)
    site = sites(table, resolution_km)
    report: dict[str, Any] = {"method": method, "cell_days": len(table), "sites": int(np.unique(site).size)}
    if method == "none" or len(table) < MIN_ROWS or report["sites"] < MIN_SITES:
        return None, report | {"trained": False, "needs": {"cell_days": MIN_ROWS, "sites": MIN_SITES}}
    model = train_raw_if(table, site, method)
    held = held_out(looks, reference, pairs, method, resolution_km)
    return model, report | {"trained": True, "margin": model.margin, "held_out_places_and_dates": held}


def held_out(
    looks: pd.DataFrame, reference: pd.DataFrame, pairs: pd.DataFrame, method: str, resolution_km: int
) -> dict[str, Any]:
    """Skill on the later half of the days at sites that were not trained on, beside the regression and cell mean."""
    days = np.unique(pairs["day"])
    cut = days[days.size // 2]
    early = pairs[pairs["day"] < cut]
    past = looks[looks["time"].to_numpy().astype("datetime64[D]").astype(np.int64) < cut]
    training = cell_days(past, reference, early, resolution_km) if len(early) >= 3 else early.iloc[:0]
    if len(training) < MIN_ROWS:
        return {}
    daily, _ = daily_cells(looks[looks["mode"] == "raw-if"], reference)
    later = predict(daily[daily["day"] >= cut], fit_cells(early, resolution_km), ["day"], resolution_km)
    later = later.merge(pairs[[*KEYS, "soil_moisture"]], on=KEYS, how="inner")
    return judged_elsewhere(training, later, method, resolution_km)


def judged_elsewhere(training: pd.DataFrame, later: pd.DataFrame, method: str, resolution_km: int) -> dict[str, Any]:
    """Skill on ``later`` cell-days, each site's by a model of other sites' ``training`` ones; empty if too few."""
    here, there = sites(training, resolution_km), sites(later, resolution_km)
    both = np.concatenate([here, there])
    fold = site_folds(both, OUTER_FOLDS)
    fold_here, fold_there = fold[: len(here)], fold[len(here) :]
    bounds = np.full((len(later), 3), np.nan)
    for held in range(OUTER_FOLDS):
        kept, judged = fold_here != held, fold_there == held
        if kept.sum() >= MIN_ROWS and np.unique(here[kept]).size >= MIN_SITES and judged.any():
            bounds[judged] = train_raw_if(training[kept], here[kept], method).interval(later[judged])
    found = np.isfinite(bounds).all(axis=1)
    if found.sum() < 3:
        return {}
    low, middle, high = bounds[found].T
    truth = later["soil_moisture"].to_numpy()[found]
    covered = float(np.mean((truth >= low) & (truth <= high)))
    return {
        "model": skill(truth, np.clip(middle, *LIMITS)) | {"interval90_coverage": covered},
        "regression": skill(truth, later["estimate"].clip(*LIMITS).to_numpy()[found]),
        "cell_mean_baseline": skill(truth, later["soil_moisture_mean"].to_numpy()[found]),
    }
