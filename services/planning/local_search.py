"""Simulated annealing over image sets, with exact-enough resource checks: good plans for cases too big to branch on.

Compiled with numba. All work is counted in moves and the random stream is a fixed xorshift, so that equal inputs give
equal plans on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem

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


@njit(cache=True)
def _satellite_ok(s, count, offset, numbers, limits):  # type: ignore[no-untyped-def]
    """Whether counts per chunk keep storage and battery in bounds, pessimistic about the order within a chunk."""
    per, store, u, battery = limits[s, 0], limits[s, 1], limits[s, 2], limits[s, 3]
    floor, capacity, collect_w, downlink_w = limits[s, 4], limits[s, 5], limits[s, 6], limits[s, 7]
    for c in range(offset[s], offset[s + 1]):
        length, base = numbers[c, 0], numbers[c, 1]
        n = count[c] + numbers[c, 3]
        d = min(numbers[c, 5], numbers[c, 2] - count[c], u)
        if d < 0.0:
            if count[c] > numbers[c, 2]:
                return False
            d = 0.0
        u += per * n
        if n > 0 and u > store:
            return False
        d += numbers[c, 4]
        u -= d
        if base <= 0.0:
            battery += length * base - n * collect_w - d * downlink_w
        else:
            net_c, net_d = base - collect_w, base - downlink_w
            gain = (length - n - d) * base + n * max(0.0, net_c) + d * max(0.0, net_d)
            loss = n * max(0.0, -net_c) + d * max(0.0, -net_d)
            if battery - loss < floor:
                return False
            battery = min(capacity, battery + gain) - loss
        if battery < floor:
            return False
    return True


@njit(cache=True)
def _gain(i, start, group, value, cover):  # type: ignore[no-untyped-def]
    total = 0.0
    for e in range(start[i], start[i + 1]):
        if cover[group[e]] == 0:
            total += value[group[e]]
    return total


@njit(cache=True)
def _loss(i, start, group, value, cover):  # type: ignore[no-untyped-def]
    total = 0.0
    for e in range(start[i], start[i + 1]):
        if cover[group[e]] == 1:
            total += value[group[e]]
    return total


@njit(cache=True)
def _put(i, sign, start, group, chunk, cover, count):  # type: ignore[no-untyped-def]
    count[chunk[i]] += sign
    for e in range(start[i], start[i + 1]):
        cover[group[e]] += sign


@njit(cache=True)
def _next(state):  # type: ignore[no-untyped-def]
    """xorshift64*: uniform in [0, 1)."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return np.float64((x * np.uint64(2685821657736338717)) >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True)
def _fill(ranking, minimum, chosen, cover, count, start, group, value, chunk, sat, offset, numbers, limits):  # type: ignore[no-untyped-def]
    """Add images in the order given wherever they gain more than ``minimum`` and resources allow; returns the gain."""
    total = 0.0
    for i in ranking:
        if chosen[i]:
            continue
        gain = _gain(i, start, group, value, cover)
        if gain <= minimum:
            continue
        _put(i, 1, start, group, chunk, cover, count)
        if _satellite_ok(sat[chunk[i]], count, offset, numbers, limits):
            chosen[i] = True
            total += gain
        else:
            _put(i, -1, start, group, chunk, cover, count)
    return total


@njit(cache=True)
def _anneal(  # type: ignore[no-untyped-def]
    moves, hot, cold, state, chosen, best, totals, cover, count, perm, place,
    start, group, value, chunk, first, fixed, sat, offset, numbers, limits,
):  # fmt: skip
    """``moves`` proposals, cooling from ``hot`` to ``cold``. ``totals`` = [current, best]; ``best`` follows ``chosen``.

    ``perm`` keeps the chosen images of a chunk in front of the others; ``place`` is its inverse.
    """
    n = len(chosen)
    for move in range(moves):
        temperature = hot * (cold / hot) ** (move / moves)
        j = int(_next(state) * n)
        if chosen[j]:
            continue
        if _gain(j, start, group, value, cover) <= 0.0:
            continue
        c = chunk[j]
        s = sat[c]
        other = c
        kind = _next(state)
        out = -1
        if kind < 0.1:
            _put(j, 1, start, group, chunk, cover, count)
            if _satellite_ok(s, count, offset, numbers, limits):
                delta = _loss(j, start, group, value, cover)
                _accept(j, -1, chosen, perm, place, first, count, chunk, c, c)
                totals[0] += delta
                if totals[0] > totals[1] + 1e-9:
                    totals[1] = totals[0]
                    best[:] = chosen
                continue
            _put(j, -1, start, group, chunk, cover, count)
        elif kind < 0.4:
            span = offset[s + 1] - offset[s]
            other = offset[s] + int(_next(state) * span)
            for _ in range(span):
                if count[other] > 0:
                    break
                other += 1
                if other == offset[s + 1]:
                    other = offset[s]
        if count[other] == 0:
            continue
        smallest = np.inf
        for _ in range(3):
            i = perm[first[other] + int(_next(state) * count[other])]
            if fixed[i]:
                continue
            loss = _loss(i, start, group, value, cover)
            if loss < smallest:
                smallest, out = loss, i
        if out < 0:
            continue
        _put(out, -1, start, group, chunk, cover, count)
        delta = _gain(j, start, group, value, cover) - smallest
        good = delta >= 0.0 or _next(state) < math.exp(delta / temperature)
        if good:
            _put(j, 1, start, group, chunk, cover, count)
            if other != c and not _satellite_ok(s, count, offset, numbers, limits):
                _put(j, -1, start, group, chunk, cover, count)
                good = False
        if not good:
            _put(out, 1, start, group, chunk, cover, count)
            continue
        _accept(j, out, chosen, perm, place, first, count, chunk, c, other)
        totals[0] += delta
        if totals[0] > totals[1] + 1e-9:
            totals[1] = totals[0]
            best[:] = chosen


@njit(cache=True)
def _accept(j, out, chosen, perm, place, first, count, chunk, c, other):  # type: ignore[no-untyped-def]
    """Keep ``perm`` partitioned after ``out`` (or -1) left and ``j`` came; ``count`` already has the new totals."""
    if out >= 0:
        chosen[out] = False
        before = count[other] if other != c else count[other] - 1
        _exchange(perm, place, place[out], first[other] + before)
    chosen[j] = True
    _exchange(perm, place, place[j], first[c] + count[c] - 1)


@njit(cache=True)
def _exchange(perm, place, a, b):  # type: ignore[no-untyped-def]
    x, y = perm[a], perm[b]
    perm[a], perm[b] = y, x
    place[x], place[y] = b, a


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
        _put(i, 1, space.start, space.group, space.chunk, cover, count)
        chosen[i] = True
    if seed is not None:
        _fill(np.flatnonzero(seed), minimum, chosen, cover, count, *_statics(space))
    _fill(ranking.astype(np.int64), minimum, chosen, cover, count, *_statics(space))
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
    cover = np.bincount(
        space.group[np.repeat(chosen, np.diff(space.start))], minlength=len(space.value)
    ).astype(np.int64)
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
        _anneal(
            batch, begin, end, state, chosen, best, totals, cover, count, perm, place, space.start, space.group,
            space.value, space.chunk, space.first, space.fixed, space.chunk_satellite, space.chunk_offset,
            space.chunk_numbers, space.limits,
        )  # fmt: skip
        done += batch
    return SearchResult(best, float(totals[1]), done, cut)
