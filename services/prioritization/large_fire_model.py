"""The large-fire model: gradient-boosted trees on weather and drought, calibrated on seasons it has not seen.

The trees start from a logistic regression on the log of the strongest single index (the dry-limit FFDI) and learn what
that index misses: with so few large fires, trees from nothing ranked fires worse than the index alone.

Trained without reweighting (which ruins probabilities) and calibrated by Platt's logistic on rolling-origin scores:
every season is scored by trees of the earlier ones. The interval of a probability comes from refitting the
calibration to resampled seasons, since fires of one season are not independent.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xgboost as xgb

from services.prioritization import features, skill
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

PARAMETERS: dict[features.Schema, dict[str, Any]] = {
    "loop": {"max_depth": 2, "eta": 0.05, "subsample": 0.8, "min_child_weight": 20},
    "full": {"max_depth": 3, "eta": 0.05, "subsample": 0.8, "colsample_bytree": 0.6, "min_child_weight": 5},
}
START_INDEX = "ffdi_dry"
ROUNDS: dict[features.Schema, int] = {"loop": 40, "full": 100}
FIRST_SCORED_SEASONS = 3
RESAMPLES = 200


@dataclass(frozen=True)
class Calibration:
    """What turns a tree margin into a probability, and what a rating needs to know of the training fires.

    ``start``: slope and intercept of the logistic start on log ``ffdi_dry``. ``slope``, ``intercept``: Platt.
    ``resampled``: (slope, intercept) per resampling of seasons. ``score_quantiles``: 101 quantiles of the calibration
    margins. ``median``, ``low``, ``high``: per feature, of the training fires.
    """

    schema: features.Schema
    start: tuple[float, float]
    slope: float
    intercept: float
    resampled: list[tuple[float, float]]
    score_quantiles: list[float]
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

    def percentile(self, margin: Array) -> Array:
        """Share of the training fires (per cent) that scored lower."""
        return np.interp(margin, self.score_quantiles, np.linspace(0, 100, len(self.score_quantiles)))


@dataclass(frozen=True)
class LargeFireModel:
    """Trees and their calibration; ``name`` identifies the pair in ratings and reports."""

    booster: xgb.Booster
    calibration: Calibration

    @property
    def features(self) -> tuple[features.Feature, ...]:
        return features.features_of(self.calibration.schema)

    def margin(self, frame: pd.DataFrame) -> Array:
        """Raw tree margin (log odds before calibration), one per row."""
        matrix = _matrix(frame, self.calibration.schema, self.calibration.start)
        return self.booster.predict(matrix, output_margin=True).astype(np.float64)

    def contributions(self, frame: pd.DataFrame) -> Array:
        """Each feature's part of the margin, shape (rows, features), without the constant.

        TreeSHAP for the trees; the start's part, against the median training fire, belongs to its index.
        """
        matrix = _matrix(frame, self.calibration.schema, self.calibration.start)
        parts = self.booster.predict(matrix, pred_contribs=True)[:, :-1].astype(np.float64)
        typical = pd.DataFrame({START_INDEX: [self.calibration.median[START_INDEX]]})
        index = [feature.name for feature in self.features].index(START_INDEX)
        parts[:, index] += _start_margin(frame, self.calibration.start) - _start_margin(typical, self.calibration.start)
        return parts

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
    if not text:
        raise DomainError(
            "The model carries no calibration: make it with train-large-fire-model.", field="model", accepted=".ubj"
        )
    stated = json.loads(text)
    stated["start"] = tuple(stated["start"])
    stated["resampled"] = [tuple(pair) for pair in stated["resampled"]]
    return LargeFireModel(booster, Calibration(**stated))


def shipped_path() -> Path:
    """The model that comes with the service, trained on the Victorian fires of 2007-08 to 2017-18."""
    return Path(__file__).parent / "models" / "large_fire.ubj"


def sigmoid(value: Array) -> Array:
    return 1 / (1 + np.exp(-np.clip(value, -35, 35)))


def _log_start(frame: pd.DataFrame) -> Array:
    return np.log(np.maximum(frame[START_INDEX].to_numpy(dtype=np.float64), 1e-6))


def _start_margin(frame: pd.DataFrame, start: tuple[float, float]) -> Array:
    return start[0] * _log_start(frame) + start[1]


def _matrix(
    frame: pd.DataFrame, schema: features.Schema, start: tuple[float, float], label: Array | None = None
) -> xgb.DMatrix:
    names = [feature.name for feature in features.features_of(schema)]
    missing = [name for name in names if name not in frame.columns]
    if missing:
        raise DomainError(f"The table lacks the column '{missing[0]}'.", field=missing[0], accepted=", ".join(names))
    values = frame[names].to_numpy(dtype=np.float64)
    margin = _start_margin(frame, start)
    return xgb.DMatrix(values, label=label, base_margin=margin, feature_names=names, nthread=2)


def train_trees(
    frame: pd.DataFrame, label: Array, schema: features.Schema, seed: int = 0
) -> tuple[xgb.Booster, tuple[float, float]]:
    """Boosted trees on a logistic start (log loss, two threads, no reweighting), and the start's slope and intercept.

    Monotone in the features whose sign physics fixes.
    """
    start = skill.fit_logistic(label, _log_start(frame))
    signs = ",".join(str(feature.monotone) for feature in features.features_of(schema))
    parameters = PARAMETERS[schema] | {
        "objective": "binary:logistic",
        "nthread": 2,
        "seed": seed,
        "base_score": 0.5,
        "monotone_constraints": f"({signs})",
    }
    return xgb.train(parameters, _matrix(frame, schema, start, label), ROUNDS[schema]), start


def rolling_margins(
    frame: pd.DataFrame, label: Array, season: npt.NDArray[np.str_], schema: features.Schema, seed: int = 0
) -> Array:
    """Margin of each fire from trees of earlier seasons only; NaN in the first three seasons."""
    margins = np.full(len(frame), np.nan)
    for name in sorted(set(season))[FIRST_SCORED_SEASONS:]:
        earlier, now = season < name, season == name
        if len(set(label[earlier])) < 2:
            continue
        trees, start = train_trees(frame[earlier], label[earlier], schema, seed)
        margins[now] = trees.predict(_matrix(frame[now], schema, start), output_margin=True)
    return margins


def checked_label(table: pd.DataFrame, label: str, season: str) -> tuple[pd.DataFrame, Array, npt.NDArray[np.str_]]:
    for field, name in (("label", label), ("season_column", season)):
        if name not in table.columns:
            raise DomainError(f"The table has no column '{name}'.", field=field, value=name, accepted="a column's name")
    kept = table[table[label].notna() & table[season].notna()].reset_index(drop=True)
    y = kept[label].to_numpy(dtype=np.float64)
    if not np.isin(y, (0, 1)).all():
        raise DomainError(f"Column '{label}' holds more than 0 and 1.", field="label", value=label, accepted="0 or 1")
    seasons = kept[season].astype(str).to_numpy()
    if len(set(seasons)) < FIRST_SCORED_SEASONS + 2 or not 10 <= y.sum() <= len(y) - 10:
        raise DomainError(
            f"{len(set(seasons))} seasons with {int(y.sum())} large of {len(y)} fires are too few to calibrate on "
            "seasons unseen.",
            field="table",
            accepted="5 or more seasons, 10 or more fires of each kind",
        )
    return kept, y, seasons


def train(
    table: pd.DataFrame, label: str, season: str, schema: features.Schema = "loop", seed: int = 0
) -> LargeFireModel:
    """Trees on every season, Platt calibration on the rolling-origin margins, intervals by resampling seasons.

    ``table`` holds the schema's columns (see ``features``), ``label`` 0/1 and ``season`` texts that sort in time.
    """
    kept, y, seasons = checked_label(table, label, season)
    margins = rolling_margins(kept, y, seasons, schema, seed)
    scored = np.isfinite(margins)
    slope, intercept = skill.fit_logistic(y[scored], margins[scored])
    names = [feature.name for feature in features.features_of(schema)]
    values = kept[names].astype(np.float64)
    trees, start = train_trees(kept, y, schema, seed)
    calibration = Calibration(
        schema=schema,
        start=start,
        slope=slope,
        intercept=intercept,
        resampled=_resampled_platt(y[scored], margins[scored], seasons[scored], seed),
        score_quantiles=[float(q) for q in np.quantile(margins[scored], np.linspace(0, 1, 101))],
        median={name: float(values[name].median()) for name in names},
        low={name: float(values[name].quantile(0.001)) for name in names},
        high={name: float(values[name].quantile(0.999)) for name in names},
        base_rate=float(y.mean()),
        fires=len(y),
        large_fires=int(y.sum()),
        seasons=sorted(set(seasons)),
        label=label,
    )
    return LargeFireModel(trees, calibration)


def _resampled_platt(label: Array, margin: Array, season: npt.NDArray[np.str_], seed: int) -> list[tuple[float, float]]:
    rng = np.random.default_rng(seed)
    names, index = np.unique(season, return_inverse=True)
    pairs = []
    for _ in range(RESAMPLES):
        weight = np.bincount(rng.integers(0, len(names), len(names)), minlength=len(names))[index].astype(float)
        if (weight * label).sum() >= 5:
            pairs.append(skill.fit_logistic(label, margin, weight))
    return pairs
