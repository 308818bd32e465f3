"""Compiled kernels of the search (numba): resource check, greedy filling, heat-bath moves, moves of downlink time.

Images are sorted by chunk. ``cover`` counts chosen images per target group, ``count`` chosen images per chunk;
``open_value`` of an image is the value of its groups that nobody covers, ``sole_value`` that of its groups covered
once: what an unchosen image would gain, and what a chosen one would lose.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

ADD_EVERY = 16
SHIFT_EVERY = 128
SHIFT_MOST_S = 20
FAR = 12.0
"""Images this many temperatures below the best of their chunk are not worth drawing (probability below 1e-5)."""


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _gain(i, start, group, value, cover):  # type: ignore[no-untyped-def]
    total = 0.0
    for e in range(start[i], start[i + 1]):
        if cover[group[e]] == 0:
            total += value[group[e]]
    return total


@njit(cache=True, nogil=True)
def put(i, sign, start, group, chunk, cover, count):  # type: ignore[no-untyped-def]
    """Add image i (``sign`` 1) or take it away (-1) in the counters."""
    count[chunk[i]] += sign
    for e in range(start[i], start[i + 1]):
        cover[group[e]] += sign


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _next(state):  # type: ignore[no-untyped-def]
    """xorshift64*: uniform in [0, 1)."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return np.float64((x * np.uint64(2685821657736338717)) >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True, nogil=True)
def _enter(j, start, group, value, seen_start, seen_by, cover, open_value, sole_value):  # type: ignore[no-untyped-def]
    """Count image j's groups once more and bring the values of all images that share them up to date."""
    for e in range(start[j], start[j + 1]):
        g = group[e]
        before, v = cover[g], value[g]
        cover[g] = before + 1
        if before == 0:
            for f in range(seen_start[g], seen_start[g + 1]):
                open_value[seen_by[f]] -= v
                sole_value[seen_by[f]] += v
        elif before == 1:
            for f in range(seen_start[g], seen_start[g + 1]):
                sole_value[seen_by[f]] -= v


@njit(cache=True, nogil=True)
def _leave(j, start, group, value, seen_start, seen_by, cover, open_value, sole_value):  # type: ignore[no-untyped-def]
    for e in range(start[j], start[j + 1]):
        g = group[e]
        before, v = cover[g], value[g]
        cover[g] = before - 1
        if before == 1:
            for f in range(seen_start[g], seen_start[g + 1]):
                open_value[seen_by[f]] += v
                sole_value[seen_by[f]] -= v
        elif before == 2:
            for f in range(seen_start[g], seen_start[g + 1]):
                sole_value[seen_by[f]] += v


@njit(cache=True, nogil=True)
def _lend(i, sign, start, group, value, seen_start, seen_by, cover, open_value):  # type: ignore[no-untyped-def]
    """Make what only image i covers open to everybody (``sign`` 1), or take that back (-1)."""
    for e in range(start[i], start[i + 1]):
        g = group[e]
        if cover[g] == 1:
            for f in range(seen_start[g], seen_start[g + 1]):
                open_value[seen_by[f]] += sign * value[g]


@njit(cache=True, nogil=True)
def _exchange(perm, place, a, b):  # type: ignore[no-untyped-def]
    x, y = perm[a], perm[b]
    perm[a], perm[b] = y, x
    place[x], place[y] = b, a


@njit(cache=True, nogil=True)
def _draw(i, lo, hi, other, temperature, state, chosen, open_value, weight, candidate):  # type: ignore[no-untyped-def]
    """An image of [lo, hi), or i itself, with probability proportional to exp(open value / temperature)."""
    top = open_value[i]
    for k in range(lo, hi):
        if open_value[k] > top:
            top = open_value[k]
    total, drawn = 0.0, 0
    for k in range(lo, hi):
        if open_value[k] > top - FAR * temperature and (not chosen[k] or k == i):
            weight[drawn] = math.exp((open_value[k] - top) / temperature)
            total += weight[drawn]
            candidate[drawn] = k
            drawn += 1
    if other:
        weight[drawn] = math.exp((open_value[i] - top) / temperature)
        total += weight[drawn]
        candidate[drawn] = i
        drawn += 1
    left = _next(state) * total
    for k in range(drawn):
        left -= weight[k]
        if left <= 0.0:
            return candidate[k]
    return i


@njit(cache=True, nogil=True)
def _grow(c, state, chosen, count, perm, place, first, open_value, sat, offset, numbers, limits):  # type: ignore[no-untyped-def]
    """The most gaining image of chunk c if one more fits there (put in front of ``perm``), else -1."""
    count[c] += 1
    if not satellite_ok(sat[c], count, offset, numbers, limits):
        count[c] -= 1
        return -1
    best, j = 1e-9, -1
    for k in range(first[c], first[c + 1]):
        if not chosen[k] and open_value[k] > best:
            best, j = open_value[k], k
    if j < 0:
        count[c] -= 1
        return -1
    chosen[j] = True
    _exchange(perm, place, place[j], first[c] + count[c] - 1)
    return j


@njit(cache=True, nogil=True)
def _shift(  # type: ignore[no-untyped-def]
    state, count, sat, offset, numbers, limits, link_s, link_chunk, link_most, room, spare, cell_start, cell_link
):
    """Move some seconds of one station cell between two satellites, or between one and the cell's spare seconds.

    Nothing is won at once; the satellite that gives must still do without, and the one that gets can collect more.
    """
    q = int(_next(state) * len(spare))
    links = cell_start[q + 1] - cell_start[q]
    a = int(_next(state) * (links + 1)) - 1
    b = int(_next(state) * (links + 1)) - 1
    if a == b:
        return
    giver = cell_link[cell_start[q] + a] if a >= 0 else -1
    taker = cell_link[cell_start[q] + b] if b >= 0 else -1
    seconds = min(1 + int(_next(state) * SHIFT_MOST_S), link_s[giver] if giver >= 0 else spare[q])
    if taker >= 0:
        seconds = min(seconds, link_most[taker] - link_s[taker], room[link_chunk[taker]])
    if seconds <= 0 or (giver >= 0 and taker >= 0 and link_chunk[giver] == link_chunk[taker]):
        return
    ok = True
    for link, sign in ((giver, -1), (taker, 1)):
        if link >= 0:
            numbers[link_chunk[link], 5] += sign * seconds
            ok = ok and satellite_ok(sat[link_chunk[link]], count, offset, numbers, limits)
    for link, direction in ((giver, -1), (taker, 1)):
        if link >= 0 and ok:
            link_s[link] += direction * seconds
            room[link_chunk[link]] -= direction * seconds
        elif link >= 0:
            numbers[link_chunk[link], 5] -= direction * seconds
        elif ok:
            spare[q] += direction * seconds


@njit(cache=True, nogil=True)
def heat_bath_moves(  # type: ignore[no-untyped-def]
    moves, hot, cold, crossing, state, chosen, best, totals, cover, count, open_value, sole_value, perm, place,
    weight, candidate, link_s, room, spare, numbers,
    start, group, value, seen_start, seen_by, chunk, first, fixed, sat, offset, limits,
    link_chunk, link_most, cell_start, cell_link,
):  # fmt: skip
    """``moves`` steps, cooling from ``hot`` to ``cold``. ``totals`` = [current, best]; ``best`` follows ``chosen``.

    A step takes one chosen image out and draws its successor from the whole chunk (in a share ``crossing`` of steps
    from another chunk of the satellite) as a heat bath at the current temperature would. ``perm`` keeps the chosen
    images of a chunk in front of the others; ``place`` is its inverse.
    """
    temperature = hot
    for move in range(moves):
        if move % 256 == 0:
            temperature = hot * (cold / hot) ** (move / moves)
        if move % SHIFT_EVERY == 0 and len(spare) > 0:
            _shift(state, count, sat, offset, numbers, limits, link_s, link_chunk, link_most, room, spare,
                   cell_start, cell_link)  # fmt: skip
        source = chunk[int(_next(state) * len(chosen))]
        if move % ADD_EVERY == 0:
            j = _grow(source, state, chosen, count, perm, place, first, open_value, sat, offset, numbers, limits)
            if j >= 0:
                totals[0] += open_value[j]
                _enter(j, start, group, value, seen_start, seen_by, cover, open_value, sole_value)
                if totals[0] > totals[1] + 1e-9:
                    totals[1] = totals[0]
                    best[:] = chosen
        if count[source] == 0:
            continue
        i = perm[first[source] + int(_next(state) * count[source])]
        if fixed[i]:
            continue
        s, c = sat[source], source
        if _next(state) < crossing:
            c = chunk[first[offset[s]] + int(_next(state) * (first[offset[s + 1]] - first[offset[s]]))]
            if c != source:
                count[c] += 1
                count[source] -= 1
                ok = satellite_ok(s, count, offset, numbers, limits)
                count[c] -= 1
                count[source] += 1
                if not ok:
                    continue
        lost = sole_value[i]
        _lend(i, 1.0, start, group, value, seen_start, seen_by, cover, open_value)
        j = _draw(i, first[c], first[c + 1], c != source, temperature, state, chosen, open_value, weight, candidate)
        delta = open_value[j] - lost
        _lend(i, -1.0, start, group, value, seen_start, seen_by, cover, open_value)
        if j == i:
            continue
        _leave(i, start, group, value, seen_start, seen_by, cover, open_value, sole_value)
        chosen[i] = False
        _exchange(perm, place, place[i], first[source] + count[source] - 1)
        count[source] -= 1
        _enter(j, start, group, value, seen_start, seen_by, cover, open_value, sole_value)
        chosen[j] = True
        count[c] += 1
        _exchange(perm, place, place[j], first[c] + count[c] - 1)
        totals[0] += delta
        if totals[0] > totals[1] + 1e-9:
            totals[1] = totals[0]
            best[:] = chosen
