"""NGBoost's normal distribution as plain arrays of trees, so that a model travels as JSON and never as a pickle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ROUNDS, LEARNING_RATE, DEPTH = 150, 0.05, 3
LEAF = -1


@dataclass(frozen=True)
class BoostedNormal:
    """Start parameters (mean, log sd) less the scaled values of trees for each of them; ``fill`` replaces NaN.

    Trees as arrays [tree, node] (``left`` -1: leaf), ``parameter`` 0 the mean, 1 the log sd; ``value`` is scaled.
    """

    start: FloatArray
    fill: FloatArray
    parameter: NDArray[np.int64]
    feature: NDArray[np.int64]
    threshold: FloatArray
    left: NDArray[np.int64]
    right: NDArray[np.int64]
    value: FloatArray

    def mean_sd(self, table: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and sd of each row, (n,)."""
        known = np.where(np.isfinite(table), table, self.fill).astype(np.float32)  # as scikit-learn compares
        parameters = np.tile(self.start, (len(table), 1))
        rows = np.arange(len(table))
        for tree, parameter in enumerate(self.parameter):
            node = np.zeros(len(table), dtype=np.int64)
            for _ in range(self.left.shape[1]):
                leaf = self.left[tree, node] == LEAF
                if leaf.all():
                    break
                goes_left = known[rows, np.maximum(self.feature[tree, node], 0)] <= self.threshold[tree, node]
                child = np.where(goes_left, self.left[tree, node], self.right[tree, node])
                node = np.where(leaf, node, child)
            parameters[:, parameter] -= self.value[tree, node]
        return parameters[:, 0], np.exp(parameters[:, 1])

    def score(self, table: FloatArray, departure: FloatArray) -> FloatArray:
        """Distance from the mean in sd, (n,)."""
        mean, sd = self.mean_sd(table)
        return np.abs(departure - mean) / sd

    def bounds(self, table: FloatArray, margin: float) -> FloatArray:
        """Mean and ``margin`` sd to either side, (n, 3)."""
        mean, sd = self.mean_sd(table)
        return np.stack([mean - margin * sd, mean, mean + margin * sd], axis=1)

    def as_document(self) -> dict[str, Any]:
        return {name: getattr(self, name).tolist() for name in self.__dataclass_fields__}

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> BoostedNormal:
        """The model of ``as_document``; ValueError or KeyError where it is none."""
        whole = ("parameter", "feature", "left", "right")
        read = {n: np.array(document[n], dtype=np.int64 if n in whole else float) for n in cls.__dataclass_fields__}
        shapes = {read[name].shape for name in ("feature", "threshold", "left", "right", "value")}
        if len(shapes) != 1 or read["start"].shape != (2,) or read["parameter"].shape != read["left"].shape[:1]:
            raise ValueError("arrays of trees do not fit together")
        nodes = read["left"].shape[1]
        if max(read["left"].max(), read["right"].max()) >= nodes or read["feature"].max() >= read["fill"].size:
            raise ValueError("a tree points beyond itself")
        return cls(**read)


def fit_boosted_normal(values: FloatArray, departure: FloatArray, seed: int) -> BoostedNormal:
    """NGBoost with a normal distribution and depth-3 trees, turned into arrays."""
    from ngboost import NGBRegressor
    from ngboost.distns import Normal
    from sklearn.tree import DecisionTreeRegressor

    with np.errstate(all="ignore"):
        fill = np.nan_to_num(np.nanmedian(np.where(np.isfinite(values), values, np.nan), axis=0))
    known = np.where(np.isfinite(values), values, fill)
    base = DecisionTreeRegressor(criterion="squared_error", max_depth=DEPTH, min_samples_leaf=20, random_state=seed)
    settings = {"n_estimators": ROUNDS, "learning_rate": LEARNING_RATE, "minibatch_frac": 1.0, "verbose": False}
    model = NGBRegressor(Dist=Normal, Base=base, random_state=seed, natural_gradient=True, **settings)
    model.fit(known, departure)
    return _as_arrays(model, fill)


def _as_arrays(model: Any, fill: FloatArray) -> BoostedNormal:
    trees = [
        (parameter, learner.tree_, model.learning_rate * scale)
        for learners, scale in zip(model.base_models, model.scalings, strict=True)
        for parameter, learner in enumerate(learners)
    ]
    nodes = max(tree.node_count for _, tree, _ in trees)

    def padded(name: str, empty: float) -> NDArray:
        rows = np.full((len(trees), nodes), empty)
        for index, (_, tree, _) in enumerate(trees):
            rows[index, : tree.node_count] = getattr(tree, name).reshape(tree.node_count)
        return rows

    value = padded("value", 0.0) * np.array([scale for _, _, scale in trees])[:, None]
    return BoostedNormal(
        start=np.array(model.init_params, dtype=np.float64),
        fill=fill,
        parameter=np.array([parameter for parameter, _, _ in trees]),
        feature=padded("feature", LEAF).astype(np.int64),
        threshold=padded("threshold", 0.0),
        left=padded("children_left", LEAF).astype(np.int64),
        right=padded("children_right", LEAF).astype(np.int64),
        value=value,
    )
