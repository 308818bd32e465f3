"""How good a probability is: ranking, decision at a threshold, calibration. Labels are 0/1, scores any real number.

``weight`` (default 1 each) counts a fire more than once: resampled seasons, or small fires thinned to 1:2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def _weights(label: npt.ArrayLike, weight: npt.ArrayLike | None) -> tuple[npt.NDArray[np.bool_], Array]:
    y = np.asarray(label, dtype=bool)
    return y, np.ones(len(y)) if weight is None else np.asarray(weight, dtype=np.float64)


def auc(label: npt.ArrayLike, score: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> float:
    """Area under the ROC curve: the chance that a large fire scores above a small one, ties counted half."""
    y, w = _weights(label, weight)
    values, place = np.unique(np.asarray(score, dtype=np.float64), return_inverse=True)
    large = np.bincount(place, w * y, len(values))
    small = np.bincount(place, w * ~y, len(values))
    total = large.sum() * small.sum()
    below = np.cumsum(small) - small
    return float((large * (below + small / 2)).sum() / total) if total > 0 else float("nan")


@dataclass(frozen=True)
class Confusion:
    """The 2 x 2 table of a decision, as (weighted) counts."""

    tp: float
    fp: float
    fn: float
    tn: float

    @property
    def mcc(self) -> float:
        """Matthews correlation; 0 where a margin of the table is empty."""
        scale = np.sqrt((self.tp + self.fp) * (self.tp + self.fn) * (self.tn + self.fp) * (self.tn + self.fn))
        return float((self.tp * self.tn - self.fp * self.fn) / scale) if scale else 0.0

    @property
    def precision(self) -> float:
        return self.tp / (self.tp + self.fp) if self.tp + self.fp else 0.0

    @property
    def recall(self) -> float:
        return self.tp / (self.tp + self.fn) if self.tp + self.fn else 0.0


def confusion(label: npt.ArrayLike, predicted: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> Confusion:
    """The table of a label and a 0/1 decision."""
    y, w = _weights(label, weight)
    p = np.asarray(predicted, dtype=bool)
    return Confusion(*(float(w[cell].sum()) for cell in (y & p, ~y & p, y & ~p, ~y & ~p)))


def mcc(label: npt.ArrayLike, predicted: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> float:
    """Matthews correlation of two 0/1 vectors; 0 where a margin of the table is empty."""
    return confusion(label, predicted, weight).mcc


def best_threshold(label: npt.ArrayLike, score: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> float:
    """The threshold (score >= threshold means large) of the largest MCC among the scores' own values; NaN ignored."""
    y, w = _weights(label, weight)
    s = np.asarray(score, dtype=np.float64)
    known = np.isfinite(s)
    y, w, s = y[known], w[known], s[known]
    return _largest_mcc(s, w * y, w * ~y)


def expected_mcc_threshold(probability: npt.ArrayLike, small_weight: float = 1.0) -> float:
    """The probability threshold of the largest MCC that calibrated probabilities themselves expect.

    It needs no labels, so it does not chase the few large fires of the training seasons. ``small_weight`` counts each
    small fire so often (for another prevalence; the probabilities stay those of the table).
    """
    p = np.asarray(probability, dtype=np.float64)
    p = p[np.isfinite(p)]
    return _largest_mcc(p, p, small_weight * (1 - p))


def _largest_mcc(score: Array, large: Array, small: Array) -> float:
    """Threshold of the largest MCC where each fire counts ``large`` large and ``small`` small ones."""
    order = np.argsort(-score, kind="stable")
    tp, fp = np.cumsum(large[order]), np.cumsum(small[order])
    fn, tn = tp[-1] - tp, fp[-1] - fp
    scale = np.sqrt(np.maximum((tp + fp) * (tp + fn) * (tn + fp) * (tn + fn), 0))
    value = np.divide(tp * tn - fp * fn, scale, out=np.zeros_like(scale), where=scale > 1e-9)
    last_of_tie = np.append(score[order][1:] != score[order][:-1], True)
    value[~last_of_tie] = -np.inf
    return float(score[order][int(np.argmax(value))])


def brier(label: npt.ArrayLike, probability: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> float:
    """Mean squared error of a probability."""
    y, w = _weights(label, weight)
    return float(np.average((np.asarray(probability, dtype=np.float64) - y) ** 2, weights=w))


def fit_logistic(
    label: npt.ArrayLike, score: npt.ArrayLike, weight: npt.ArrayLike | None = None
) -> tuple[float, float]:
    """Slope and intercept of the logistic regression of a label on a score (damped Newton, a trace of ridge).

    With Platt's targets ((n+1)/(n+2) and 1/(n+2)) in place of 1 and 0, so that separable data stay finite.
    """
    s = np.asarray(score, dtype=np.float64)
    y, w = _weights(label, weight)
    positive, negative = float((w * y).sum()), float((w * ~y).sum())
    target = np.where(y, (positive + 1) / (positive + 2), 1 / (negative + 2))
    centre = float(np.average(s, weights=w))
    spread = float(np.sqrt(np.average((s - centre) ** 2, weights=w))) or 1.0
    design = np.stack([(s - centre) / spread, np.ones_like(s)])
    rate = float(np.average(target, weights=w))
    beta = np.array([0.0, np.log(rate / (1 - rate))])
    loss = _log_loss(beta @ design, target, w)
    for _ in range(50):
        p = 1 / (1 + np.exp(-np.clip(beta @ design, -35, 35)))
        gradient = design @ (w * (target - p))
        hessian = (design * (w * p * (1 - p))) @ design.T + 1e-9 * np.eye(2)
        step = np.linalg.solve(hessian, gradient)
        tried = _log_loss((beta + step) @ design, target, w)
        while tried > loss + 1e-12 and np.abs(step).max() > 1e-10:  # Newton overshoots on heavy-tailed scores
            step = step / 2
            tried = _log_loss((beta + step) @ design, target, w)
        beta, loss = beta + step, tried
        if np.abs(step).max() < 1e-10:
            break
    return float(beta[0] / spread), float(beta[1] - beta[0] * centre / spread)


def _log_loss(margin: Array, target: Array, weight: Array) -> float:
    return float((weight * (np.logaddexp(0, margin) - target * margin)).sum())


def calibration_slope(label: npt.ArrayLike, probability: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> float:
    """Slope of the logistic regression of label on logit of probability: 1 is right, below 1 overconfident."""
    p = np.clip(np.asarray(probability, dtype=np.float64), 1e-9, 1 - 1e-9)
    return fit_logistic(label, np.log(p / (1 - p)), weight)[0]


@dataclass(frozen=True)
class ReliabilityBin:
    """Fires of one tenth of the forecast: how many, what was said, what came."""

    count: float
    forecast: float
    observed: float


def reliability(
    label: npt.ArrayLike, probability: npt.ArrayLike, bins: int = 10, weight: npt.ArrayLike | None = None
) -> list[ReliabilityBin]:
    """Forecast and observed frequency in bins of equal count, from the lowest forecasts to the highest."""
    y, w = _weights(label, weight)
    p = np.asarray(probability, dtype=np.float64)
    parts = np.array_split(np.argsort(p, kind="stable"), bins)
    return [
        ReliabilityBin(float(w[i].sum()), float(np.average(p[i], weights=w[i])), float(np.average(y[i], weights=w[i])))
        for i in parts
        if w[i].sum() > 0
    ]


def calibration_error(
    label: npt.ArrayLike, probability: npt.ArrayLike, bins: int = 10, weight: npt.ArrayLike | None = None
) -> float:
    """Expected calibration error over bins of equal count."""
    table = reliability(label, probability, bins, weight)
    total = sum(row.count for row in table)
    return sum(row.count * abs(row.forecast - row.observed) for row in table) / total
