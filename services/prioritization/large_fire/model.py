"""The large-fire model: half gradient-boosted trees (XGBoost), half logistic regression, calibrated on unseen fires.

The trees start from a logistic regression on the log of the strongest single index of the schema and learn what that
index misses; eight trees a round, each on a part of the fires and columns, stand for a bagged ensemble. The margin is
the mean of the trees' and the regression's log odds (``linear``). Trained without reweighting (which ruins
probabilities) and calibrated by Platt's logistic on margins of fires that their model has not seen. The interval of a
probability comes from refitting the calibration to resampled seasons, since fires of one season are not independent.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xgboost as xgb

from services.prioritization.large_fire import features, linear, reference_groups, skill
from services.prioritization.large_fire.reference_groups import ReferenceGroups
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

PARAMETERS: dict[features.Schema, dict[str, Any]] = {
    "loop": {"max_depth": 2, "eta": 0.05, "subsample": 0.6, "colsample_bynode": 0.5, "min_child_weight": 20},
    "full": {"max_depth": 4, "eta": 0.05, "subsample": 0.6, "colsample_bynode": 0.3, "min_child_weight": 2},
    "us": {"max_depth": 2, "eta": 0.05, "subsample": 0.6, "colsample_bynode": 0.3, "min_child_weight": 3},
}
ROUNDS: dict[features.Schema, int] = {"loop": 40, "full": 80, "us": 30}
TREES_PER_ROUND = 8
START_INDEX: dict[features.Schema, str] = {"loop": "ffdi_dry", "full": "ffdi_dry", "us": "erc"}
TREE_SHARE = 0.5
RESAMPLES = 200


@dataclass(frozen=True)
class Calibration:
    """What turns a margin into a probability, and what a rating needs to know of the training fires.

    ``start``: slope and intercept of the trees' logistic start. ``slope``, ``intercept``: Platt. ``resampled``: (slope,
    intercept) per resampling of seasons. ``groups``: margins of the training fires by kind of place and season.
    ``median``, ``low``, ``high``: per feature, of the training fires. ``threshold``: probability from which a fire is
    called large, of the largest expected MCC.
    """

    schema: features.Schema
    start: tuple[float, float]
    linear: linear.LinearPart
    slope: float
    intercept: float
    resampled: list[tuple[float, float]]
    threshold: float
    groups: ReferenceGroups
    median: dict[str, float]
    low: dict[str, float]
    high: dict[str, float]
    base_rate: float
    fires: int
    large_fires: int
    seasons: list[str]
    label: str

    def probability(self, margin: Array) -> tuple[Array, Array, Array]:
        """Probability with its 5 and 95 % bounds, each the shape of ``margin``."""
        point = sigmoid(self.slope * margin + self.intercept)
        pairs = np.asarray(self.resampled)
        draws = sigmoid(pairs[:, :1] * margin[None, :] + pairs[:, 1:])
        low, high = np.quantile(draws, [0.05, 0.95], axis=0)
        return point, np.minimum(low, point), np.maximum(high, point)


@dataclass(frozen=True)
class Parts:
    """The fitted halves: trees with their logistic start, and the regression."""

    trees: xgb.Booster
    start: tuple[float, float]
    linear: linear.LinearPart
    schema: features.Schema

    def halves(self, frame: pd.DataFrame) -> tuple[Array, Array]:
        """Log odds of the trees and of the regression, each (rows,)."""
        names = list(self.trees.feature_names or ())
        matrix = _matrix(frame, names, self.start, START_INDEX[self.schema])
        trees = self.trees.predict(matrix, output_margin=True).astype(np.float64)
        return trees, self.linear.margin(frame)

    def margin(self, frame: pd.DataFrame) -> Array:
        """The blend's log odds before calibration, one per row."""
        trees, line = self.halves(frame)
        return TREE_SHARE * trees + (1 - TREE_SHARE) * line


@dataclass(frozen=True)
class LargeFireModel:
    """Trees and calibration (with the regression); the file of the trees carries both."""

    booster: xgb.Booster
    calibration: Calibration

    @property
    def features(self) -> tuple[features.Feature, ...]:
        return tuple(features.BY_NAME[name] for name in self.calibration.median)

    @property
    def parts(self) -> Parts:
        kept = self.calibration
        return Parts(self.booster, kept.start, kept.linear, kept.schema)

    def margin(self, frame: pd.DataFrame) -> Array:
        """Log odds before calibration, one per row."""
        return self.parts.margin(frame)

    def contributions(self, frame: pd.DataFrame) -> Array:
        """Each feature's part of the margin, shape (rows, features), without the constant.

        TreeSHAP for the trees and term by term for the regression; the trees' start, against the median training
        fire, belongs to its index.
        """
        names = [feature.name for feature in self.features]
        start_index = START_INDEX[self.calibration.schema]
        matrix = _matrix(frame, names, self.calibration.start, start_index)
        trees = self.booster.predict(matrix, pred_contribs=True).reshape(-1, len(names) + 1)[:, :-1].astype(np.float64)
        typical = pd.DataFrame({start_index: [self.calibration.median[start_index]]})
        start = [_start_margin(rows, self.calibration.start, start_index) for rows in (frame, typical)]
        trees[:, names.index(start_index)] += start[0] - start[1]
        line = self.calibration.linear.contributions(frame, names)
        return TREE_SHARE * trees + (1 - TREE_SHARE) * line

    def save(self, path: Path) -> None:
        """One UBJ file; the calibration travels inside it, so that a reference to the file is the whole model."""
        self.booster.set_attr(calibration=json.dumps(asdict(self.calibration), sort_keys=True))
        self.booster.save_model(str(path))


def load(path: Path) -> LargeFireModel:
    """Read a model written by ``LargeFireModel.save``; DomainError if the file is none."""
    content = path.read_bytes()
    refused = DomainError("The model is not an XGBoost UBJ file.", field="model", accepted=".ubj")
    # XGBoost aborts the whole process on bytes that are no UBJ object, so look at both ends first.
    if not (content.startswith(b"{L") and content.endswith(b"}")):
        raise refused
    booster = xgb.Booster(params={"nthread": 2})
    try:
        booster.load_model(bytearray(content))
        text = booster.attr("calibration")
    except xgb.core.XGBoostError as error:
        raise refused from error
    try:
        return LargeFireModel(booster, _calibration(json.loads(text or "{}"), booster))
    except (KeyError, TypeError, ValueError) as error:
        raise DomainError(
            "The model carries no calibration of this version: make it with train-large-fire-model.",
            field="model",
            accepted=".ubj",
        ) from error


def _calibration(stated: dict[str, Any], booster: xgb.Booster) -> Calibration:
    stated["start"] = tuple(stated["start"])
    stated["resampled"] = [tuple(pair) for pair in stated["resampled"]]
    stated["linear"] = linear.LinearPart(**stated["linear"])
    stated["groups"] = ReferenceGroups(**stated["groups"])
    # JSON sorts the names; the trees know the order that they were trained in.
    for name in ("median", "low", "high"):
        stated[name] = {feature: stated[name][feature] for feature in booster.feature_names or ()}
    return Calibration(**stated)


def shipped_path() -> Path:
    """The model that comes with the service, trained on the Victorian fires of 2007-08 to 2017-18."""
    return Path(__file__).parent.parent / "models" / "large_fire.ubj"


def sigmoid(value: Array) -> Array:
    return 1 / (1 + np.exp(-np.clip(value, -35, 35)))


def _log_start(frame: pd.DataFrame, index: str) -> Array:
    return np.log(np.maximum(frame[index].to_numpy(dtype=np.float64), 1e-6))


def _start_margin(frame: pd.DataFrame, start: tuple[float, float], index: str) -> Array:
    return start[0] * _log_start(frame, index) + start[1]


def _matrix(
    frame: pd.DataFrame, names: Sequence[str], start: tuple[float, float], index: str, label: Array | None = None
) -> xgb.DMatrix:
    missing = [name for name in names if name not in frame.columns]
    if missing:
        raise DomainError(f"The table lacks the column '{missing[0]}'.", field=missing[0], accepted=", ".join(names))
    values = frame[list(names)].to_numpy(dtype=np.float64)
    margin = _start_margin(frame, start, index)
    return xgb.DMatrix(values, label=label, base_margin=margin, feature_names=list(names), nthread=2)


def fit_parts(
    frame: pd.DataFrame,
    label: Array,
    schema: features.Schema,
    seed: int = 0,
    groups: tuple[features.Group, ...] = features.GROUPS,
) -> Parts:
    """Both halves on all rows (log loss, two threads, no reweighting), on the columns of some feature groups.

    The trees are monotone in the features whose sign physics fixes.
    """
    columns = features.features_of(schema, groups)
    names = [feature.name for feature in columns]
    index = START_INDEX[schema]
    start = skill.fit_logistic(label, _log_start(frame, index))
    signs = ",".join(str(feature.monotone) for feature in columns)
    parameters = PARAMETERS[schema] | {
        "objective": "binary:logistic",
        "num_parallel_tree": TREES_PER_ROUND,
        "nthread": 2,
        "seed": seed,
        "base_score": 0.5,
        "monotone_constraints": f"({signs})",
    }
    trees = xgb.train(parameters, _matrix(frame, names, start, index, label), ROUNDS[schema])
    return Parts(trees, start, linear.fit(frame, label, names), schema)


def train(
    frame: pd.DataFrame,
    label: Array,
    unit: npt.NDArray[np.str_],
    unseen_margin: Array,
    schema: features.Schema,
    label_name: str,
    seed: int = 0,
) -> LargeFireModel:
    """Both halves on every fire, Platt calibration on ``unseen_margin``, intervals by resampling ``unit``.

    ``unseen_margin`` (n,) is each fire's margin by a model that has not seen its unit (see ``validation``), NaN where
    there is none; ``unit`` the season (or region) of each fire.
    """
    scored = np.isfinite(unseen_margin)
    margin, outcome = unseen_margin[scored], label[scored]
    slope, intercept = skill.fit_logistic(outcome, margin)
    parts = fit_parts(frame, label, schema, seed)
    values = frame[list(parts.trees.feature_names or ())].astype(np.float64)
    calibration = Calibration(
        schema=schema,
        start=parts.start,
        linear=parts.linear,
        slope=slope,
        intercept=intercept,
        resampled=_resampled_platt(outcome, margin, unit[scored], seed),
        threshold=skill.expected_mcc_threshold(sigmoid(slope * margin + intercept)),
        groups=reference_groups.of_fires(frame[scored], margin),
        median={name: float(values[name].median()) for name in values},
        low={name: float(values[name].quantile(0.001)) for name in values},
        high={name: float(values[name].quantile(0.999)) for name in values},
        base_rate=float(label.mean()),
        fires=len(label),
        large_fires=int(label.sum()),
        seasons=sorted(set(unit)),
        label=label_name,
    )
    return LargeFireModel(parts.trees, calibration)


def _resampled_platt(label: Array, margin: Array, unit: npt.NDArray[np.str_], seed: int) -> list[tuple[float, float]]:
    rng = np.random.default_rng(seed)
    names, index = np.unique(unit, return_inverse=True)
    pairs = []
    for _ in range(RESAMPLES):
        weight = np.bincount(rng.integers(0, len(names), len(names)), minlength=len(names))[index].astype(float)
        if (weight * label).sum() >= 5:
            pairs.append(skill.fit_logistic(label, margin, weight))
    return pairs
