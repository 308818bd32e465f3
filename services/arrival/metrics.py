"""Errors of an arrival map against a known truth, and overlaps of burned areas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def mean_error_h(arrival_h: Floats, truth_h: Floats) -> tuple[float, float]:
    """(mean absolute error, bias) in hours over cells burned in both (finite); (NaN, NaN) where none is. Bias > 0:
    too late."""
    both = np.isfinite(arrival_h) & np.isfinite(truth_h)
    if not both.any():
        return float("nan"), float("nan")
    error = arrival_h[both] - truth_h[both]
    return float(np.abs(error).mean()), float(error.mean())


def sorensen(first: Mask, second: Mask) -> float:
    """Sorensen coefficient 2|A and B| / (|A| + |B|) of two masks, which for extent is also F1; 1.0 where both are
    empty."""
    total = int(first.sum()) + int(second.sum())
    return 1.0 if total == 0 else float(2.0 * (first & second).sum() / total)


def interval_coverage(low_h: Floats, high_h: Floats, truth_h: Floats) -> float:
    """Share of cells burned in both whose truth lies within [low, high]."""
    both = np.isfinite(low_h) & np.isfinite(high_h) & np.isfinite(truth_h)
    inside = (truth_h[both] >= low_h[both]) & (truth_h[both] <= high_h[both])
    return float(inside.mean()) if both.any() else float("nan")


def crps_normal_h(mean_h: Floats, sd_h: Floats, truth_h: Floats) -> float:
    """Mean continuous ranked probability score, hours, of normal forecasts (Gneiting & Raftery 2007, eq. 21)."""
    from scipy.stats import norm

    both = np.isfinite(mean_h) & np.isfinite(truth_h) & (sd_h > 0)
    z = (truth_h[both] - mean_h[both]) / sd_h[both]
    score = sd_h[both] * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    return float(score.mean()) if both.any() else float("nan")
