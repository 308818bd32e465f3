"""Conformal calibration grouped by site: sites are exchangeable, looks of a site are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COVERAGE = 0.90
Z90 = 1.6449  # half width of the 90 % interval in standard deviations of a normal


def grouped_quantile(score: NDArray[np.float64], group: NDArray, coverage: float = COVERAGE) -> float:
    """The score that a new look of a new group stays under with at least ``coverage``.

    Every group weighs the same whatever its size, and the unseen group weighs as one at infinity (Lee, Barber and
    Willett 2023, hierarchical conformal prediction; Dunn, Wasserman and Ramdas 2022). With so few groups that only
    infinity would do (fewer than 9 for 90 %), the greatest score.
    """
    groups, index, size = np.unique(group, return_inverse=True, return_counts=True)
    weight = 1.0 / ((groups.size + 1.0) * size[index])
    order = np.argsort(score, kind="stable")
    reached = np.cumsum(weight[order]) >= coverage - 1e-12
    return float(score[order][reached.argmax() if reached.any() else -1])


def site_folds(site: NDArray, folds: int) -> NDArray[np.int64]:
    """Fold of each row, whole sites together: sites dealt out in their order, (n,)."""
    return np.unique(site, return_inverse=True)[1] % folds
