"""Burned or not: an XGBoost classifier of looks with a calibrated probability."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xgboost as xgb
from numpy.typing import NDArray

from services.retrieval.ancillary.layers import ANCILLARY_FEATURES
from services.retrieval.looks.baseline import CHANGE_FEATURES, change_features
from services.retrieval.looks.features import SHAPE_FEATURES, STRENGTH_FEATURES, TEXTURE_FEATURES
from services.retrieval.ubj import is_whole_object
from shared.errors import DomainError

FEATURES = (*STRENGTH_FEATURES, *SHAPE_FEATURES, *TEXTURE_FEATURES, *CHANGE_FEATURES, "is_raw_if")
ALL_FEATURES = (*FEATURES, *ANCILLARY_FEATURES)
PARAMETERS = {
    "objective": "binary:logistic",
    "eval_metric": "logloss",
    "tree_method": "hist",
    "max_depth": 4,
    "eta": 0.05,
    "min_child_weight": 60,
    "subsample": 0.8,
    "colsample_bytree": 0.7,
    "lambda": 4.0,
}
ROUNDS = 150
MISSING_BASELINE_SHARE = 0.1  # of training looks, so that places without a baseline are known too


@dataclass(frozen=True)
class BurnedModel:
    """A booster with its calibration p = 1 / (1 + exp(-(a m + b))) of the margin m, threshold and features.

    ``base_rate`` is the burned share that the calibration was made on: p says more than it only by what the look saw.
    """

    booster: xgb.Booster
    slope: float
    intercept: float
    threshold: float
    features: tuple[str, ...]
    base_rate: float

    def probability(self, table: pd.DataFrame) -> NDArray[np.float64]:
        """Calibrated probability (n,) that each look's place has burned."""
        if not len(table):
            return np.empty(0)
        data = xgb.DMatrix(table[list(self.features)].to_numpy(np.float32), nthread=1)
        margin = self.booster.predict(data, output_margin=True).astype(np.float64)
        return 1.0 / (1.0 + np.exp(-(self.slope * margin + self.intercept)))

    def save(self, path: str | Path, attributes: Mapping[str, Any] | None = None) -> None:
        """Write UBJ; calibration, threshold, feature names and product attributes travel as booster attributes."""
        if attributes:
            self.booster.set_attr(product=json.dumps(dict(attributes), sort_keys=True))
        self.booster.set_attr(
            calibration=json.dumps([self.slope, self.intercept]),
            threshold=repr(self.threshold),
            base_rate=repr(self.base_rate),
            features=json.dumps(list(self.features)),
        )
        Path(path).write_bytes(bytes(self.booster.save_raw(raw_format="ubj")))


def load_model(path: str | Path) -> BurnedModel:
    """Read a model written by ``BurnedModel.save``; DomainError where the file is no such model."""
    content = Path(path).read_bytes()
    if not (is_whole_object(content) and b"gradient_booster" in content):
        raise DomainError(
            f"'{Path(path).name}' is no burned-area model, or not all of one.",
            field="model",
            accepted="a UBJ file written by train-burned-area",
        )
    try:
        booster = xgb.Booster(params={"nthread": 1}, model_file=bytearray(content))
        slope, intercept = json.loads(booster.attr("calibration") or "")
        threshold, base_rate = (float(booster.attr(name) or "") for name in ("threshold", "base_rate"))
        features = tuple(json.loads(booster.attr("features") or ""))
    except (ValueError, xgb.core.XGBoostError) as error:
        raise DomainError(
            f"'{Path(path).name}' is no burned-area model: {str(error).splitlines()[0]}",
            field="model",
            accepted="a UBJ file written by train-burned-area",
        ) from error
    unknown = sorted(set(features) - set(ALL_FEATURES))
    if unknown:
        accepted = ", ".join(ALL_FEATURES)
        raise DomainError(f"The model wants unknown features {unknown}.", field="model", accepted=accepted)
    return BurnedModel(booster, float(slope), float(intercept), threshold, features, base_rate)


def feature_table(looks: pd.DataFrame, baseline: pd.DataFrame | None) -> pd.DataFrame:
    """ALL_FEATURES of looks, aligned to them; ancillary ones are NaN where the looks do not have them."""
    table = looks[[*STRENGTH_FEATURES, *SHAPE_FEATURES, *TEXTURE_FEATURES]].copy()
    table[list(CHANGE_FEATURES)] = change_features(looks, baseline)
    table["is_raw_if"] = (looks["mode"] == "raw-if").astype(np.float64)
    for name in ANCILLARY_FEATURES:
        table[name] = looks[name].astype(np.float64) if name in looks.columns else np.nan
    return table


def train(
    table: pd.DataFrame,
    burned: NDArray[np.bool_],
    calibration: NDArray[np.bool_],
    features: tuple[str, ...] = FEATURES,
    rounds: int = ROUNDS,
    threads: int = 2,
    seed: int = 0,
) -> BurnedModel:
    """Train on looks where ``calibration`` is false; calibrate and set the threshold (best F0.5) where it is true.

    Both parts need burned and unburned looks. The same inputs give the same bytes.
    """
    for name, part in (("training", ~calibration), ("calibration", calibration)):
        if part.sum() < 20 or burned[part].all() or not burned[part].any():
            raise DomainError(
                f"The {name} looks ({int(part.sum())}, {int(burned[part].sum())} burned) do not hold both classes.",
                field="labels",
                accepted="at least 20 looks, burned and unburned ones",
            )
    values = _hide_baseline(table, seed)[list(features)].to_numpy(np.float32)
    data = xgb.DMatrix(values[~calibration], label=burned[~calibration].astype(np.float32), nthread=threads)
    booster = xgb.train({**PARAMETERS, "nthread": threads, "seed": seed}, data, num_boost_round=rounds)
    held = xgb.DMatrix(values[calibration], nthread=1)
    margin = booster.predict(held, output_margin=True).astype(np.float64)
    slope, intercept = platt(margin, burned[calibration])
    probability = 1.0 / (1.0 + np.exp(-(slope * margin + intercept)))
    threshold, base_rate = best_threshold(probability, burned[calibration]), float(burned[calibration].mean())
    return BurnedModel(booster, slope, intercept, threshold, tuple(features), base_rate)


def _hide_baseline(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    hidden = np.random.default_rng(seed).random(len(table)) < MISSING_BASELINE_SHARE
    shown = table.copy()
    shown.loc[hidden, [name for name in CHANGE_FEATURES if name in table.columns]] = np.nan
    return shown


def platt(margin: NDArray[np.float64], burned: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope and intercept of the logistic calibration (Platt 1999, with his target smoothing), by Newton steps."""
    positives, negatives = float(burned.sum()), float((~burned).sum())
    target = np.where(burned, (positives + 1.0) / (positives + 2.0), 1.0 / (negatives + 2.0))
    design = np.stack([margin, np.ones_like(margin)], axis=1)
    weights = np.array([1.0, 0.0])
    for _ in range(50):
        probability = 1.0 / (1.0 + np.exp(-design @ weights))
        gradient = design.T @ (probability - target)
        hessian = design.T @ (design * (probability * (1.0 - probability) + 1e-12)[:, None]) + 1e-9 * np.eye(2)
        step = np.linalg.solve(hessian, gradient)
        weights = weights - step
        if np.abs(step).max() < 1e-10:
            break
    return float(weights[0]), float(weights[1])


def best_threshold(probability: NDArray[np.float64], burned: NDArray[np.bool_], beta: float = 0.5) -> float:
    """The probability in 0.05..0.95 (steps of 0.01) that gives the best F-beta.

    Beta 0.5 weighs precision: a false burned point misleads the arrival map, while a missed one is looked at again.
    """
    steps = np.arange(5, 96) / 100.0
    called = probability[None, :] >= steps[:, None]
    hits = (called & burned[None, :]).sum(axis=1)
    weight = beta**2
    score = (1.0 + weight) * hits / np.maximum(called.sum(axis=1) + weight * burned.sum(), 1)
    return float(steps[int(score.argmax())])


def auc(score: NDArray[np.float64], burned: NDArray[np.bool_]) -> float:
    """Area under the ROC curve (Mann-Whitney, ties halved); NaN where one class is missing. NaN scores rank lowest."""
    values = pd.Series(np.where(np.isfinite(score), score, -np.inf))
    positives, negatives = int(burned.sum()), int((~burned).sum())
    if not positives or not negatives:
        return float("nan")
    ranks = values.rank().to_numpy()
    return float((ranks[burned].sum() - positives * (positives + 1) / 2.0) / (positives * negatives))


def confidence(probability: NDArray[np.float64], threshold: float) -> NDArray[np.float64]:
    """Confidence 0..100 in the verdict: 0 at the threshold, 100 at a probability of 0 or 1."""
    over = (probability - threshold) / (1.0 - threshold)
    under = (threshold - probability) / threshold
    return 100.0 * np.clip(np.where(probability >= threshold, over, under), 0.0, 1.0)
