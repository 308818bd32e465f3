"""Today's practice: one unbroken track a fill of the store, the best match by eye, then downlink as stations come.

The paper (section 5): operators command raw-IF mode over the satellite tracks that best match the wanted polygons, and
downlink when a station is available. Each satellite by itself takes the contiguous window of at most a store's length
that is worth most, empties the store completely in its next passes, and only then records again. The one kindness: a
track is chosen for targets that no earlier track has seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.planning.problem import IntArray, PlanningProblem
from services.planning.timeline import TOLERANCE_WH


@dataclass(frozen=True)
class ManualPlan:
    """Images (frozen ones included) and the station of every downlinked satellite-second (-1: none)."""

    images: IntArray
    downlink: np.ndarray


def manual_plan(problem: PlanningProblem) -> ManualPlan:
    """The plan of contiguous tracks; satellites take turns in order of time, first come, first served."""
    downlink = problem.frozen.downlink.copy()
    covered = problem.covered_targets(problem.frozen_images)
    chosen = [problem.frozen_images]
    taken = np.zeros((max(1, len(problem.stations)), problem.horizon_s), bool)
    for station in range(len(problem.stations)):
        taken[station] = (downlink == station).any(axis=0)
    ready = [_ready(problem, s) for s in range(len(problem.satellites))]
    while any(second < problem.horizon_s for second in ready):
        s = int(np.argmin(ready))
        end = _window_end(problem, s, ready[s])
        track = _best_track(problem, s, ready[s], end, covered)
        track = _powered(problem, s, np.concatenate(chosen), track, np.flatnonzero(downlink[s] >= 0))
        if len(track):
            chosen.append(track)
            covered[np.concatenate([problem.images.covered(int(i)) for i in track])] = True
        after = int(problem.images.second[track[-1]]) + 1 if len(track) else end
        recorded = np.concatenate(chosen)
        ready[s] = _empty_store(problem, s, after, recorded, downlink, taken)
    images = np.unique(np.concatenate(chosen)).astype(np.int64)
    return ManualPlan(images, downlink)


def _ready(problem: PlanningProblem, s: int) -> int:
    """First second of new commands, once everything frozen has run."""
    old = problem.frozen.second[problem.frozen.satellite == s]
    sent = np.flatnonzero(problem.frozen.downlink[s] >= 0)
    return max(int(problem.commands_from()[s]), int(old.max(initial=-1)) + 1, int(sent.max(initial=-1)) + 1)


def _window_end(problem: PlanningProblem, s: int, second: int) -> int:
    """Start of the next pass after the next opportunity: until then a track may be recorded."""
    own = problem.images.second[(problem.images.satellite == s) & (problem.images.second >= second)]
    if not len(own):
        return problem.horizon_s
    starts = [p.start_s for p in problem.passes if p.satellite == s and p.start_s > own.min()]
    return min(starts, default=problem.horizon_s)


def _best_track(problem: PlanningProblem, s: int, begin: int, end: int, covered: np.ndarray) -> IntArray:
    """Images of the unbroken window, at most a store long, that sees most reward not yet seen."""
    own, limits = problem.images, problem.satellites[s]
    mine = np.flatnonzero((own.satellite == s) & (own.second >= begin) & (own.second < end))
    mine = mine[np.argsort(own.second[mine], kind="stable")]
    starts = np.flatnonzero(np.diff(own.second[mine], prepend=-2) > 1)
    best, track = 0.0, mine[:0]
    for run in np.split(mine, starts[1:]):
        value, begin, stop = _best_window(problem, run, limits.storage_images, covered)
        if value > best:
            best, track = value, run[begin:stop]
    return track


def _best_window(problem: PlanningProblem, run: IntArray, longest: int, covered: np.ndarray) -> tuple[float, int, int]:
    """Value, begin and stop of the first window of an unbroken ``run`` that is worth most: ``longest`` images, or all.

    A window moves on image by image: what enters and what leaves is all that is counted.
    """
    own = problem.images
    count: dict[int, int] = {}
    open_value = [np.where(covered[c], 0.0, problem.targets.value[c]).tolist() for c in map(own.covered, run)]
    value, best, span = 0.0, 0.0, (0, 0)
    for place, image in enumerate(run):
        for target, worth in zip(own.covered(image).tolist(), open_value[place], strict=True):
            count[target] = count.get(target, 0) + 1
            value += worth if count[target] == 1 else 0.0
        begin = place - longest
        if begin >= 0:
            for target, worth in zip(own.covered(run[begin]).tolist(), open_value[begin], strict=True):
                count[target] -= 1
                value -= worth if count[target] == 0 else 0.0
        if place + 1 >= min(longest, len(run)) and value > best + 1e-9:
            best, span = value, (max(0, begin + 1), place + 1)
    return best, *span


def _empty_store(
    problem: PlanningProblem, s: int, second: int, recorded: IntArray, downlink: np.ndarray, taken: np.ndarray
) -> int:
    """Downlink in every pass from ``second`` on until the store is empty; returns when it is (the horizon: never).

    A pass is cut short where the battery would not carry it: manual practice too stays above the floor.
    """
    limits = problem.satellites[s]
    collect = _collected(problem, s, recorded)
    images = limits.stored_images_initial + int(collect.sum())
    left = limits.downlink_s_per_image * images - int((downlink[s] >= 0).sum())
    for p in (p for p in problem.passes if p.satellite == s and p.end_s > second):
        if left <= 0:
            return second
        span = np.arange(max(p.start_s, second), p.end_s)
        free = problem.commandable[s, span] & ~taken[p.station, span] & (downlink[s, span] < 0) & ~collect[span]
        block = span[free][:left]
        while len(block) and not _carries(problem, s, collect, np.union1d(np.flatnonzero(downlink[s] >= 0), block)):
            block = block[: len(block) // 2]
        downlink[s, block] = p.station
        taken[p.station, block] = True
        left -= len(block)
        second = max(second, int(block[-1]) + 1) if len(block) else second
    return problem.horizon_s if left > 0 else second


def _powered(problem: PlanningProblem, s: int, before: IntArray, track: IntArray, sending: IntArray) -> IntArray:
    """As much of the head of a track as the battery carries, by halves."""
    while len(track) and not _carries(problem, s, _collected(problem, s, np.concatenate([before, track])), sending):
        track = track[: len(track) // 2]
    return track


def _collected(problem: PlanningProblem, s: int, images: IntArray) -> np.ndarray:
    collect = np.zeros(problem.horizon_s, bool)
    collect[problem.images.second[images[problem.images.satellite[images] == s]]] = True
    collect[problem.frozen.second[problem.frozen.satellite == s]] = True
    return collect


def _carries(problem: PlanningProblem, s: int, collect: np.ndarray, sending: IntArray) -> bool:
    """Whether the charge stays above its floor for the rest of the horizon."""
    limits = problem.satellites[s]
    net = np.where(problem.sunlit[s], limits.generation_w, 0.0) - limits.nominal_w - limits.collect_w * collect
    net[sending] -= limits.downlink_w
    free = limits.battery_initial_wh + np.cumsum(net) / 3600.0
    charge = free - np.maximum(0.0, np.maximum.accumulate(free - limits.battery_capacity_wh))
    return bool(charge.min() >= limits.battery_min_wh - TOLERANCE_WH)
