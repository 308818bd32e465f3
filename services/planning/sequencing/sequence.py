"""From a plan by totals to one made of recordings: exactly where the case is small, by search where it is not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from services.planning.downlinks import Timeline
from services.planning.options.rules import OperationRules
from services.planning.problem import BoolArray, Images, IntArray, PlanningProblem
from services.planning.sequencing.passes import whole_downlinks
from services.planning.sequencing.recordings import search_recordings
from services.planning.sequencing.second_model import LARGEST_CELLS, SecondModel
from services.planning.timeline import collected_seconds, first_shortfall

MOVES_PER_UNIT = 150_000
"""Moves of the search in a unit of the work limit: they cost more than those of the search by totals."""
LEAST_MOVES = 100_000
"""Moves that are made whatever time is left."""
TRIAL_SHARE = 0.06
"""Share of the moves spent on each way to downlink before the best goes on."""
SEARCH_ALONE = "annealing over recordings"
FILLER_IDS_FROM = 2**30
"""Ids of recorded seconds that see no target: far from any that opportunities use."""


@dataclass(frozen=True)
class Sequenced:
    """A timeline of recordings; ``problem`` is the given one with the seconds that recordings only run through."""

    problem: PlanningProblem
    timeline: Timeline
    bound: float
    method: str
    time_limited: bool


def one_pointing(problem: PlanningProblem) -> PlanningProblem:
    """The relaxation in which an image sees whatever any pointing would: its bound holds for the agile problem."""
    own = problem.images
    key = own.satellite * problem.horizon_s + own.second
    places, group = np.unique(key, return_inverse=True)
    entry = group.reshape(-1)[own.image_of_entry()] * max(1, len(problem.targets.value)) + own.target
    pairs = np.unique(entry)
    size = np.bincount(pairs // max(1, len(problem.targets.value)), minlength=len(places))
    first = np.full(len(places), np.iinfo(np.int64).max)
    np.minimum.at(first, group.reshape(-1), own.image_id)
    merged = Images(
        first, places // problem.horizon_s, places % problem.horizon_s,
        np.concatenate([[0], np.cumsum(size)]).astype(np.int64), pairs % max(1, len(problem.targets.value)),
    )  # fmt: skip
    old = problem.frozen.image
    image = np.where(old >= 0, group.reshape(-1)[old] if len(own) else -1, -1)
    return replace(problem, images=merged, frozen=replace(problem.frozen, image=image), pointings=())


def is_small(problem: PlanningProblem) -> bool:
    """Whether the exact program over seconds decides."""
    return problem.sunlit.size <= LARGEST_CELLS


def sequence(
    problem: PlanningProblem, rules: OperationRules, guide: PlanningProblem, plan_images: IntArray,
    plan_downlink: np.ndarray, required: BoolArray, work: float, seconds_left: Callable[[], float],
    begin: IntArray | None = None,
) -> Sequenced:  # fmt: skip
    """The best timeline found that keeps recordings, switches, slews and command budgets.

    ``plan_images`` and ``plan_downlink`` are a plan of ``guide``, the problem without those rules. ``work`` counts
    units of moves; ``seconds_left`` is the guard. ``begin`` ((satellites, seconds), pointing or -1) holds recordings to
    start from (None: from nothing).
    """
    if is_small(problem):
        for demanded in (required, problem.targets.demanded() & required):
            exact = SecondModel(problem, rules, demanded).solve(seconds_left())
            if exact is not None:
                full, timeline = finished(problem, exact.recording, exact.downlink)
                return Sequenced(full, timeline, exact.bound, "second by second", exact.time_limited)
    scale = _worth_of_image(guide, plan_images, required | problem.targets.active if begin is not None else required)
    moves = int(work * MOVES_PER_UNIT)
    best: tuple[float, IntArray] | None = None
    cut = seconds_left() <= 0
    if cut:  # a short cooling all the same: better than no plan
        moves = min(moves, LEAST_MOVES)
    patience = (lambda _: False) if cut else (lambda _: seconds_left() <= 0)
    ways = list(_downlink_ways(problem, rules, plan_images, plan_downlink, guide, begin is not None))
    trial = int(moves * TRIAL_SHARE) if len(ways) > 1 and not cut else 0
    for way in ways if trial else ():
        found = search_recordings(problem, rules, way, required, scale, trial, patience, begin)
        cut |= found.time_limited
        full, timeline = finished(problem, found.recording, way)
        value = _value(full, timeline, required)
        if best is None or value > best[0]:
            best = (value, way)
    way = best[1] if best is not None else ways[0]
    found = search_recordings(problem, rules, way, required, scale, max(1, moves - trial * len(ways)), patience, begin)
    full, timeline = finished(problem, found.recording, way)
    return Sequenced(full, timeline, float("inf"), SEARCH_ALONE, cut or found.time_limited)


def _worth_of_image(problem: PlanningProblem, images: IntArray, besides: BoolArray) -> float:
    """What an image brings on average, ``besides`` targets that are not at stake, if there are others."""
    counted = ~besides if (~besides).any() else np.ones(len(besides), bool)
    observed = problem.covered_targets(images) & counted
    return max(1e-9, float(problem.targets.value[observed].sum()) / max(1, len(images)))


def _value(problem: PlanningProblem, timeline: Timeline, required: BoolArray) -> float:
    met = problem.covered_targets(timeline.images) & required
    return problem.objective(timeline.images) + 1e6 * int(met.sum())


def _downlink_ways(
    problem: PlanningProblem, rules: OperationRules, images: IntArray, downlink: np.ndarray, guide: PlanningProblem,
    fitted: bool,
) -> Iterator[IntArray]:  # fmt: skip
    """Ways to downlink worth trying: as planned where seconds may be scattered, else a block a pass, more or fewer.

    Downlinks ``fitted`` to recordings stay as they are where nothing is said against scattered ones.
    """
    if not rules.sequenced or (fitted and rules.free_downlinks):
        yield downlink.astype(np.int64)
        return
    most = rules.max_commands_per_day
    numbers: list[int | None] = [None]
    if most is not None:
        numbers = sorted({max(1, round(most * share)) for share in (0.25, 0.4, 0.55, 0.7)} if most > 1 else {0, 1})
    seen: list[IntArray] = []
    shifted = replace(problem, images=guide.images)
    for number in numbers:
        for stretch in (True, False):
            way = whole_downlinks(shifted, images, downlink, rules, number, stretch)
            if not any(np.array_equal(way, other) for other in seen):
                seen.append(way)
                yield way


def finished(problem: PlanningProblem, recording: IntArray, downlink: IntArray) -> tuple[PlanningProblem, Timeline]:
    """An exact timeline from recordings and downlinks: without downlinks of nothing, and without what cannot be held.

    Recorded seconds that see no target become images of their own. Where the battery cannot carry the recordings, the
    one before the break whose loss costs least is left out.
    """
    recording = recording.copy()
    while True:
        full, images = with_fillers(problem, recording)
        timeline = Timeline(images, _without_empty(full, images, downlink), np.zeros(0, np.int64))
        broken = first_shortfall(full, images, timeline.downlink)
        if broken is None:
            return full, timeline
        if not _drop_cheapest(full, images, recording, broken.satellite, broken.second):
            raise RuntimeError(f"rule {broken.rule} is broken at second {broken.second} without any new recording")


def with_fillers(problem: PlanningProblem, recording: IntArray) -> tuple[PlanningProblem, IntArray]:
    """``problem`` with an image for every recorded second that sees no target, and all images of ``recording``."""
    own = problem.images
    old = np.zeros(recording.shape, bool)
    old[problem.frozen.satellite, problem.frozen.second] = True
    held = recording[own.satellite, own.second] == own.pointing_of()
    chosen = np.flatnonzero(held & ~old[own.satellite, own.second])
    filled = (recording >= 0) & ~old
    filled[own.satellite[chosen], own.second[chosen]] = False
    satellite, second = np.nonzero(filled)
    begin = 1 + max(FILLER_IDS_FROM, int(own.image_id.max(initial=0)), int(problem.frozen.image_id.max(initial=0)))
    grown = Images(
        np.concatenate([own.image_id, begin + np.arange(len(satellite))]), np.concatenate([own.satellite, satellite]),
        np.concatenate([own.second, second]),
        np.concatenate([own.start, np.full(len(satellite), own.start[-1])]), own.target,
        np.concatenate([own.pointing_of(), recording[satellite, second]]),
    )  # fmt: skip
    images = np.concatenate([chosen, problem.frozen_images, len(own) + np.arange(len(satellite))])
    return replace(problem, images=grown), np.unique(images).astype(np.int64)


def _without_empty(problem: PlanningProblem, images: IntArray, downlink: IntArray) -> np.ndarray:
    """Downlinks less the seconds in which nothing is stored, as a spacecraft would find them."""
    kept = downlink.astype(np.int16).copy()
    collect = collected_seconds(problem, images)
    for s, limits in enumerate(problem.satellites):
        stored = limits.stored_images_initial * limits.downlink_s_per_image
        for t in np.flatnonzero(collect[s] | (kept[s] >= 0)):
            if collect[s, t]:
                stored += limits.downlink_s_per_image
            elif stored <= 0:
                kept[s, t] = -1
            else:
                stored -= 1
    return kept


def _drop_cheapest(
    problem: PlanningProblem, images: IntArray, recording: IntArray, satellite: int, second: int
) -> bool:
    """Clear, in ``recording``, the new recording of a satellite up to ``second`` that costs least; False if none."""
    own = problem.images
    old = np.zeros(problem.horizon_s, bool)
    old[problem.frozen.second[problem.frozen.satellite == satellite]] = True
    line = np.where(old, -1, recording[satellite])
    edges = np.flatnonzero(np.diff(np.concatenate([[-1], line, [-1]])))
    count = np.bincount(own.target[np.isin(own.image_of_entry(), images)], minlength=len(problem.targets.value))
    at = {int(own.second[i]): int(i) for i in images if own.satellite[i] == satellite}
    losses: list[tuple[float, int, int]] = []
    for begin, end in pairwise(edges.tolist()):
        if line[begin] < 0 or begin > second:
            continue
        seen = [own.covered(at[t]) for t in range(begin, end) if t in at]
        own_count = np.bincount(np.concatenate(seen or [np.zeros(0, np.int64)]), minlength=len(count))
        losses.append((float(problem.targets.value[(own_count > 0) & (count == own_count)].sum()), begin, end))
    if not losses:
        return False
    _, begin, end = min(losses)
    recording[satellite, begin:end] = -1
    return True
