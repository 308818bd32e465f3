"""Search over recordings for cases too large to write down second by second: annealing over blocks of seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from services.planning.options.rules import OperationRules
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem
from services.planning.sequencing.kernels import FOREIGN, anneal_blocks, long_enough, put, resources_fit, slews_fit
from services.planning.sequencing.passes import widened

REQUIRED_BONUS = 1e6
"""Extra value of a mandatory target inside the search: no sum of others outweighs it."""
HOT, COLD = 1.0, 0.01
"""Annealing temperatures, in mean values of the shortest recording."""
WARM, REPAIR, FROZEN = 0.015, 0.3, 0.003
"""The same from a plan to begin with, which is not to be lost; warmer where switches and budgets displace a part."""
FAVOURED_SHARE = 0.35
"""Share of the proposals around images that see a target worth far more than most, which are few."""
FAVOURED_VALUE = 5.0
"""What makes a target one of those: times the mean value of a recorded image."""
BATCH_MOVES = 100_000


@dataclass(frozen=True)
class Recordings:
    """``recording``: (satellites, seconds) pointing or -1, frozen ones included; whether the guard cut the search."""

    recording: IntArray
    time_limited: bool


def search_recordings(
    problem: PlanningProblem, rules: OperationRules, downlink: IntArray, required: BoolArray, scale: float, moves: int,
    stop: Callable[[int], bool], begin: IntArray | None = None,
) -> Recordings:  # fmt: skip
    """The best recordings found around the given downlinks by ``moves`` counted proposals.

    ``scale`` is what an image is worth on average; ``stop(moves done)`` is the guard between batches. ``begin``
    ((satellites, seconds), pointing or -1) is a plan to start from, as far as the rules allow it.
    """
    space = _space(problem, rules, downlink, required) | {"pick": _proposals(problem, required, scale)}
    if begin is not None:
        _record_all(space, begin)
    if not len(problem.images):
        return Recordings(space["rec"].astype(np.int64), False)
    totals = np.zeros(2)
    totals[1] = -1.0
    best = space["rec"].copy()
    state = np.array([0x9E3779B97F4A7C15], np.uint64)
    done, cut = 0, False
    while done < moves:
        if stop(done):
            cut = True
            break
        batch = min(BATCH_MOVES, moves - done)
        first, last = (HOT, COLD) if begin is None else (WARM if rules.free_downlinks else REPAIR, FROZEN)
        hot, cold = (scale * rules.min_collect_s * first * (last / first) ** (x / moves) for x in (done, done + batch))
        anneal_blocks(batch, hot, cold, state, best=best, totals=totals, **space)
        done += batch
    return Recordings(best.astype(np.int64), cut)


def _space(problem: PlanningProblem, rules: OperationRules, downlink: IntArray, required: BoolArray) -> dict[str, Any]:
    """Flat arrays for the compiled moves."""
    own, shape = problem.images, problem.sunlit.shape
    pointings = max(1, len(problem.pointings))
    image_at = np.full((*shape, pointings), -1, np.int32)
    image_at[own.satellite, own.second, own.pointing_of()] = np.arange(len(own))
    rec, frozen = _frozen(problem)
    closed = widened(downlink >= 0, rules.mode_switch_s) | ~problem.commandable | frozen
    segment, offset, numbers = _segments(problem, downlink)
    count = np.bincount(segment[frozen], minlength=len(numbers)).astype(np.int64)
    cover = np.zeros(len(problem.targets.value), np.int64)
    for image in problem.frozen_images:
        cover[own.covered(int(image))] += 1
    day, commands, budget = _budget(problem, rules, rec, downlink)
    order = np.lexsort((own.second, own.satellite))
    image_segment = segment[own.satellite[order], own.second[order]]
    slew, initial, reach = _slews(problem)
    limits = np.array([
        [x.downlink_s_per_image, x.downlink_s_per_image * x.storage_images,
         x.downlink_s_per_image * x.stored_images_initial, 3600 * x.battery_initial_wh, 3600 * x.battery_min_wh,
         3600 * x.battery_capacity_wh, x.collect_w, x.downlink_w] for x in problem.satellites
    ], float)  # fmt: skip
    return {
        "rec": rec, "cover": cover, "count": count, "commands": commands, "image_at": image_at,
        "start": own.start, "target": own.target, "value": problem.targets.value + REQUIRED_BONUS * required,
        "segment": segment, "segment_first": np.searchsorted(image_segment, np.arange(len(numbers) + 1)),
        "day": day, "allowed": ~closed, "frozen": frozen, "image_s": own.satellite[order],
        "image_t": own.second[order], "image_k": own.pointing_of()[order],
        "sat_first": np.searchsorted(own.satellite[order], np.arange(shape[0] + 1)), "offset": offset,
        "numbers": numbers, "limits": limits, "slew": slew, "initial": initial, "reach": reach,
        "least": rules.min_collect_s, "fill": rules.min_collect_s > 1, "budget": budget,
    }  # fmt: skip


def _record_all(space: dict[str, Any], begin: IntArray) -> None:
    """Put every unbroken run of ``begin`` under one pointing into the space, where rules and resources allow it."""
    names = ("rec", "image_at", "start", "target", "value", "cover", "segment", "count", "day", "commands")
    own = [space[name] for name in names]
    rec, frozen, least = space["rec"], space["frozen"], space["least"]
    for s in range(len(begin)):
        line = np.where(space["allowed"][s] & (rec[s] < 0), begin[s], -1)
        edges = [0, *(np.flatnonzero(np.diff(line)) + 1).tolist(), len(line)]
        for first, last in pairwise(edges):
            if line[first] < 0:
                continue
            for t in range(first, last):
                put(s, t, int(line[first]), *own)
            fits = long_enough(rec, frozen, s, first, least)
            fits = fits and slews_fit(rec, frozen, s, first, last, space["slew"], space["reach"], space["initial"][s])
            fits = fits and resources_fit(s, space["offset"], space["numbers"], space["count"], space["limits"])
            if not fits or (space["commands"][s] > space["budget"][s]).any():
                for t in range(first, last):
                    put(s, t, -1, *own)


def _proposals(problem: PlanningProblem, required: BoolArray, scale: float) -> IntArray:
    """Images to propose (places in order of satellite and second), the favoured ones so often that they get theirs."""
    own = problem.images
    order = np.lexsort((own.second, own.satellite))
    rich = required | (problem.targets.value > FAVOURED_VALUE * scale)
    worth = np.bincount(own.image_of_entry()[rich[own.target]], minlength=len(own))[order]
    few = np.flatnonzero(worth > 0)
    repeats = int(FAVOURED_SHARE / (1 - FAVOURED_SHARE) * len(own) / len(few)) if len(few) else 0
    return np.concatenate([np.arange(len(own)), np.tile(few, repeats)]).astype(np.int64)


def _frozen(problem: PlanningProblem) -> tuple[np.ndarray, BoolArray]:
    rec = np.full(problem.sunlit.shape, -1, np.int8)
    frozen = np.zeros(problem.sunlit.shape, bool)
    old = problem.frozen
    held = problem.images.pointing_of()[old.image] if len(problem.images) else np.zeros(len(old.image), np.int64)
    foreign = old.pointing if old.pointing is not None else np.full(len(old.image), -1)
    held = np.where(old.image >= 0, held, np.where(foreign >= 0, foreign, FOREIGN if problem.pointings else 0))
    rec[old.satellite, old.second] = held
    frozen[old.satellite, old.second] = True
    return rec, frozen


def _segments(problem: PlanningProblem, downlink: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Stretches in which sunlight and downlinking do not change: of every second, by satellite, and their figures."""
    segment = np.zeros(problem.sunlit.shape, np.int64)
    offset, numbers = [0], []
    for s, limits in enumerate(problem.satellites):
        sending = downlink[s] >= 0
        edges = np.flatnonzero((sending[1:] != sending[:-1]) | (problem.sunlit[s][1:] != problem.sunlit[s][:-1])) + 1
        bounds = np.concatenate([[0], edges, [problem.horizon_s]])
        for begin, end in pairwise(bounds.tolist()):
            segment[s, begin:end] = len(numbers)
            base = (limits.generation_w if problem.sunlit[s, begin] else 0.0) - limits.nominal_w
            numbers.append((float(end - begin), base, float(sending[begin])))
        offset.append(len(numbers))
    return segment, np.array(offset, np.int64), np.array(numbers, float)


def _budget(
    problem: PlanningProblem, rules: OperationRules, rec: np.ndarray, downlink: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """UTC day of every second, commands begun on each so far (satellites, days), and how many recordings may be."""
    first = problem.horizon_start.timestamp()
    day = ((np.arange(problem.horizon_s) + first) // 86_400).astype(np.int64)
    day -= day[0]
    shape = (len(problem.satellites), int(day[-1]) + 1)
    commands, downs = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    for line, counts in ((rec.astype(np.int64), commands), (downlink, downs)):
        earlier = np.concatenate([np.full((shape[0], 1), -1), line[:, :-1]], axis=1)
        s, t = np.nonzero((line >= 0) & (line != earlier))
        np.add.at(counts, (s, day[t]), 1)
    if rules.max_commands_per_day is None:
        return day, commands, np.full(shape, np.iinfo(np.int64).max)
    return day, commands, np.maximum(rules.max_commands_per_day - downs, commands)


def _slews(problem: PlanningProblem) -> tuple[IntArray, IntArray, int]:
    names = problem.pointings
    table = np.zeros((len(problem.satellites), max(1, len(names)), max(1, len(names))), np.int64)
    initial = np.full(len(problem.satellites), -1, np.int64)
    for s, limits in enumerate(problem.satellites):
        for j, source in enumerate(names):
            for k, target in enumerate(names):
                table[s, j, k] = 0 if j == k else (limits.slew or {})[source][target]
        if limits.pointing_initial in names:
            initial[s] = names.index(str(limits.pointing_initial))
    return table, initial, int(table.max())
