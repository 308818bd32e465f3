"""Where a sampled function of time is positive: edges refined far below the step, short visits found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TimeFunction = Callable[[Array], Array]

EDGE_TOLERANCE_S = 1e-6


def positive_intervals(function: TimeFunction, t_s: Array) -> list[tuple[float, float]]:
    """Intervals of [t_s[0], t_s[-1]] on which a smooth function is positive, in order, edges within 1e-6 s.

    ``function`` takes times (k,) and gives values (k,); ``t_s`` are increasing sample times fine enough that between
    neighbours the function has one extremum at most. Extrema near zero are searched, so that an interval (or a gap)
    that falls between two samples is found. An interval that reaches an end of the horizon is cut there.
    """
    times, values = _with_extrema(function, t_s, function(t_s))
    positive = values > 0.0
    change = np.flatnonzero(positive[1:] != positive[:-1])
    edges = _bisect(function, times[change], times[change + 1], positive[change])
    if positive[0]:
        edges = np.concatenate([[t_s[0]], edges])
    if positive[-1]:
        edges = np.concatenate([edges, [t_s[-1]]])
    return [(float(a), float(b)) for a, b in edges.reshape(-1, 2) if b > a]


def maximum_in(function: TimeFunction, start_s: float, end_s: float, samples: int = 65) -> float:
    """The largest value of a smooth function on [start_s, end_s], from samples refined around the best one."""
    for _ in range(4):
        times = np.linspace(start_s, end_s, samples)
        values = function(times)
        best = int(np.argmax(values))
        start_s, end_s = times[max(best - 1, 0)], times[min(best + 1, samples - 1)]
    return float(values[best])


def _with_extrema(function: TimeFunction, t_s: Array, values: Array) -> tuple[Array, Array]:
    if len(t_s) < 3:
        return t_s, values
    left, here, right = values[:-2], values[1:-1], values[2:]
    reach = np.maximum(np.abs(here - left), np.abs(here - right))
    near = np.abs(here) <= reach  # a parabola's extremum lies at most half of that beyond the best sample
    peaks = 1 + np.flatnonzero(near & (here <= 0.0) & (here >= left) & (here >= right))
    dips = 1 + np.flatnonzero(near & (here > 0.0) & (here <= left) & (here <= right))
    found = [_golden(function, t_s[index - 1], t_s[index + 1], sign) for index, sign in ((peaks, 1.0), (dips, -1.0))]
    times = np.concatenate([t_s, *found])
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate([values, *(function(t) for t in found)])[order]


def _golden(function: TimeFunction, low: Array, high: Array, sign: float) -> Array:
    """Times of the largest ``sign * function`` in brackets (k,), by golden-section search, all brackets at once."""
    ratio = (np.sqrt(5.0) - 1.0) / 2.0
    low, high = low.copy(), high.copy()
    while low.size and (high - low).max() > 1e-4:  # the extremum is flat: 1e-4 s fixes its value to 1e-8 of the curve
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        rises = sign * function(a) < sign * function(b)
        low, high = np.where(rises, a, low), np.where(rises, high, b)
    return 0.5 * (low + high)


def _bisect(function: TimeFunction, low: Array, high: Array, low_positive: NDArray[np.bool_]) -> Array:
    low, high = low.copy(), high.copy()
    while low.size and (high - low).max() > EDGE_TOLERANCE_S:
        middle = 0.5 * (low + high)
        same = (function(middle) > 0.0) == low_positive
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return 0.5 * (low + high)
