"""Simulated annealing over image sets by heat-bath moves: seeded searches side by side that share their best state.

All work is counted in moves and the random streams are fixed xorshifts, so that equal inputs give equal plans on every
machine, however many cores it has and however busy they are, unless the time guard cut or hurried them
(``time_limited``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from services.planning.problem import BoolArray, FloatArray
from services.planning.search.kernels import heat_bath_moves
from services.planning.search.space import Allotment, SearchSpace

BATCH_MOVES = 100_000
CROSSING = 0.15
"""Share of steps that move an image between chunks of its satellite."""
SEARCHES = 2
"""Searches side by side, one a core of the machine that the product is made for."""
EXCHANGES = 12
"""Times in the colder half of an annealing at which the poorest search takes over the best one's state."""

SETTLING_S = 1.0
"""Seconds after which the pace of the steps is known."""
PUNCTUALITY = 0.95
"""Share of the time left that a hurried cooling plans to use."""
SLOW_START = 0.6
"""Steps at the hot start take up to so much longer than the rest: no reason yet to hurry."""


@dataclass(frozen=True)
class SearchResult:
    """``chosen`` over the space's images; ``value`` includes the bonus of mandatory groups; ``moves`` really made."""

    chosen: BoolArray
    value: float
    moves: int
    time_limited: bool


class Search:
    """One search: its current image set with all counters, its best set, and its random stream."""

    def __init__(self, space: SearchSpace, allotment: Allotment, chosen: BoolArray, seed: int) -> None:
        self.space, self.allotment = space, allotment
        shape = (len(space.chunk), len(space.value))
        self.matrix = sparse.csr_array((np.ones(len(space.group)), space.group, space.start), shape=shape)
        columns = self.matrix.tocsc()
        self.seen_start, self.seen_by = columns.indptr.astype(np.int64), columns.indices.astype(np.int64)
        self.state = np.array([(0x9E3779B97F4A7C15 * (2 * seed + 1)) % 2**64], np.uint64)
        self.link_s, self.room, self.spare = (x.copy() for x in (allotment.link_s, allotment.room, allotment.spare))
        self.numbers = space.chunk_numbers.copy()
        widest = int(np.diff(space.first).max(initial=0)) + 1
        self.weight, self.candidate = np.empty(widest), np.empty(widest, np.int64)
        self.chosen, self.best = chosen.copy(), chosen.copy()
        self.totals = np.zeros(2)
        self.totals[:] = self._count()

    def _count(self) -> float:
        """Counters anew from ``chosen``: they stay free of rounding, whatever the number of moves."""
        space, chosen = self.space, self.chosen
        self.cover = np.rint(self.matrix.T @ chosen.astype(float)).astype(np.int64)
        self.count = np.bincount(space.chunk[chosen], minlength=len(space.chunk_satellite)).astype(np.int64)
        self.open_value: FloatArray = self.matrix @ np.where(self.cover == 0, space.value, 0.0)
        self.sole_value: FloatArray = self.matrix @ np.where(self.cover == 1, space.value, 0.0)
        self.perm = np.lexsort((~chosen, space.chunk)).astype(np.int64)
        self.place = np.argsort(self.perm).astype(np.int64)
        return float(space.value[self.cover > 0].sum())

    def take_over(self, other: Search) -> None:
        """Go on from where ``other`` is, on the own random stream."""
        self.chosen, self.numbers = other.chosen.copy(), other.numbers.copy()
        self.link_s, self.room, self.spare = other.link_s.copy(), other.room.copy(), other.spare.copy()

    def run(self, moves: int, hot: float, cold: float) -> None:
        """``moves`` steps cooling from ``hot`` to ``cold``; releases the interpreter lock."""
        space, allotment = self.space, self.allotment
        self.totals[0] = self._count()
        heat_bath_moves(
            moves, hot, cold, CROSSING, self.state, self.chosen, self.best, self.totals, self.cover, self.count,
            self.open_value, self.sole_value, self.perm, self.place, self.weight, self.candidate, self.link_s,
            self.room, self.spare, self.numbers, space.start, space.group, space.value, self.seen_start, self.seen_by,
            space.chunk, space.first, space.fixed, space.chunk_satellite, space.chunk_offset, space.limits,
            allotment.link_chunk, allotment.link_most, allotment.cell_start, allotment.cell_link,
        )  # fmt: skip


class _Cooling:
    """How far an annealing is (0 to 1), by counted steps; where these will not fit the time left, by that time.

    A cooling that is hurried ends cold when the guard falls, instead of warm and half done; the same inputs then need
    not give the same plan.
    """

    def __init__(self, moves: int, left: Callable[[], float]) -> None:
        self.moves, self.left, self.begun = moves, left, left()
        self.done, self.share, self.hurried = 0, 0.0, False

    def next(self) -> tuple[int, float]:
        """Steps of the next batch and the share of the cooling that it ends at."""
        size, remaining = min(BATCH_MOVES, self.moves - self.done), self.moves - self.done
        now = self.left()
        spent = self.begun - now
        patience = PUNCTUALITY + SLOW_START * (1.0 - self.share)
        if self.done and spent > SETTLING_S and spent * remaining > now * patience * self.done:
            self.hurried = True
            remaining = max(size, int(now * PUNCTUALITY * self.done / spent))
        self.done += size
        self.share += (1.0 - self.share) * size / remaining
        return size, self.share

    def over(self) -> bool:
        """Whether nothing is left to do."""
        return self.done >= self.moves or self.share >= 1.0


def anneal(
    space: SearchSpace,
    allotment: Allotment,
    chosen: BoolArray,
    moves: int,
    hot: float,
    cold: float,
    seed: int = 1,
    stop: Callable[[int, BoolArray], bool] = lambda done, best: False,
    searches: int = SEARCHES,
    left: Callable[[], float] = lambda: math.inf,
) -> SearchResult:
    """Improve ``chosen`` by ``moves`` counted steps in each of ``searches`` searches.

    ``stop(done, best set)`` between batches is the guard; ``left`` says how many seconds remain, and hurries the
    cooling where the steps will not fit them. The best set of all is returned, never one poorer than ``chosen``.
    """
    if not len(space.chunk):  # no image can be taken at all
        return SearchResult(chosen, space.objective(chosen), 0, False)
    runs = [Search(space, allotment, chosen, seed + index) for index in range(searches)]
    cooling, cut = _Cooling(moves, left), False
    with ThreadPoolExecutor(max_workers=searches) as pool:
        while not cooling.over():
            leader = max(range(searches), key=lambda index: (runs[index].totals[1], -index))
            if stop(cooling.done, runs[leader].best):
                cut = True
                break
            before = cooling.share
            size, after = cooling.next()
            begin, end = (hot * (cold / hot) ** x for x in (before, after))
            list(pool.map(lambda run, n=size, a=begin, b=end: run.run(n, a, b), runs))
            if after > 0.5 and int(after * 2 * EXCHANGES) > int(before * 2 * EXCHANGES):
                ranked = sorted(range(searches), key=lambda index: (-runs[index].totals[0], index))
                runs[ranked[-1]].take_over(runs[ranked[0]])
    values = [space.objective(run.best) for run in runs]
    winner = int(np.argmax(values))
    return SearchResult(runs[winner].best, values[winner], cooling.done, cut or cooling.hurried)
