"""Skill of the large-fire model on unseen fires, beside every single index: one table, two prevalences, with intervals.

Thresholds and calibration of a fold come from its training fires only; results of all folds are pooled. The second
prevalence is 1:2, one large to two small fires, as balanced test sets have it: small fires then count less, no fire is
drawn or left out, and thresholds are found at that prevalence too. Intervals (5 and 95 %) resample whole seasons or
regions, since the fires of one are not independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from services.prioritization.large_fire import features, skill
from services.prioritization.large_fire.model import sigmoid
from services.prioritization.large_fire.validation import HALVES, Fold, Table

Array = npt.NDArray[np.float64]

PREVALENCES = {"natural": None, "one to two": 1 / 3}
RESAMPLES = 500
SUMMARY = ("auc", "mcc", "precision", "recall", "brier", "calibration_error")


@dataclass(frozen=True)
class Forecasts:
    """Pooled forecasts of one model or index: (n,) score, probability and decision, per prevalence; NaN untested."""

    score: Array
    probability: dict[str, Array]
    decided: dict[str, npt.NDArray[np.bool_]]


def small_fire_weight(outcome: Array, prevalence: float | None) -> float:
    """How much each small fire counts so that large ones make up ``prevalence``."""
    if prevalence is None:
        return 1.0
    large, small = float(outcome.sum()), float((1 - outcome).sum())
    return large * (1 - prevalence) / (prevalence * small)


def _weights(outcome: Array, prevalence: float | None) -> Array:
    return np.where(outcome > 0, 1.0, small_fire_weight(outcome, prevalence))


def _empty(size: int) -> Forecasts:
    nothing = {name: np.full(size, np.nan) for name in PREVALENCES}
    return Forecasts(np.full(size, np.nan), nothing, {name: np.zeros(size, dtype=bool) for name in PREVALENCES})


def forecasts_of_half(table: Table, folds: Sequence[Fold], half: str) -> Forecasts:
    """Trees, regression or blend: Platt on the teaching fires, threshold of the largest expected MCC."""
    out, column = _empty(len(table.outcome)), HALVES.index(half)
    for fold in folds:
        known = fold.earlier & np.isfinite(fold.taught[:, column])
        taught, margin = fold.taught[known, column], fold.margin[fold.now, column]
        slope, intercept = skill.fit_logistic(table.outcome[known], taught)
        probability = sigmoid(slope * margin + intercept)
        out.score[fold.now] = probability
        for name, prevalence in PREVALENCES.items():
            weight = small_fire_weight(table.outcome[known], prevalence)
            threshold = skill.expected_mcc_threshold(sigmoid(slope * taught + intercept), weight)
            out.probability[name][fold.now] = sigmoid(slope * margin + intercept - np.log(weight))
            out.decided[name][fold.now] = probability >= threshold
    return out


def forecasts_of_index(table: Table, folds: Sequence[Fold], feature: features.Feature) -> Forecasts:
    """A single index at its best training threshold; its probability is a logistic fit on the training fires."""
    out = _empty(len(table.outcome))
    values = feature.danger * table.frame[feature.name].to_numpy(dtype=np.float64)
    for fold in folds:
        known = fold.earlier & np.isfinite(values)
        typical = float(np.median(values[known]))
        now = np.where(np.isfinite(values[fold.now]), values[fold.now], typical)
        spread = float(values[known].std()) or 1.0
        slope, intercept = skill.fit_logistic(table.outcome[known], (values[known] - typical) / spread)
        out.score[fold.now] = now
        for name, prevalence in PREVALENCES.items():
            weights = _weights(table.outcome[known], prevalence)
            threshold = skill.best_threshold(table.outcome[known], values[known], weights)
            offset = np.log(small_fire_weight(table.outcome[known], prevalence))
            out.probability[name][fold.now] = sigmoid(slope * (now - typical) / spread + intercept - offset)
            out.decided[name][fold.now] = now >= threshold
    return out


def evaluate(
    table: Table, folds: Sequence[Fold], schema: features.Schema, seed: int = 0, resamples: int = RESAMPLES
) -> dict[str, Any]:
    """The report: pooled skill of the blend, its halves and every single index over ``folds``, both prevalences.

    ``natural`` and ``one to two`` hold a row a competitor (name -> metric, and ``<metric>_interval``); at the top
    level stand the blend's figures at natural prevalence.
    """
    tested = np.any([fold.now for fold in folds], axis=0)
    rate = np.full(len(tested), np.nan)
    for fold in folds:
        rate[fold.now] = table.outcome[fold.earlier].mean()
    rivals = {half: forecasts_of_half(table, folds, half) for half in ("model", "trees", "logistic")}
    singles = features.single_indices(schema)
    rivals |= {feature.name: forecasts_of_index(table, folds, feature) for feature in singles}
    y, unit = table.outcome[tested], table.unit[tested]
    report: dict[str, Any] = {
        "fires": len(y),
        "large_fires": int(y.sum()),
        "units": [fold.name for fold in folds],
        "rows_without_weather": table.without_weather,
    }
    draws = _resampled_weights(unit, seed, resamples)
    for name, prevalence in PREVALENCES.items():
        weight = _weights(y, prevalence)
        report[name] = {
            rival: _row(
                y,
                forecast.score[tested],
                forecast.probability[name][tested],
                forecast.decided[name][tested],
                weight,
                draws,
            )
            for rival, forecast in rivals.items()
        }
    model = rivals["model"]
    report |= _headline(report, y, model.probability["natural"][tested], rate[tested], draws)
    return report | _against_indices(report, [feature.name for feature in singles], y, rivals, tested)


def _against_indices(
    report: dict[str, Any], singles: list[str], y: Array, rivals: dict[str, Forecasts], tested: npt.NDArray[np.bool_]
) -> dict[str, Any]:
    """Which single index does best, by how much the blend exceeds it, and how many fires each calls large."""
    rows = report["natural"]
    best = max(singles, key=lambda name: rows[name]["mcc"])
    called = {rival: _counts(forecast.decided["natural"][tested]) for rival, forecast in rivals.items()}
    return {
        "best_index_by_mcc": best,
        "best_index_by_auc": max(singles, key=lambda name: rows[name]["auc"]),
        "mcc_over_best_index": report["mcc"] / rows[best]["mcc"] if rows[best]["mcc"] > 0 else None,
        "counts": called | {"truth": _counts(y > 0)},
    }


def _counts(large: npt.NDArray[np.bool_]) -> dict[str, int]:
    return {"large": int(large.sum()), "small": int((~large).sum())}


def _resampled_weights(unit: npt.NDArray[np.str_], seed: int, resamples: int) -> list[Array]:
    """Per resampling, how often each fire's season or region was drawn; like draws are one array."""
    rng = np.random.default_rng(seed)
    names, index = np.unique(unit, return_inverse=True)
    made: dict[bytes, Array] = {}
    draws = []
    for _ in range(resamples):
        times = np.bincount(rng.integers(0, len(names), len(names)), minlength=len(names))
        draws.append(made.setdefault(times.tobytes(), times[index].astype(np.float64)))
    return draws


def _per_draw(measure: Callable[[Array], Any], draws: list[Array]) -> list[Any]:
    """A measure of each draw; of like draws (few seasons make few different ones) it is taken once."""
    known = {id(draw): draw for draw in draws}
    values = {key: measure(draw) for key, draw in known.items()}
    return [values[id(draw)] for draw in draws]


def _interval(measure: Callable[[Array], float], draws: list[Array]) -> list[float]:
    values = [value for value in _per_draw(measure, draws) if np.isfinite(value)]
    return [float(v) for v in np.quantile(values, [0.05, 0.95])] if values else []


def _row(
    y: Array, score: Array, probability: Array, decided: npt.NDArray[np.bool_], weight: Array, draws: list[Array]
) -> dict[str, Any]:
    def measures(w: Array) -> dict[str, float]:
        table = skill.confusion(y, decided, w)
        return {
            "auc": skill.auc(y, score, w),
            "mcc": table.mcc,
            "precision": table.precision,
            "recall": table.recall,
            "brier": skill.brier(y, probability, w),
            "calibration_error": skill.calibration_error(y, probability, weight=w),
        }

    point = measures(weight)
    drawn = _per_draw(lambda draw: measures(weight * draw), [draw for draw in draws if (draw * y).sum() > 0])
    spread = {
        f"{name}_interval": [float(v) for v in np.nanquantile([row[name] for row in drawn], [0.05, 0.95])]
        for name in SUMMARY
        if drawn
    }
    return point | spread


def _headline(report: dict[str, Any], y: Array, probability: Array, rate: Array, draws: list[Array]) -> dict[str, Any]:
    """The blend's row with what only a probability has: Brier skill over the base rate, slope, reliability."""

    def brier_skill(w: Array) -> float:
        return 1 - skill.brier(y, probability, w) / skill.brier(y, rate, w)

    ones = np.ones(len(y))
    bins = skill.reliability(y, probability)
    row = {name: report["natural"]["model"][name] for name in SUMMARY}
    return row | {
        "brier_base_rate": skill.brier(y, rate),
        "brier_skill": brier_skill(ones),
        "brier_skill_interval": _interval(brier_skill, [d for d in draws if (d * y).sum() > 0]),
        "calibration_slope": skill.calibration_slope(y, probability),
        "calibration_slope_interval": _interval(
            lambda w: skill.calibration_slope(y, probability, w), [d for d in draws[:100] if (d * y).sum() > 0]
        ),
        "reliability": [asdict(row) for row in bins],
        "top_decile": asdict(bins[-1]),
    }


def ablation(table: Table, folds_of: Callable[[tuple[features.Group, ...]], Sequence[Fold]]) -> list[dict[str, Any]]:
    """Skill as feature groups are added (index, + weather, + moisture, + land): trees, regression and blend."""
    rows = []
    for count in range(1, len(features.GROUPS) + 1):
        groups = features.GROUPS[:count]
        folds = folds_of(groups)
        tested = np.any([fold.now for fold in folds], axis=0)
        y, rate = table.outcome[tested], np.full(len(tested), np.nan)
        for fold in folds:
            rate[fold.now] = table.outcome[fold.earlier].mean()
        for half in HALVES:
            forecast = forecasts_of_half(table, folds, half)
            probability = forecast.probability["natural"][tested]
            rows.append(
                {
                    "columns": " + ".join(groups),
                    "learner": half,
                    "auc": skill.auc(y, forecast.score[tested]),
                    "mcc": skill.mcc(y, forecast.decided["natural"][tested]),
                    "brier_skill": 1 - skill.brier(y, probability) / skill.brier(y, rate[tested]),
                }
            )
    return rows
