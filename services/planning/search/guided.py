"""Bound-guided search: downlink allotment, quotas and candidate images from the LP relaxation, then annealing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, IntArray, PlanningProblem
from services.planning.quotas import Quotas
from services.planning.search.annealing import SEARCHES, anneal
from services.planning.search.halves import improve_halves
from services.planning.search.space import (
    Allotment,
    SearchSpace,
    allot_downlinks,
    construct,
    energy_binds,
    search_space,
)
from services.planning.solving import Solution

REDUCED_COST_SPAN = 0.1
"""Images whose reduced cost lies further below zero, in mean group values, are left out of the search."""
HOT, COLD = 0.45, 0.07
"""Annealing temperatures in mean group values: above, image sets are random; below, hardly a step is taken."""
QUICK_SHARE, LEAST_MOVES = 0.1, 250_000
"""Share of the moves of a short cooling that comes first, so that a guard that cuts the long one leaves a good plan."""


@dataclass(frozen=True)
class Start:
    """Where a search starts: its space, the coverage images of the space, an allotment and a feasible image set."""

    space: SearchSpace
    image: IntArray
    allotment: Allotment
    chosen: BoolArray
    scale: float


def search_start(
    problem: PlanningProblem,
    chunks: Chunks,
    coverage: Coverage,
    relaxation: Solution,
    quotas: Quotas,
    seed: IntArray | None,
) -> Start:
    """A feasible set near the quotas, over images that the relaxation does not rule out.

    ``seed`` meets all mandatory targets; it goes first where the relaxation's own ranking does not meet them.
    """
    optional = ~coverage.required
    scale = float(coverage.value[optional].mean()) if optional.any() else 1.0
    scale = scale if scale > 0 else 1.0
    keep = (relaxation.images > 1e-6) | (relaxation.reduced > -REDUCED_COST_SPAN * scale)
    keep |= np.isin(coverage.image, problem.frozen_images)
    if seed is not None:
        keep |= np.isin(coverage.image, seed)
    near = np.flatnonzero(keep)
    matrix = coverage.matrix()[near]
    smaller = replace(
        coverage, image=coverage.image[near], start=matrix.indptr.astype(np.int64),
        group=matrix.indices.astype(np.int64),
    )  # fmt: skip
    allotment = allot_downlinks(chunks, quotas.links, spare=not energy_binds(problem, chunks))
    space, order = search_space(problem, chunks, smaller, allotment.per_chunk())
    ranking = np.argsort(-relaxation.images[near][order], kind="stable")
    quota = quotas.images if quotas.feasible else None
    chosen = construct(space, ranking, quota=quota)
    if seed is not None and not space.meets_required(chosen):
        chosen = construct(space, ranking, seed=np.isin(smaller.image[order], seed), quota=quota)
    return Start(space, smaller.image[order], allotment, chosen, scale)


Stop = Callable[[int, IntArray], bool]


def quick_plan(start: Start, moves: int, left: Callable[[], float]) -> IntArray:
    """Images of a short cooling by one search: something good to return while better guidance is worked out.

    A first quarter of a million steps is made whatever time is ``left`` (seconds).
    """
    least, _ = _annealed(start, min(moves, LEAST_MOVES), lambda done, images: False, lambda: math.inf, searches=1)
    more, _ = _annealed(start, int(moves * QUICK_SHARE), lambda done, images: left() <= 0, left, searches=1)
    worth = [start.space.objective(np.isin(start.image, images)) for images in (least, more)]
    return (least, more)[int(np.argmax(worth))]


def search_plan(start: Start, moves: int, stop: Stop, left: Callable[[], float]) -> tuple[IntArray, bool]:
    """Images of the best plan found and whether time cut the search: ``stop(moves done, best images)`` said so, or it
    had to hurry to end within ``left`` seconds."""
    return _annealed(start, moves, stop, left, SEARCHES)


def refined_plan(
    start: Start, images: IntArray, rounds: int, stop: Stop, left: Callable[[], float]
) -> tuple[IntArray, bool]:
    """``images`` of a plan of this start, improved exactly half by half, and whether time cut that."""
    if not rounds:
        return images, False
    chosen = np.isin(start.image, images)
    better, cut = improve_halves(
        start.space, chosen, rounds, left, lambda done, chosen: stop(done, start.image[chosen])
    )
    return np.sort(start.image[better]), cut


def _annealed(
    start: Start, moves: int, stop: Stop, left: Callable[[], float], searches: int
) -> tuple[IntArray, bool]:  # fmt: skip
    result = anneal(
        start.space, start.allotment, start.chosen, moves, HOT * start.scale, COLD * start.scale,
        stop=lambda done, chosen: stop(done, start.image[chosen]), searches=searches, left=left,
    )  # fmt: skip
    return np.sort(start.image[result.chosen]), result.time_limited
