"""Which images an exact plan can hold: integer programs over the images of a few satellites, all others held.

A program over all images of a large constellation does not end. What does not fit is a matter of few satellites; and
where nothing is wrong, a few satellites at a time may still find room for more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from services.planning.coverage import Coverage, reduce_coverage
from services.planning.data_cycles import Chunks
from services.planning.milp import DataCycleModel, build_model
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem
from services.planning.solving import branch_and_bound

NODES = 200
GUARD_S = 30.0
GAP = 1e-4
FREED_IMAGES = 2_000
"""Images that one program may choose among, so that its work does not grow with the constellation."""
PART_IMAGES, PART_NODES = 500, 20
"""The same where nothing is wrong, and nodes for it: a larger program gains hardly more and does not always end."""
OFFERED = 0.1
"""Images offered to a satellite beyond those it takes, as a share of them."""
WHOLE = 1e-6


def held_model(problem: PlanningProblem, chunks: Chunks, images: IntArray) -> DataCycleModel:
    """The data-cycle model of ``images`` without any targets: only resources count."""
    nothing = Coverage(
        images, np.zeros(len(images) + 1, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0, bool),
        np.full(len(problem.targets.value), -1, np.int64),
    )  # fmt: skip
    return build_model(problem, chunks, nothing)


def losses(problem: PlanningProblem, images: IntArray, asked: IntArray) -> FloatArray:
    """Value of the targets that each of ``asked`` alone observes among ``images``."""
    own = problem.images
    count = np.bincount(own.target[np.isin(own.image_of_entry(), images)], minlength=len(problem.targets.value))
    return np.array([problem.targets.value[c[count[c] == 1]].sum() for c in map(own.covered, asked.tolist())])


def most_valuable(
    problem: PlanningProblem,
    chunks: Chunks,
    held: IntArray,
    free: IntArray,
    required: BoolArray,
    nodes: int = NODES,
) -> tuple[IntArray | None, bool]:
    """All of ``held`` and the most valuable of ``free`` that fit beside them; whether time cut the choice.

    ``required`` targets that either sees are observed where that can be. None: not even ``held`` fits.
    """
    known = problem.covered_targets(held)
    open_now = problem.covered_targets(free) & ~known
    for demanded in (required & open_now, np.zeros(len(known), bool)):
        coverage = reduce_coverage(problem, chunks, free, open_now, demanded)
        model = build_model(problem, chunks, _beside(coverage, held))
        low, whole = model.low.copy(), np.zeros(len(model.cost), bool)
        low[len(coverage.image) : model.images] = 1.0
        whole[: len(coverage.image)] = True
        solution = branch_and_bound(replace(model, low=low), whole, GAP, nodes, GUARD_S)
        if solution.feasible:
            taken = coverage.image[solution.images[: len(coverage.image)] > 0.5]
            return np.union1d(held, taken), solution.time_limited
        if not demanded.any():
            break
    return None, solution.time_limited


def _beside(coverage: Coverage, held: IntArray) -> Coverage:
    """``coverage`` and after it the ``held`` images, whose targets no longer count."""
    ends = np.full(len(held), len(coverage.group), np.int64)
    return replace(coverage, image=np.concatenate([coverage.image, held]), start=np.concatenate([coverage.start, ends]))


def fitting(
    problem: PlanningProblem, chunks: Chunks, images: IntArray, required: BoolArray
) -> tuple[IntArray | None, bool]:
    """A most valuable part of ``images`` that fits the (refined) chunks; whether time cut the choice.

    A linear program tells which satellites are short. Their images and those of the nearest by shared stations are
    chosen anew; the others keep theirs. None: no part was found.
    """
    model = held_model(problem, chunks, images)
    loss = losses(problem, images, images)
    cost = model.cost.copy()
    cost[: model.images] = loss + 1e-3 * max(1e-6, float(loss.mean()) if len(loss) else 0.0)
    relaxed = branch_and_bound(replace(model, cost=cost), np.zeros(len(cost), bool), GAP, NODES, GUARD_S)
    if not relaxed.feasible:
        return None, relaxed.time_limited
    fits = relaxed.images > 1 - WHOLE
    owner = problem.images.satellite[images]
    sizes = np.bincount(owner, minlength=len(problem.satellites))
    order = _nearest(chunks, len(sizes), np.unique(owner[~fits]))
    freed = order[np.cumsum(sizes[order]) <= max(FREED_IMAGES, int(sizes[order[:1]].sum()))]
    free = np.isin(owner, freed) & ~np.isin(images, problem.frozen_images)
    return most_valuable(problem, chunks, images[fits & ~free], images[free], required)


def _nearest(chunks: Chunks, satellites: int, short: IntArray) -> IntArray:
    """Satellites in order of the steps over shared stations that lie between them and a ``short`` one."""
    uses = np.zeros((satellites, len(chunks.cell_free_s)), bool)
    uses[chunks.satellite[chunks.link_chunk], chunks.link_cell] = True
    order, reached = [short], np.isin(np.arange(satellites), short)
    while len(order[-1]):
        near = uses[:, uses[order[-1]].any(axis=0)].any(axis=1) & ~reached
        reached |= near
        order.append(np.flatnonzero(near))
    return np.concatenate(order).astype(np.int64)


def with_offers(
    problem: PlanningProblem, chunks: Chunks, images: IntArray, required: BoolArray
) -> tuple[IntArray, bool]:
    """``images`` of an exact plan improved by a few satellites at a time: each is offered more than it takes."""
    cut = False
    for part in _parts(problem, images):
        mine = np.isin(problem.images.satellite[images], part) & ~np.isin(images, problem.frozen_images)
        offers = _offers(problem, images, part, int(np.ceil(OFFERED * mine.sum())))
        free = np.union1d(images[mine], offers)
        better, slow = most_valuable(problem, chunks, images[~mine], free, required, PART_NODES)
        cut |= slow
        if better is not None and problem.objective(better) > problem.objective(images):
            images = better
    return images, cut


def _parts(problem: PlanningProblem, images: IntArray) -> Iterator[IntArray]:
    """Satellites in turn, as many at a time as one program bears."""
    sizes = np.bincount(problem.images.satellite[images], minlength=len(problem.satellites))
    part = (np.cumsum(sizes) - 1).clip(0) // PART_IMAGES
    for number in np.unique(part):
        yield np.flatnonzero(part == number)


def _offers(problem: PlanningProblem, images: IntArray, part: IntArray, most: int) -> IntArray:
    """The ``most`` images of the satellites in ``part`` that would each gain most beside ``images``, one by one."""
    own = problem.images
    open_value = np.where(problem.covered_targets(images), 0.0, problem.targets.value)
    mine = np.isin(own.satellite, part)
    gain = np.bincount(own.image_of_entry(), open_value[own.target], minlength=len(own)) * mine
    offers = []
    for image in np.argsort(-gain, kind="stable").tolist():
        if len(offers) == most or gain[image] <= 0:
            break
        if open_value[own.covered(image)].sum() > 0.5 * gain[image]:
            offers.append(image)
            open_value[own.covered(image)] = 0.0
    return np.array(offers, np.int64)
