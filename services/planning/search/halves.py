"""Exact improvement of half a plan at a time: what annealing leaves, where there is work to spend on it.

Some chunks are freed, the others stay as they are. Which images are best in the freed ones, as many in each as before,
is a program of a few thousand columns whose relaxation is almost whole: branch and bound ends in seconds, where all
chunks together would not end at all. Counts per chunk stay, so storage, energy and stations need no second look.
Each round frees two disjoint sets of chunks, one a core; a set's images are taken over where they gain. By turns these
are all chunks of some satellites, which leave little to branch on, and chunks of all satellites.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy import sparse

from services.planning.milp import DataCycleModel
from services.planning.problem import BoolArray, IntArray
from services.planning.search.space import REQUIRED_BONUS, SearchSpace
from services.planning.solving import branch_and_bound

FREED_IMAGES = 2_600
"""Images to choose from in a set: twice as many are beyond branch and bound."""
NODES = 60
NEARNESS = 0.02
"""Reward that branch and bound may leave."""
PATIENCE = 15
"""Rounds without gain after which no more is tried."""


class _Plan:
    """An image set of a space, with how often every group is covered."""

    def __init__(self, space: SearchSpace, chosen: BoolArray) -> None:
        shape = (len(space.chunk), len(space.value))
        self.space, self.chosen = space, chosen.copy()
        self.matrix = sparse.csr_array((np.ones(len(space.group)), space.group, space.start), shape=shape)
        self.required = space.value >= REQUIRED_BONUS
        self.worth = space.value - REQUIRED_BONUS * self.required

    def program(self, free: IntArray) -> tuple[DataCycleModel, IntArray]:
        """The best images among ``free``, all others held, and the groups that it decides about."""
        held = self.chosen.copy()
        held[free] = False
        groups = np.flatnonzero((self.matrix.T @ held < 0.5) & (self.matrix[free].sum(axis=0) > 0))
        seen = sparse.csr_array(self.matrix[free][:, groups])
        n, m = seen.shape
        chunk, place = np.unique(self.space.chunk[free], return_inverse=True)
        count = np.bincount(place, self.chosen[free])
        counts = sparse.csr_array((np.ones(n), (place, np.arange(n))), shape=(len(chunk), n))
        matrix = sparse.csr_array(sparse.block_array([[-seen.T, sparse.eye_array(m)], [counts, None]]))
        matrix.sort_indices()
        now = (seen.T @ self.chosen[free]) > 0.5
        low = np.concatenate([self.space.fixed[free].astype(float), (self.required[groups] & now).astype(float)])
        model = DataCycleModel(
            np.concatenate([np.zeros(n), self.worth[groups]]), matrix, np.full(m + len(chunk), -np.inf),
            np.concatenate([np.zeros(m), count]), low, np.ones(n + m), n, m, 0,
        )  # fmt: skip
        return model, groups

    def improved(self, free: IntArray, left: Callable[[], float]) -> tuple[BoolArray | None, bool]:
        """The image set with the best choice among ``free`` (None: none found), and whether time cut it."""
        if not len(free):
            return None, False
        model, _ = self.program(free)
        whole = np.arange(len(model.cost)) < model.images
        gap = NEARNESS / max(1.0, float(model.cost.sum()))
        found = branch_and_bound(model, whole, gap, NODES, left())
        if not found.feasible:
            return None, found.time_limited
        chosen = self.chosen.copy()
        chosen[free] = found.images > 0.5
        return chosen, found.time_limited


def improve_halves(
    space: SearchSpace,
    chosen: BoolArray,
    rounds: int,
    left: Callable[[], float],
    stop: Callable[[int, BoolArray], bool],
    seed: int = 1,
) -> tuple[BoolArray, bool]:
    """``chosen`` improved by at most ``rounds`` rounds, and whether time (``left``, s, or ``stop``) cut them."""
    plan, rng, idle = _Plan(space, chosen), np.random.default_rng(seed), 0
    value = space.objective(plan.chosen)
    with ThreadPoolExecutor(max_workers=2) as pool:
        for done in range(rounds):
            if stop(done, plan.chosen):
                return plan.chosen, True
            sets = _disjoint_sets(space, rng, by_satellite=done % 2 == 0)
            results = list(pool.map(lambda free, now=plan: now.improved(free, left), sets))
            if any(slow for _, slow in results):
                return plan.chosen, True
            before = value
            for candidate in _candidates(plan.chosen, sets, [found for found, _ in results]):
                worth = space.objective(candidate)
                if worth > value:
                    plan.chosen, value = candidate, worth
            idle = 0 if value > before + 1e-9 else idle + 1
            if idle >= PATIENCE:
                break
    return plan.chosen, False


def _candidates(now: BoolArray, sets: list[IntArray], found: list[BoolArray | None]) -> list[BoolArray]:
    """Each set's new images by themselves, and all together."""
    single = [chosen for chosen in found if chosen is not None]
    both = now.copy()
    for free, chosen in zip(sets, found, strict=True):
        if chosen is not None:
            both[free] = chosen[free]
    return [*single, both]


def _disjoint_sets(space: SearchSpace, rng: np.random.Generator, by_satellite: bool) -> list[IntArray]:
    """Two sets of images, each all of some chunks, of at most `FREED_IMAGES` and about half of the images."""
    size = np.diff(space.first)
    most = min(FREED_IMAGES, -(-int(size.sum()) // 2))
    sets: list[IntArray] = []
    chunks = rng.permutation(np.flatnonzero(size))
    if by_satellite:
        rank = rng.permutation(int(space.chunk_satellite.max(initial=0)) + 1)
        chunks = chunks[np.argsort(rank[space.chunk_satellite[chunks]], kind="stable")]
    total = np.cumsum(size[chunks])
    for part in range(2):
        inside = (total > part * most) & (total <= (part + 1) * most)
        sets.append(np.flatnonzero(np.isin(space.chunk, chunks[inside])))
    return sets
