"""Recordings to choose from where they have a shortest length: every window of seconds that no other makes needless.

A recording of at least L seconds is one window of L to 2L-1 seconds or several side by side, so these lengths are all
there is to choose from. A window is told by the data cycle's chunk that it fills, its length, the *dear* targets in it,
each of which counts once in a plan, and the worth of the others, which is added up. Of windows that agree in chunk and
dear targets the shorter and the worthier make the others needless: one that is kept may then be chosen several times,
for it stands for all that it makes needless, and of these a plan holds as many as lie side by side in the chunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import sparse

from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem

MOST_WINDOWS = 6_000_000
"""Windows up to which all are looked at."""
MOST_LEFT = 10_000
"""Windows that may be left to choose from: more are beyond branch and bound."""
WORTH_STEPS = (256, 128, 64, 32, 16, 8, 4)
"""Steps into which the greatest worth is divided, finest first: coarser ones leave fewer windows."""
LONG_AGO = -(10**9)


@dataclass(frozen=True)
class Windows:
    """Windows [second, second + length) of a satellite under one pointing.

    ``chunk`` is the last that it touches, ``inside`` whether the only one. ``spread`` marks those that touch several,
    one of them with downlinks. ``times`` is how often each may be chosen, itself or one that it stands for. ``worth``
    is that of all but the dear targets, never below the true one; ``dear`` is a 0/1 matrix, windows by dear targets.
    """

    satellite: IntArray
    second: IntArray
    length: IntArray
    pointing: IntArray
    chunk: IntArray
    spread: BoolArray
    inside: BoolArray
    times: IntArray
    worth: FloatArray
    dear: sparse.csr_array

    def __len__(self) -> int:
        return len(self.satellite)


@njit(cache=True, nogil=True)
def _scan(allowed, held, image_at, start, target, before, price, mark, least, most, where, length, worth, key):  # type: ignore[no-untyped-def]
    """Every window of ``least`` to ``most`` allowed seconds that sees something; returns their number.

    A window beside a recording of the previous plan (``held``) goes on with that, however short. Fills ``where``
    (satellite, pointing, second), ``length``, ``worth`` and ``key`` (of the dear targets) as far as these reach.
    """
    found = 0
    satellites, horizon, pointings = image_at.shape
    for s in range(satellites):
        for k in range(pointings):
            following = horizon
            ahead = np.empty(horizon, np.int64)
            for t in range(horizon - 1, -1, -1):
                if image_at[s, t, k] >= 0:
                    following = t
                ahead[t] = following
            for a in range(horizon):
                if ahead[a] >= a + most:
                    continue
                value, marks = 0.0, np.uint64(0)
                for t in range(a, min(horizon, a + most)):
                    if not allowed[s, t]:
                        break
                    i = image_at[s, t, k]
                    if i >= 0:
                        for e in range(start[i], start[i + 1]):
                            if before[e] < a:
                                value += price[target[e]]
                                marks += mark[target[e]]
                    joined = (a > 0 and held[s, a - 1]) or (t + 1 < horizon and held[s, t + 1])
                    if (t - a + 1 < least and not joined) or (value <= 0.0 and marks == np.uint64(0)):
                        continue
                    if found < len(length):
                        where[found, 0], where[found, 1], where[found, 2] = s, k, a
                        length[found], worth[found], key[found] = t - a + 1, value, marks
                    found += 1
    return found


def recording_windows(
    problem: PlanningProblem, chunks: Chunks, least: int, dear: IntArray, price: FloatArray, energy: bool,
    most: int,
) -> Windows | None:  # fmt: skip
    """The windows worth choosing from; None where there are none or too many.

    ``dear`` are target indices; ``price`` (all targets) counts every time that a window holds the target. With
    ``energy`` windows in sunlight and in umbra are told apart. Worth is rounded up until at most ``most`` are left to
    compare with each other.
    """
    raw = _every_window(problem, least, dear, price)
    if raw is None:
        return None
    where, length, worth, key = raw
    satellite, second = where[:, 0], where[:, 2]
    chunk_at = _chunk_at(problem, chunks)
    first, last = chunk_at[satellite, second], chunk_at[satellite, second + length - 1]
    sending = np.zeros(len(chunks) + 1, np.int64)
    busy = (np.bincount(chunks.link_chunk, minlength=len(chunks)) > 0) | (chunks.frozen_downlink > 0)
    np.cumsum(busy, out=sending[1:])
    spread = (first != last) & (sending[last + 1] > sending[first])
    crossing = (first != last) & ~spread & energy
    place = satellite * problem.horizon_s + second
    group = np.where(spread, 2 * len(chunks) + place, 2 * last + crossing)
    # All but the earliest of those that lie side by side in a chunk begin in it; those with a start or a chunk's
    # beginning in common exclude each other.
    times = np.where(spread | crossing, 1, -(-(chunks.end_s - chunks.start_s)[last] // length))
    for steps in WORTH_STEPS:
        step = max(1e-12, float(worth.max(initial=0.0))) / steps
        rounded = np.ceil(worth / step - 1e-9) * step
        kept = _best_by_length(group, key, length, rounded / step)
        if len(kept) <= most:
            break
    if len(kept) > 3 * MOST_LEFT:
        return None
    sets = _dear_sets(problem, where[kept], length[kept], dear)
    best = kept[_undominated(group[kept], length[kept], rounded[kept] / step, sets)]
    if len(best) > MOST_LEFT:
        return None
    sets = sets[np.searchsorted(kept, best)]
    return Windows(
        satellite[best], second[best], length[best], where[best, 1], last[best], spread[best],
        first[best] == last[best], times[best], rounded[best], sparse.csr_array(sets),
    )  # fmt: skip


def _every_window(
    problem: PlanningProblem, least: int, dear: IntArray, price: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, np.ndarray] | None:
    own, shape = problem.images, problem.sunlit.shape
    image_at = np.full((*shape, max(1, len(problem.pointings))), -1, np.int64)
    image_at[own.satellite, own.second, own.pointing_of()] = np.arange(len(own))
    held = np.zeros(shape, bool)
    held[problem.frozen.satellite, problem.frozen.second] = True
    allowed = problem.commandable & ~held & (problem.frozen.downlink < 0)
    mark = np.zeros(len(price), np.uint64)
    mark[dear] = np.random.default_rng(20250212).integers(1, 2**63, len(dear), dtype=np.uint64)
    most = min(2 * least - 1, max(x.storage_images for x in problem.satellites))
    fixed = (allowed, held, image_at, own.start, own.target, _seen_before(problem), price, mark, least, most)
    nothing = np.zeros(0, np.int64)
    count = _scan(*fixed, nothing.reshape(0, 3), nothing, np.zeros(0), np.zeros(0, np.uint64))
    if not count or count > MOST_WINDOWS:
        return None
    where, length = np.empty((count, 3), np.int64), np.empty(count, np.int64)
    worth, key = np.empty(count), np.empty(count, np.uint64)
    _scan(*fixed, where, length, worth, key)
    return where, length, worth, key


def _seen_before(problem: PlanningProblem) -> IntArray:
    """Of every image-target entry, the second at which its satellite last saw the target before, same pointing."""
    own = problem.images
    entry = own.image_of_entry()
    line = own.satellite[entry] * max(1, len(problem.pointings)) + own.pointing_of()[entry]
    key, second = line * max(1, len(problem.targets.value)) + own.target, own.second[entry]
    order = np.lexsort((second, key))
    before = np.full(len(entry), LONG_AGO)
    same = key[order][1:] == key[order][:-1]
    before[order[1:]] = np.where(same, second[order][:-1], LONG_AGO)
    return before


def _chunk_at(problem: PlanningProblem, chunks: Chunks) -> IntArray:
    result = np.empty(problem.sunlit.shape, np.int64)
    for s in range(len(problem.satellites)):
        begins = chunks.start_s[chunks.offset[s] : chunks.offset[s + 1]]
        result[s] = chunks.offset[s] + np.searchsorted(begins, np.arange(problem.horizon_s), side="right") - 1
    return result


def _best_by_length(group: IntArray, key: np.ndarray, length: IntArray, worth: FloatArray) -> IntArray:
    """Of every group and set of dear targets: the worthiest window of each length that beats all shorter ones."""
    order = np.lexsort((-worth, length, key, group))
    new = np.ones(len(order), bool)
    new[1:] = (group[order][1:] != group[order][:-1]) | (key[order][1:] != key[order][:-1])
    lift = (np.cumsum(new) - 1.0) * (2.0 * float(worth.max(initial=0.0)) + 1.0)
    best = np.maximum.accumulate(worth[order] + lift)
    better = np.ones(len(order), bool)
    better[1:] = best[1:] > best[:-1] + 1e-6
    return np.sort(order[new | better])


def _dear_sets(problem: PlanningProblem, where: IntArray, length: IntArray, dear: IntArray) -> sparse.csr_array:
    """0/1 matrix, windows by dear targets."""
    own = problem.images
    column = np.full(len(problem.targets.value), -1, np.int64)
    column[dear] = np.arange(len(dear))
    entries = np.flatnonzero(column[own.target] >= 0)
    image = own.image_of_entry()[entries]
    line = (own.satellite * max(1, len(problem.pointings)) + own.pointing_of())[image] * 2 * problem.horizon_s
    place = line + own.second[image]
    order = np.argsort(place, kind="stable")
    entries, place = entries[order], place[order]
    begin = (where[:, 0] * max(1, len(problem.pointings)) + where[:, 1]) * 2 * problem.horizon_s + where[:, 2]
    low, high = np.searchsorted(place, begin), np.searchsorted(place, begin + length)
    rows = [np.unique(column[own.target[entries[a:b]]]) for a, b in zip(low, high, strict=True)]
    sizes = np.array([len(row) for row in rows], np.int64)
    indices = np.concatenate([np.zeros(0, np.int64), *rows])
    start = np.concatenate([[0], np.cumsum(sizes)])
    return sparse.csr_array((np.ones(len(indices)), indices, start), shape=(len(rows), len(dear)))


def _undominated(group: IntArray, length: IntArray, worth: FloatArray, sets: sparse.csr_array) -> BoolArray:
    """Windows than which no other of the group is as short, as worthy and holds the same dear targets at least."""
    keep, size = np.ones(len(group), bool), np.diff(sets.indptr)
    order = np.argsort(group, kind="stable")
    for mine in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        own = sets[mine]
        within = (own @ own.T).toarray() >= size[mine][:, None]
        within &= length[mine][None, :] <= length[mine][:, None]
        within &= worth[mine][None, :] >= worth[mine][:, None] - 1e-6
        equal = within & within.T
        within &= ~(equal & (np.arange(len(mine))[None, :] >= np.arange(len(mine))[:, None]))
        keep[mine[within.any(axis=1)]] = False
    return keep
