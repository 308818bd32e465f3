"""Simulated annealing over image sets, with exact-enough resource checks: good plans for cases too big to branch on.

Compiled with numba. All work is counted in moves and the random stream is a fixed xorshift, so that equal inputs give
equal plans on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem
from services.planning.search_kernels import anneal_moves, fill, put

REQUIRED_BONUS = 1e6
"""Extra value of a mandatory group inside the search: no pre-fire sum outweighs it."""
BATCH_MOVES = 250_000


@dataclass(frozen=True)
class SearchSpace:
    """Flat arrays for the compiled kernels: images sorted by chunk, limits per satellite, totals per chunk."""

    start: IntArray
    group: IntArray
    value: FloatArray
    chunk: IntArray
    first: IntArray
    """Images of chunk c are ``first[c]:first[c + 1]``."""
    fixed: BoolArray
    chunk_offset: IntArray
    chunk_satellite: IntArray
    chunk_numbers: FloatArray
    """(chunks, 6): length s, base W, free s, foreign frozen collects, frozen downlink s, downlink s allotted."""
    limits: FloatArray
    """(satellites, 7): s per image, storage in image-seconds, stored at start in image-seconds, battery start, floor,
    capacity in Ws, collect W; column 7 is downlink W."""


def search_space(
    problem: PlanningProblem, chunks: Chunks, coverage: Coverage, downlink_s: IntArray
) -> tuple[SearchSpace, IntArray]:
    """The space of ``coverage``'s images under a fixed allotment of downlink seconds per chunk.

    Also returns the order: position in the space -> position in ``coverage``.
    """
    chunk_of = chunks.image_chunk[coverage.image]
    order = np.argsort(chunk_of, kind="stable")
    matrix = coverage.matrix()[order]
    foreign = chunks.frozen_collect - np.bincount(chunks.image_chunk[problem.frozen_images], minlength=len(chunks))
    numbers = np.column_stack([
        chunks.end_s - chunks.start_s, chunks.base_w, chunks.free_s, foreign, chunks.frozen_downlink, downlink_s,
    ]).astype(float)  # fmt: skip
    limits = np.array([
        [x.downlink_s_per_image, x.downlink_s_per_image * x.storage_images,
         x.downlink_s_per_image * x.stored_images_initial, 3600 * x.battery_initial_wh, 3600 * x.battery_min_wh,
         3600 * x.battery_capacity_wh, x.collect_w, x.downlink_w] for x in problem.satellites
    ], float)  # fmt: skip
    space = SearchSpace(
        matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64),
        coverage.value + REQUIRED_BONUS * coverage.required, chunk_of[order],
        np.searchsorted(chunk_of[order], np.arange(len(chunks) + 1)).astype(np.int64),
        np.isin(coverage.image[order], problem.frozen_images), chunks.offset, chunks.satellite, numbers, limits,
    )  # fmt: skip
    return space, order


@dataclass(frozen=True)
class SearchResult:
    """``chosen`` over the space's images; ``value`` includes the bonus of mandatory groups; ``moves`` really made."""

    chosen: BoolArray
    value: float
    moves: int
    time_limited: bool


def construct(space: SearchSpace, ranking: IntArray, minimum: float = 0.0, seed: BoolArray | None = None) -> BoolArray:
    """Images taken greedily in ``ranking`` order, on top of the fixed ones and ``seed``, as resources allow."""
    chosen = np.zeros(len(space.chunk), bool)
    cover, count = np.zeros(len(space.value), np.int64), np.zeros(len(space.chunk_satellite), np.int64)
    for i in np.flatnonzero(space.fixed):
        put(i, 1, space.start, space.group, space.chunk, cover, count)
        chosen[i] = True
    if seed is not None:
        fill(np.flatnonzero(seed), minimum, chosen, cover, count, *_statics(space))
    fill(ranking.astype(np.int64), minimum, chosen, cover, count, *_statics(space))
    return chosen


def _statics(space: SearchSpace) -> tuple[np.ndarray, ...]:
    return (
        space.start, space.group, space.value, space.chunk, space.chunk_satellite, space.chunk_offset,
        space.chunk_numbers, space.limits,
    )  # fmt: skip


def anneal(
    space: SearchSpace,
    chosen: BoolArray,
    moves: int,
    hot: float,
    cold: float,
    seed: int = 1,
    stop: Callable[[int, float], bool] = lambda done, value: False,
) -> SearchResult:
    """Improve ``chosen`` by ``moves`` counted proposals; ``stop(done, best value)`` between batches is the guard."""
    chosen = chosen.copy()
    best = chosen.copy()
    cover = np.bincount(space.group[np.repeat(chosen, np.diff(space.start))], minlength=len(space.value)).astype(
        np.int64
    )
    count = np.bincount(space.chunk[chosen], minlength=len(space.chunk_satellite)).astype(np.int64)
    perm = np.lexsort((~chosen, space.chunk)).astype(np.int64)
    place = np.argsort(perm).astype(np.int64)
    value = float(space.value[cover > 0].sum())
    totals = np.array([value, value])
    state = np.array([(0x9E3779B97F4A7C15 * (2 * seed + 1)) % 2**64], np.uint64)
    done, cut = 0, False
    while done < moves:
        if stop(done, float(totals[1])):
            cut = True
            break
        batch = min(BATCH_MOVES, moves - done)
        begin, end = (hot * (cold / hot) ** (x / moves) for x in (done, done + batch))
        anneal_moves(
            batch, begin, end, state, chosen, best, totals, cover, count, perm, place, space.start, space.group,
            space.value, space.chunk, space.first, space.fixed, space.chunk_satellite, space.chunk_offset,
            space.chunk_numbers, space.limits,
        )  # fmt: skip
        done += batch
    return SearchResult(best, float(totals[1]), done, cut)
