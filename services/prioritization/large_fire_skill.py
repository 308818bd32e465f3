"""Rolling-origin test of the large-fire model, beside every single index, on seasons that neither has seen."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization import features, large_fire_model, skill

Array = npt.NDArray[np.float64]


def evaluate(
    table: pd.DataFrame, label: str, season: str, schema: features.Schema, first_season: str, seed: int = 0
) -> dict[str, Any]:
    """Rolling-origin skill from ``first_season`` on, pooled: trees, calibration and threshold of each season come from
    the earlier ones only. Beside it every single index with its threshold from earlier seasons.
    """
    kept, y, seasons = large_fire_model.checked_label(table, label, season)
    margins = large_fire_model.rolling_margins(kept, y, seasons, schema, seed)
    singles = [name for name in features.INDICES if name in kept.columns]
    probability = np.full(len(y), np.nan)
    decided = {name: np.zeros(len(y), dtype=bool) for name in ("model", *singles)}
    rate = np.full(len(y), np.nan)
    tested = sorted(name for name in set(seasons) if name >= first_season)
    for name in tested:
        now, earlier = seasons == name, (seasons < name)
        scored = earlier & np.isfinite(margins)
        slope, intercept = skill.fit_logistic(y[scored], margins[scored])
        probability[now] = large_fire_model.sigmoid(slope * margins[now] + intercept)
        decided["model"][now] = margins[now] >= skill.best_threshold(y[scored], margins[scored])
        rate[now] = y[earlier].mean()
        for single in singles:
            value = features.INDICES[single] * kept[single].to_numpy()
            decided[single][now] = value[now] >= skill.best_threshold(y[earlier], value[earlier])
    test = np.isin(seasons, tested)
    return _summary(kept[test], y[test], probability[test], rate[test], {k: v[test] for k, v in decided.items()})


def _summary(
    frame: pd.DataFrame, y: Array, probability: Array, rate: Array, decided: dict[str, npt.NDArray[np.bool_]]
) -> dict[str, Any]:
    singles = {
        name: {
            "auc": skill.auc(y, features.INDICES[name] * frame[name].to_numpy()),
            "mcc": skill.mcc(y, decided[name]),
        }
        for name in decided
        if name != "model"
    }
    chosen = decided["model"]
    bins = skill.reliability(y, probability)
    return {
        "fires": len(y),
        "large_fires": int(y.sum()),
        "auc": skill.auc(y, probability),
        "mcc": skill.mcc(y, chosen),
        "precision": float(y[chosen].mean()) if chosen.any() else 0.0,
        "recall": float(chosen[y > 0].mean()),
        "brier": skill.brier(y, probability),
        "brier_base_rate": skill.brier(y, rate),
        "brier_skill": 1 - skill.brier(y, probability) / skill.brier(y, rate),
        "calibration_slope": skill.calibration_slope(y, probability),
        "calibration_error": skill.calibration_error(y, probability),
        "reliability": [asdict(row) for row in bins],
        "indices": singles,
        "best_index_by_mcc": max(singles, key=lambda name: singles[name]["mcc"]),
        "best_index_by_auc": max(singles, key=lambda name: singles[name]["auc"]),
    }
