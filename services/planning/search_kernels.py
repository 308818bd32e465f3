"""Compiled kernels of the local search (numba): resource check, gains and losses, greedy filling, annealing moves.

Images are sorted by chunk; ``cover`` counts chosen images per target group, ``count`` chosen images per chunk.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def satellite_ok(s, count, offset, numbers, limits):  # type: ignore[no-untyped-def]
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
def put(i, sign, start, group, chunk, cover, count):  # type: ignore[no-untyped-def]
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
def fill(ranking, minimum, chosen, cover, count, start, group, value, chunk, sat, offset, numbers, limits):  # type: ignore[no-untyped-def]
    """Add images in the order given wherever they gain more than ``minimum`` and resources allow; returns the gain."""
    total = 0.0
    for i in ranking:
        if chosen[i]:
            continue
        gain = _gain(i, start, group, value, cover)
        if gain <= minimum:
            continue
        put(i, 1, start, group, chunk, cover, count)
        if satellite_ok(sat[chunk[i]], count, offset, numbers, limits):
            chosen[i] = True
            total += gain
        else:
            put(i, -1, start, group, chunk, cover, count)
    return total


@njit(cache=True)
def anneal_moves(  # type: ignore[no-untyped-def]
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
            put(j, 1, start, group, chunk, cover, count)
            if satellite_ok(s, count, offset, numbers, limits):
                delta = _loss(j, start, group, value, cover)
                _accept(j, -1, chosen, perm, place, first, count, chunk, c, c)
                totals[0] += delta
                if totals[0] > totals[1] + 1e-9:
                    totals[1] = totals[0]
                    best[:] = chosen
                continue
            put(j, -1, start, group, chunk, cover, count)
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
        put(out, -1, start, group, chunk, cover, count)
        delta = _gain(j, start, group, value, cover) - smallest
        good = delta >= 0.0 or _next(state) < math.exp(delta / temperature)
        if good:
            put(j, 1, start, group, chunk, cover, count)
            if other != c and not satellite_ok(s, count, offset, numbers, limits):
                put(j, -1, start, group, chunk, cover, count)
                good = False
        if not good:
            put(out, 1, start, group, chunk, cover, count)
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
