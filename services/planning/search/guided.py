"""Bound-guided search: downlink allotment, quotas and candidate images from the LP relaxation, then annealing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, IntArray, PlanningProblem
from services.planning.quotas import Quotas
from services.planning.search.annealing import anneal
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
PASSES = (0.05, 0.95)
"""Shares of the moves: a short cooling first, so that a guard that cuts the long one still leaves a good plan."""


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


def search_plan(start: Start, moves: int, stop: Callable[[int, IntArray], bool]) -> tuple[IntArray, bool]:
    """Images of the best plan found and whether ``stop(moves done, best images)`` cut the search."""
    done, best, cut = 0, start.chosen, False
    for share in PASSES:
        part, before = int(moves * share), done
        result = anneal(
            start.space, start.allotment, start.chosen, part, HOT * start.scale, COLD * start.scale,
            stop=lambda n, chosen, b=before, known=best: stop(
                b + n, start.image[max(known, chosen, key=start.space.objective)]
            ),
        )  # fmt: skip
        best = max(best, result.chosen, key=start.space.objective)
        done, cut = done + part, result.time_limited
        if cut:
            break
    return np.sort(start.image[best]), cut
