"""Bound-guided search: downlink allotment and candidate images from the LP relaxation, then annealing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.local_search import REQUIRED_BONUS, SearchSpace, anneal, construct, search_space
from services.planning.milp import DataCycleModel
from services.planning.problem import BoolArray, IntArray, PlanningProblem
from services.planning.solving import Solution

REDUCED_COST_SPAN = 0.3
"""Images whose reduced cost lies further below zero, in mean group values, are left out of the search."""
HOT, COLD = 0.8, 0.04
"""Annealing temperatures in mean group values."""
PASSES = (0.1, 0.9)
"""Shares of the moves: a short cooling first, so that a guard that cuts the long one still leaves a good plan."""


def allot_downlinks(problem: PlanningProblem, chunks: Chunks, links: np.ndarray, spare: bool) -> IntArray:
    """Whole downlink seconds per chunk from the relaxation's ``links``.

    Rounded so that no station is shared beyond its seconds; with ``spare`` the station time left over is handed out
    too (largest fraction first), else only what the relaxation asked for, since downlinking costs energy.
    """
    most = np.minimum(chunks.free_s[chunks.link_chunk], chunks.cell_free_s[chunks.link_cell])
    given = np.minimum(np.floor(links + 1e-6), most).astype(np.int64)
    left = chunks.cell_free_s - np.bincount(chunks.link_cell, given, minlength=len(chunks.cell_free_s)).astype(np.int64)
    room = chunks.free_s - np.bincount(chunks.link_chunk, given, minlength=len(chunks)).astype(np.int64)
    for link in np.lexsort((-(links - given), chunks.link_cell)):
        cell, chunk = chunks.link_cell[link], chunks.link_chunk[link]
        limit = most[link] if spare else np.ceil(links[link] - 1e-6)
        more = max(0, min(left[cell], room[chunk], int(limit) - given[link]))
        given[link] += more
        left[cell] -= more
        room[chunk] -= more
    return np.bincount(chunks.link_chunk, given, minlength=len(chunks)).astype(np.int64)


def energy_binds(problem: PlanningProblem, chunks: Chunks) -> bool:
    """Whether downlinking in every contact second and collecting every image could reach a battery floor."""
    collect = np.bincount(chunks.image_chunk, minlength=len(chunks))
    downlink = np.bincount(chunks.link_chunk, chunks.free_s[chunks.link_chunk], minlength=len(chunks))
    for s, limits in enumerate(problem.satellites):
        charge = limits.battery_initial_wh
        for c in range(chunks.offset[s], chunks.offset[s + 1]):
            spent = (collect[c] + chunks.frozen_collect[c]) * limits.collect_w
            spent += (downlink[c] + chunks.frozen_downlink[c]) * limits.downlink_w
            if charge - spent / 3600 < limits.battery_min_wh:
                return True
            gain = chunks.base_w[c] * (chunks.end_s[c] - chunks.start_s[c]) / 3600
            charge = min(limits.battery_capacity_wh, charge + gain) - spent / 3600
            if charge < limits.battery_min_wh:
                return True
    return False


def search_plan(
    problem: PlanningProblem,
    chunks: Chunks,
    coverage: Coverage,
    model: DataCycleModel,
    relaxation: Solution,
    seed: IntArray | None,
    moves: int,
    stop: Callable[[int, float], bool],
) -> tuple[IntArray, bool]:
    """Images of the best plan found and whether ``stop`` cut the search; ``seed`` meets all mandatory targets."""
    scale = float(coverage.value[~coverage.required].mean()) if (~coverage.required).any() else 1.0
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
    allotted = allot_downlinks(problem, chunks, relaxation.links, spare=not energy_binds(problem, chunks))
    space, order = search_space(problem, chunks, smaller, allotted)
    weight = relaxation.images[near][order]
    ranking = np.argsort(-weight, kind="stable")
    start = construct(space, ranking)
    if seed is not None and not _meets(space, start):
        start = construct(space, ranking, seed=np.isin(smaller.image[order], seed))
    done, best, cut = 0, start, False
    for share in PASSES:
        part, before = int(moves * share), done
        result = anneal(space, start, part, HOT * scale, COLD * scale, stop=lambda n, v, b=before: stop(b + n, v))
        best = max(best, result.chosen, key=lambda chosen: _value(space, chosen))
        done, cut = done + part, result.time_limited
        if cut:
            break
    return np.sort(smaller.image[order][best]), cut


def _value(space: SearchSpace, chosen: BoolArray) -> float:
    covered = np.zeros(len(space.value), bool)
    covered[space.group[np.repeat(chosen, np.diff(space.start))]] = True
    return float(space.value[covered].sum())


def _meets(space: SearchSpace, chosen: BoolArray) -> bool:
    """Whether every mandatory group is covered."""
    covered = np.zeros(len(space.value), bool)
    covered[space.group[np.repeat(chosen, np.diff(space.start))]] = True
    return bool(covered[space.value >= REQUIRED_BONUS].all())
