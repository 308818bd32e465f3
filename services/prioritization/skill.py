"""How good a probability is: ranking, decision at a threshold, calibration. Labels are 0/1, scores any real number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def auc(label: npt.ArrayLike, score: npt.ArrayLike) -> float:
    """Area under the ROC curve: the chance that a large fire scores above a small one, ties counted half."""
    from scipy.stats import rankdata

    y = np.asarray(label, dtype=bool)
    positive, negative = int(y.sum()), int((~y).sum())
    if positive == 0 or negative == 0:
        return float("nan")
    ranks = rankdata(np.asarray(score, dtype=np.float64))
    return float((ranks[y].sum() - positive * (positive + 1) / 2) / (positive * negative))


def mcc(label: npt.ArrayLike, predicted: npt.ArrayLike) -> float:
    """Matthews correlation of two 0/1 vectors; 0 where a margin of the table is empty."""
    y, p = np.asarray(label, dtype=bool), np.asarray(predicted, dtype=bool)
    tp, tn = float((y & p).sum()), float((~y & ~p).sum())
    fp, fn = float((~y & p).sum()), float((y & ~p).sum())
    scale = np.sqrt((tp + fp) * (tp + fn) * (tn + fp) * (tn + fn))
    return float((tp * tn - fp * fn) / scale) if scale else 0.0


def best_threshold(label: npt.ArrayLike, score: npt.ArrayLike) -> float:
    """The threshold (score >= threshold means large) of the largest MCC among the scores' own values."""
    y = np.asarray(label, dtype=bool)
    s = np.asarray(score, dtype=np.float64)
    order = np.argsort(-s, kind="stable")
    tp, fp = np.cumsum(y[order]).astype(float), np.cumsum(~y[order]).astype(float)
    fn, tn = y.sum() - tp, (~y).sum() - fp
    scale = np.sqrt((tp + fp) * (tp + fn) * (tn + fp) * (tn + fn))
    value = np.divide(tp * tn - fp * fn, scale, out=np.zeros_like(scale), where=scale > 0)
    last_of_tie = np.append(s[order][1:] != s[order][:-1], True)
    value[~last_of_tie] = -np.inf
    return float(s[order][int(np.argmax(value))])


def brier(label: npt.ArrayLike, probability: npt.ArrayLike) -> float:
    """Mean squared error of a probability."""
    return float(np.mean((np.asarray(probability, dtype=np.float64) - np.asarray(label, dtype=np.float64)) ** 2))


def fit_logistic(
    label: npt.ArrayLike, score: npt.ArrayLike, weight: npt.ArrayLike | None = None
) -> tuple[float, float]:
    """Slope and intercept of the logistic regression of a label on a score (Newton, a trace of ridge).

    With Platt's targets ((n+1)/(n+2) and 1/(n+2)) in place of 1 and 0, so that separable data stay finite.
    """
    s = np.asarray(score, dtype=np.float64)
    y = np.asarray(label, dtype=np.float64)
    w = np.ones_like(s) if weight is None else np.asarray(weight, dtype=np.float64)
    positive, negative = float((w * y).sum()), float((w * (1 - y)).sum())
    target = np.where(y > 0.5, (positive + 1) / (positive + 2), 1 / (negative + 2))
    design = np.stack([s, np.ones_like(s)])
    beta = np.array([1.0, 0.0])
    for _ in range(50):
        p = 1 / (1 + np.exp(-np.clip(beta @ design, -35, 35)))
        gradient = design @ (w * (target - p))
        hessian = (design * (w * p * (1 - p))) @ design.T + 1e-9 * np.eye(2)
        step = np.linalg.solve(hessian, gradient)
        beta = beta + np.clip(step, -5, 5)
        if np.abs(step).max() < 1e-10:
            break
    return float(beta[0]), float(beta[1])


def calibration_slope(label: npt.ArrayLike, probability: npt.ArrayLike) -> float:
    """Slope of the logistic regression of label on logit of probability: 1 is right, below 1 overconfident."""
    p = np.clip(np.asarray(probability, dtype=np.float64), 1e-9, 1 - 1e-9)
    return fit_logistic(label, np.log(p / (1 - p)))[0]


@dataclass(frozen=True)
class ReliabilityBin:
    """Fires of one tenth of the forecast: how many, what was said, what came."""

    count: int
    forecast: float
    observed: float


def reliability(label: npt.ArrayLike, probability: npt.ArrayLike, bins: int = 10) -> list[ReliabilityBin]:
    """Forecast and observed frequency in bins of equal count, from the lowest forecasts to the highest."""
    y, p = np.asarray(label, dtype=np.float64), np.asarray(probability, dtype=np.float64)
    parts = np.array_split(np.argsort(p, kind="stable"), bins)
    return [ReliabilityBin(len(i), float(p[i].mean()), float(y[i].mean())) for i in parts if len(i)]


def calibration_error(label: npt.ArrayLike, probability: npt.ArrayLike, bins: int = 10) -> float:
    """Expected calibration error over bins of equal count."""
    table = reliability(label, probability, bins)
    total = sum(row.count for row in table)
    return sum(row.count * abs(row.forecast - row.observed) for row in table) / total
