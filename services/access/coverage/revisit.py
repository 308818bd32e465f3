"""Visits to places and the gaps between them, over all receivers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.access.horizon import Horizon

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME_VISIT_S = 600  # images of one receiver less than this apart belong to one pass over the place


@dataclass(frozen=True)
class Visits:
    """Stays of receivers over places (input ``row``): seconds after the start of the first image, and after the last's
    end; ``images`` in each."""

    row: NDArray[np.int32]
    start_s: NDArray[np.int32]
    end_s: NDArray[np.int32]
    images: NDArray[np.int32]


class Revisits:
    """Gathers what receivers see of ``count`` places, one receiver after the other."""

    def __init__(self, count: int, horizon: Horizon) -> None:
        self._horizon = horizon
        self._count = count
        self._visits: list[Visits] = []
        self._nearest_km = np.full((horizon.days, count), np.inf, dtype=np.float32)

    def add(self, stays: Visits, nearest_km: NDArray[np.float32]) -> None:
        """The visits of one receiver, and how near (days, count) its points came."""
        self._visits.append(stays)
        np.minimum(self._nearest_km, nearest_km, out=self._nearest_km)

    @property
    def covered(self) -> int:
        """Places covered at least once."""
        seen = np.zeros(self._count, dtype=np.bool_)
        for part in self._visits:
            seen[part.row] = True
        return int(seen.sum())

    def covered_share(self, radii_km: tuple[float, ...]) -> dict[str, list[float]]:
        """For each radius the share of places that any point came as near as that to, for each day of the horizon."""
        return {
            f"{radius:g}": [round(float((day <= radius).mean()), 5) for day in self._nearest_km] for radius in radii_km
        }

    def frame(self) -> pd.DataFrame:
        """A row per place, in the order given: visits, images, first_covered (UTC), mean, median and largest gap
        between visits, and the longest wait including the horizon's ends (h); null where there is none."""
        row, start, end, images = self._sorted()
        total = self._horizon.duration_s
        reach = np.maximum.accumulate(row * (total + 1) + end) - row * (total + 1) if len(row) else end
        same = row[1:] == row[:-1]
        gap = np.where(same, start[1:] - reach[:-1], 0)
        is_gap = same & (gap > 0)
        gap_row, gap_s = row[1:][is_gap], gap[is_gap]
        first, last = np.full(self._count, total), np.zeros(self._count, dtype=np.int64)
        np.minimum.at(first, row, start)
        np.maximum.at(last, row, end)
        seen = np.bincount(row, minlength=self._count)
        gaps = np.bincount(gap_row, minlength=self._count)
        largest = np.zeros(self._count, dtype=np.int64)
        np.maximum.at(largest, gap_row, gap_s)
        wait = np.where(seen > 0, np.maximum(np.maximum(first, total - last), largest), total)
        with np.errstate(invalid="ignore"):
            mean = np.bincount(gap_row, weights=gap_s, minlength=self._count) / gaps
        covered_at = pd.Series(self._horizon.at(first * 1000)).where(seen > 0)
        return pd.DataFrame(
            {
                "visits": seen.astype(np.int32),
                "images": np.bincount(row, weights=images, minlength=self._count).astype(np.int64),
                "first_covered": covered_at,
                "mean_gap_h": mean / 3600.0,
                "median_gap_h": _medians(gap_row, gap_s, gaps) / 3600.0,
                "max_gap_h": np.where(gaps > 0, largest, np.nan) / 3600.0,
                "longest_wait_h": wait / 3600.0,
            }
        )

    def _sorted(self) -> tuple[Integers, Integers, Integers, Integers]:
        if not self._visits:
            none = np.zeros(0, dtype=np.int64)
            return none, none, none, none
        every = [
            np.concatenate([getattr(part, name) for part in self._visits]).astype(np.int64)
            for name in ("row", "start_s", "end_s", "images")
        ]
        order = np.lexsort((every[1], every[0]))
        return every[0][order], every[1][order], every[2][order], every[3][order]


def visits(time_index: NDArray[np.int32], row: NDArray[np.int32], step_s: int) -> Visits:
    """The visits that images (one place each) make up: rows of one place that follow within ``SAME_VISIT_S``."""
    order = np.lexsort((time_index, row))
    time_s, place = time_index[order].astype(np.int64) * step_s, row[order]
    new = (np.diff(place, prepend=-1) != 0) | (np.diff(time_s, prepend=0) > max(SAME_VISIT_S, step_s))
    first = np.flatnonzero(new)
    after = np.append(first[1:], len(order))
    end_s = time_s[after - 1] + 1 if len(first) else time_s
    return Visits(
        place[first],
        time_s[first].astype(np.int32),
        end_s.astype(np.int32),
        (after[: len(first)] - first).astype(np.int32),
    )


def join_visits(parts: Sequence[Visits], step_s: int) -> Visits:
    """The visits of one receiver over parts of the horizon; those that a part's end cut in two are one again."""
    if len(parts) == 1:
        return parts[0]
    row, start, end, images = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("row", "start_s", "end_s", "images")
    )
    order = np.lexsort((start, row))
    row, start, end, images = row[order], start[order], end[order], images[order]
    apart = start[1:] - (end[:-1] - 1) > max(SAME_VISIT_S, step_s)
    first = np.flatnonzero(np.concatenate([[True], (row[1:] != row[:-1]) | apart])[: len(row)])
    last = np.append(first[1:], len(row))[: len(first)] - 1
    counts = np.add.reduceat(images, first) if len(first) else images
    return Visits(row[first], start[first], end[last], counts.astype(np.int32))


def summary(frame: pd.DataFrame) -> dict[str, float | int | None]:
    """What a reader wants first: how many places are seen, how often, and how long they wait (h)."""
    seen = frame["visits"] > 0

    def quantile(name: str, share: float) -> float | None:
        value = frame.loc[seen, name].quantile(share)
        return None if pd.isna(value) else round(float(value), 3)

    return {
        "places": len(frame),
        "covered": int(seen.sum()),
        "visits_median": quantile("visits", 0.5),
        "mean_gap_h_median": quantile("mean_gap_h", 0.5),
        "max_gap_h_median": quantile("max_gap_h", 0.5),
        "max_gap_h_p95": quantile("max_gap_h", 0.95),
        "longest_wait_h_median": quantile("longest_wait_h", 0.5),
        "longest_wait_h_p95": quantile("longest_wait_h", 0.95),
    }


def _medians(gap_row: Integers, gap_s: Integers, gaps: Integers) -> Array:
    order = np.lexsort((gap_s, gap_row))
    ranked = gap_s[order].astype(np.float64)
    first = np.concatenate([[0], np.cumsum(gaps)[:-1]])
    median = np.full(len(gaps), np.nan)
    some = gaps > 0
    low, high = first[some] + (gaps[some] - 1) // 2, first[some] + gaps[some] // 2
    median[some] = 0.5 * (ranked[low] + ranked[high])
    return median
