"""Plan: reduce, decide whether mandatory targets can hold, solve with a proven bound, emit an exact timeline."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from services.planning.bounded_search import Progress, search_with_bound
from services.planning.coverage import Coverage, reduce_coverage, without_idle
from services.planning.data_cycles import Chunks, build_chunks
from services.planning.downlinks import Timeline, emit_timeline
from services.planning.early import earlier_images
from services.planning.fitting import with_offers
from services.planning.greedy import complete
from services.planning.milp import build_model
from services.planning.problem import BoolArray, IntArray, PlanningProblem
from services.planning.solving import Solution, branch_and_bound
from services.planning.timeline import TOLERANCE_WH, battery_wh
from services.planning.work import DEFAULT_WORK, Clock, shared_work
from shared.errors import DomainError

SMALL_ENTRIES = 12_000
"""Image-target pairs (reduced) up to which branch and bound runs first."""
PROVEN_GAP = 1e-8
"""A relative gap that is rounding: nothing is left to search for."""
NODES = 400
ROUNDS = 6


@dataclass(frozen=True)
class Options:
    """``mip_gap`` relative; ``time_limit_s`` a guard; ``work_limit`` counted units (a million search steps on each
    of two cores)."""

    mip_gap: float = 0.005
    time_limit_s: float = 60.0
    work_limit: float = DEFAULT_WORK
    active_mandatory: str = "auto"


@dataclass(frozen=True)
class Plan:
    """A timeline with its objective (equation 1), proven upper bound and how it came about."""

    timeline: Timeline
    objective: float
    bound: float
    mandatory: bool
    mandatory_possible: bool | None
    """Whether all reachable active targets can be met together; None where the work limit left that open."""
    method: str
    time_limited: bool
    model_size: dict[str, int]
    mandatory_most: int | None = None
    """At most so many mandatory targets can be met; None where nobody counted."""

    @property
    def gap(self) -> float:
        """(bound - objective) / bound; 0 where nothing can be gained."""
        return max(0.0, (self.bound - self.objective) / self.bound) if self.bound > 0 else 0.0


def plan(problem: PlanningProblem, options: Options, progress: Progress = lambda percent, text: None) -> Plan:
    """Maximise equation 1 under the schedule contract.

    Small cases are solved again with finer chunks where the exact timeline could not hold the model's images. Raises
    `DomainError` where a satellite cannot even idle, or where ``active_mandatory`` is ``true`` and not all can be met.
    """
    clock = Clock(time.monotonic(), options.time_limit_s)
    _check_idle(problem)
    best: Plan | None = None
    cuts: tuple[tuple[int, int], ...] = ()
    for _ in range(ROUNDS):
        chunks = build_chunks(problem, cuts)
        found = _plan_once(problem, chunks, options, clock, progress)
        if best is not None:
            # a bound speaks of plans that keep what was mandatory when it was proven
            same = best.mandatory_possible == found.mandatory_possible
            bound = min(best.bound, found.bound) if same else found.bound
            cut = best.time_limited or found.time_limited
            better = found if found.objective > best.objective else best
            found = replace(better, bound=max(bound, better.objective), time_limited=cut)
        best = found
        new = tuple(sorted({*cuts, *best.timeline.cuts}))
        small = best.model_size["entries_reduced"] <= SMALL_ENTRIES
        if best.gap <= options.mip_gap or not small or new == cuts:
            break
        if clock.left() < 0:
            return replace(best, time_limited=True)
        cuts = new
    return best


def _plan_once(problem: PlanningProblem, chunks: Chunks, options: Options, clock: Clock, progress: Progress) -> Plan:
    seen = problem.covered_targets(np.arange(len(problem.images)))
    progress(5, "mandatory targets")
    pinned = problem.targets.demanded() & seen
    wanted = (problem.targets.active & seen) | pinned
    seed, possible, cut_seed = _mandatory_seed(problem, chunks, wanted, options, clock)
    if options.active_mandatory == "true":
        _demand_all(problem, seen, possible)
    mandatory = options.active_mandatory != "false" and possible is True
    required = wanted if mandatory else pinned
    if not mandatory and pinned.any():
        seed, possible_pins, cut_pins = _mandatory_seed(
            problem, chunks, pinned, replace(options, active_mandatory="true"), clock
        )
        _demand_pins(problem, pinned, seed, possible_pins)
        cut_seed |= cut_pins
    coverage = reduce_coverage(problem, chunks, np.arange(len(problem.images)), np.ones(len(seen), bool), required)
    progress(15, "solving")
    images, bound, method, cut = _solve(
        problem, chunks, coverage, seed if required.any() else None, options, clock, progress
    )
    progress(80, "exact timeline")
    timeline = _early(problem, chunks, _emit_full(problem, chunks, images, required, clock), required)
    objective = problem.objective(timeline.images)
    kept = mandatory and bool(problem.covered_targets(timeline.images)[required].all())
    if mandatory and not kept:  # the bound spoke of plans that meet all of them
        bound = float(problem.targets.value[seen].sum())
    size = {
        "images": len(problem.images), "images_reduced": len(coverage.image), "targets": int(seen.sum()),
        "target_groups": len(coverage.value), "entries_reduced": len(coverage.group), "chunks": len(chunks),
        "cycles": int(sum(chunks.cycle[chunks.offset[1:] - 1] + 1)),
    }  # fmt: skip
    return Plan(
        timeline,
        objective,
        max(bound, objective),
        kept,
        possible,
        method,
        cut or cut_seed or timeline.time_limited,
        size,
    )


def _emit_full(
    problem: PlanningProblem, chunks: Chunks, images: IntArray, required: BoolArray, clock: Clock
) -> Timeline:
    """The exact timeline of the images that gain something, filled up with others that still fit and do."""
    timeline = emit_timeline(problem, without_idle(problem, images, problem.frozen_images), required)
    more, cut = complete(problem, chunks, timeline.images, timeline.downlink), clock.left() <= 0
    if not cut:
        more, cut = with_offers(problem, build_chunks(problem, timeline.cuts), more, required)
    if problem.objective(more) > problem.objective(timeline.images):
        fuller = emit_timeline(problem, more, required, timeline.cuts)
        if problem.objective(fuller.images) > problem.objective(timeline.images):
            timeline = fuller
    return replace(timeline, time_limited=timeline.time_limited or cut)


def _early(problem: PlanningProblem, chunks: Chunks, timeline: Timeline, required: BoolArray) -> Timeline:
    """The timeline with images earlier where that costs no reward, if an exact timeline holds them all."""
    images = earlier_images(problem, chunks, timeline.images, timeline.downlink)
    if np.array_equal(images, timeline.images):
        return timeline
    moved = emit_timeline(problem, images, required, timeline.cuts)
    if len(moved.dropped) or problem.objective(moved.images) < problem.objective(timeline.images):
        return timeline
    return replace(moved, dropped=timeline.dropped, time_limited=moved.time_limited or timeline.time_limited)


def _check_idle(problem: PlanningProblem) -> None:
    """Without any new command the battery must stay above its floor, or no plan exists."""
    battery = battery_wh(problem, problem.frozen_images, problem.frozen.downlink)
    for s, limits in enumerate(problem.satellites):
        low = battery[s] < limits.battery_min_wh - TOLERANCE_WH
        if low.any():
            second = int(np.argmax(low))
            raise DomainError(
                f"{limits.name} falls below its battery floor at second {second} without any new command",
                field="spacecraft.battery_min_wh", value=round(float(battery[s, second]), 4),
                accepted=f"a power budget that idles above {limits.battery_min_wh:g} Wh",
            )  # fmt: skip


def _mandatory_seed(
    problem: PlanningProblem, chunks: Chunks, wanted: BoolArray, options: Options, clock: Clock
) -> tuple[IntArray, bool | None, bool]:
    """Images that meet every wanted target, whether such a set exists (None: not decided), whether time cut it."""
    none = np.zeros(0, np.int64)
    if options.active_mandatory == "false" or not wanted.any():
        return none, True, False
    everything = np.arange(len(problem.images))
    required = np.zeros(len(wanted), bool)
    coverage = reduce_coverage(problem, chunks, everything, wanted, wanted)
    coverage = Coverage(
        coverage.image, coverage.start, coverage.group, np.ones(len(coverage.value)),
        np.zeros(len(coverage.value), bool), coverage.group_of,
    )  # fmt: skip
    model = build_model(problem, chunks, coverage)
    whole = np.zeros(len(model.cost), bool)
    whole[: model.images] = True
    solution = branch_and_bound(model, whole, 0.0, NODES, min(30.0, clock.left()))
    images = coverage.image[solution.images > 0.5] if solution.feasible else none
    required[wanted] = True
    met = bool(problem.covered_targets(images)[required].all())
    refuted = solution.bound < len(coverage.value) - 0.5
    return images, True if met else (False if refuted else None), solution.time_limited and not met


def _demand_pins(problem: PlanningProblem, pinned: BoolArray, seed: IntArray, possible: bool | None) -> None:
    if possible is True:
        return
    missed = problem.targets.target_id[pinned & ~problem.covered_targets(seed)]
    raise DomainError(
        "the pinned targets cannot all be observed: storage, battery or stations forbid it together",
        field="target_changes", value=[int(target) for target in missed[:20]], accepted="fewer pinned targets",
    )  # fmt: skip


def _demand_all(problem: PlanningProblem, seen: BoolArray, possible: bool | None) -> None:
    missing = problem.targets.target_id[problem.targets.active & ~seen]
    if len(missing) or not possible:
        what = (
            f"{len(missing)} have no usable opportunity" if len(missing) else "storage, battery or stations forbid it"
        )
        raise DomainError(
            f"not all active targets can be observed: {what}", field="active_mandatory", value="true",
            accepted="auto or false, which plan the most valuable ones and name the rest",
        )  # fmt: skip


def _solve(
    problem: PlanningProblem, chunks: Chunks, coverage: Coverage, seed: IntArray | None, options: Options,
    clock: Clock, progress: Progress,
) -> tuple[IntArray, float, str, bool]:  # fmt: skip
    """Images, proven bound, method and whether the guard cut it: branch and bound if small, else LP plus search."""
    model = build_model(problem, chunks, coverage)
    whole = np.zeros(len(model.cost), bool)
    whole[: model.images] = True
    first: Solution | None = None
    if len(coverage.group) <= SMALL_ENTRIES:
        first = branch_and_bound(model, whole, options.mip_gap, NODES, clock.left() / 2)
        chosen = coverage.image[first.images > 0.5]
        value = problem.objective(chosen)
        if first.feasible and first.bound - value <= max(options.mip_gap, PROVEN_GAP) * max(first.bound, 1e-9):
            return chosen, first.bound, "branch and bound", first.time_limited
    best, bound, cut = search_with_bound(
        problem, chunks, coverage, model, seed, first, shared_work(options.work_limit), clock, progress
    )
    if first is not None and first.feasible:
        best = max(best, coverage.image[first.images > 0.5], key=problem.objective)
    return best, bound, "interior-point and quota bounds, heat-bath annealing", cut
