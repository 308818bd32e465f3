"""Compiled moves over recordings: blocks of seconds added, removed or exchanged, with every rule checked per move.

All work is counted in moves and the random stream is a fixed xorshift: equal inputs give equal plans everywhere.
"""

from __future__ import annotations

import numpy as np
from numba import njit

FOREIGN = 126
"""Marks a recording of the previous plan whose pointing nobody knows any more."""
CHECKPOINT = 500
"""Moves between looks at whether the current plan is the best: copying it costs more than many moves."""
# columns of `numbers` (per segment): seconds, base W, downlink flag, recordings of the previous plan, its downlinks
# columns of `limits` (per satellite): s per image, storage and initial store in image-seconds, battery start, floor,
# capacity in Ws, collect W, downlink W


@njit(cache=True)
def draw(state: np.ndarray) -> float:
    """Uniform in [0, 1): xorshift64*."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return float((x * np.uint64(2685821657736338717)) >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True)
def starts_at(rec, s, t):
    """1 where a recording starts in this second."""
    if t >= rec.shape[1] or rec[s, t] < 0:
        return 0
    return 1 if t == 0 or rec[s, t - 1] != rec[s, t] else 0


@njit(cache=True)
def put(s, t, new, rec, image_at, start, target, value, cover, segment, count, day, commands):
    """Set one satellite-second to a pointing or to nothing (-1); returns the change of value."""
    old = rec[s, t]
    if old == new:
        return 0.0
    before = starts_at(rec, s, t)
    after = starts_at(rec, s, t + 1)
    gain = 0.0
    if old >= 0:
        count[segment[s, t]] -= 1
        image = image_at[s, t, old]
        if image >= 0:
            for e in range(start[image], start[image + 1]):
                cover[target[e]] -= 1
                if cover[target[e]] == 0:
                    gain -= value[target[e]]
    rec[s, t] = new
    if new >= 0:
        count[segment[s, t]] += 1
        image = image_at[s, t, new]
        if image >= 0:
            for e in range(start[image], start[image + 1]):
                if cover[target[e]] == 0:
                    gain += value[target[e]]
                cover[target[e]] += 1
    commands[s, day[t]] += starts_at(rec, s, t) - before
    if t + 1 < rec.shape[1]:
        commands[s, day[t + 1]] += starts_at(rec, s, t + 1) - after
    return gain


@njit(cache=True)
def long_enough(rec, frozen, s, t, least):
    """Whether the recording that holds second t is long enough, or partly the previous plan's."""
    if t < 0 or t >= rec.shape[1] or rec[s, t] < 0:
        return True
    begin, end = t, t + 1
    while begin > 0 and rec[s, begin - 1] == rec[s, t] and end - begin < least:
        begin -= 1
        if frozen[s, begin]:
            return True
    while end < rec.shape[1] and rec[s, end] == rec[s, t] and end - begin < least:
        end += 1
    return end - begin >= least or frozen[s, t]


@njit(cache=True)
def slews_fit(rec, frozen, s, begin, end, slew, reach, initial):
    """Whether every change of pointing around [begin, end) leaves time to turn."""
    horizon = rec.shape[1]
    held, since = -1, 0
    t = begin - 1
    while t >= 0 and t >= begin - reach - 1:
        if rec[s, t] >= 0:
            held, since = rec[s, t], t + 1
            break
        t -= 1
    if held < 0 and t < 0:
        held, since = initial, 0
    last = min(horizon, end + reach + 1)
    for t in range(begin, last):
        now = rec[s, t]
        if now < 0:
            continue
        turns = held >= 0 and held != now and held != FOREIGN and now != FOREIGN and not frozen[s, t]
        if turns and t - since < slew[s, held, now]:
            return False
        held, since = now, t + 1
    return True


@njit(cache=True)
def resources_fit(s, offset, numbers, count, limits):
    """Storage and charge of one satellite by segments; the order within a segment is taken at its worst."""
    per, room = limits[s, 0], limits[s, 1]
    stored, charge = limits[s, 2], limits[s, 3]
    floor, full, collect, downlink = limits[s, 4], limits[s, 5], limits[s, 6], limits[s, 7]
    for c in range(offset[s], offset[s + 1]):
        length, base = numbers[c, 0], numbers[c, 1]
        n = count[c]
        if numbers[c, 2] > 0:
            sent = min(length, stored)
            stored -= sent
            charge = min(full, charge + (base - downlink) * sent)
            if charge < floor and sent > 0:
                return False
            charge = min(full, charge + base * (length - sent))
        else:
            stored += per * n
            if n > 0 and stored > room:
                return False
            net = base - collect
            if n > 0 and net < 0 and charge + net * n < floor:
                return False
            charge = min(full, charge + base * (length - n))
            if base < 0 and charge + net * n < floor and n > 0:
                return False
            charge = min(full, charge + net * n)
        if charge < floor - 1e-6:
            return False
    return True


@njit(cache=True)
def pick_recorded(state, rec, frozen, first, last, image_s, image_t):
    """An image among [first, last) whose second is recorded by this plan, or -1."""
    for _ in range(24):
        if last <= first:
            return -1
        i = first + int(draw(state) * (last - first))
        if rec[image_s[i], image_t[i]] >= 0 and not frozen[image_s[i], image_t[i]]:
            return i
    return -1


@njit(cache=True)
def choose_addition(state, rec, allowed, image_at, s, t, k, least, fill, window):
    """A block [a, b) holding t to record under k: one second beside a recording, else a new minimum; False if none."""
    horizon = rec.shape[1]
    if rec[s, t] >= 0 or not allowed[s, t]:
        return False
    a, b = t, t + 1
    beside = (t > 0 and rec[s, t - 1] == k) or (t + 1 < horizon and rec[s, t + 1] == k)
    if not beside or draw(state) < 0.1:
        length = least + int(draw(state) * draw(state) * 6)
        a = t - int(draw(state) * length)
        b = a + length
    if a < 0 or b > horizon:
        return False
    for u in range(a, b):
        if rec[s, u] >= 0 or not allowed[s, u] or (image_at[s, u, k] < 0 and not fill):
            return False
    window[0], window[1] = a, b
    return True


@njit(cache=True)
def choose_removal(state, rec, frozen, s, t, least, window):
    """A block holding t to drop: the second alone, a head or tail of its recording, or all of it."""
    begin, end = t, t + 1
    while begin > 0 and rec[s, begin - 1] == rec[s, t] and not frozen[s, begin - 1]:
        begin -= 1
    while end < rec.shape[1] and rec[s, end] == rec[s, t] and not frozen[s, end]:
        end += 1
    kind = draw(state)
    if kind < 0.35 and end - begin > least - (least > 1):  # one of the shortest may get a second elsewhere: a shift
        at_head = draw(state) < 0.5
        window[0], window[1] = (begin, begin + 1) if at_head else (end - 1, end)
    elif kind < 0.5 and least == 1:
        window[0], window[1] = t, t + 1
    elif kind < 0.7 and end - t >= least:
        window[0], window[1] = begin, t
    elif kind < 0.85 and t - begin >= least:
        window[0], window[1] = t, end
    else:
        window[0], window[1] = begin, end
    if window[1] <= window[0]:
        window[0], window[1] = begin, end


@njit(cache=True)
def anneal_blocks(
    moves, hot, cold, state, rec, best, totals, cover, count, commands, image_at, start, target, value, segment,
    segment_first, day, allowed, frozen, image_s, image_t, image_k, pick, sat_first, offset, numbers, limits,
    slew, initial, reach, least, fill, budget,
):  # fmt: skip
    """``moves`` proposals of geometric cooling from ``hot`` to ``cold``; ``totals`` holds value and best value."""
    gone, came = np.zeros(2, np.int64), np.zeros(2, np.int64)
    held = np.zeros(rec.shape[1], np.int8)
    for move in range(moves + 1):
        if (move % CHECKPOINT == 0 or move == moves) and totals[0] > totals[1] + 1e-9:
            totals[1] = totals[0]
            best[:] = rec
        if move == moves:
            break
        warmth = hot * (cold / hot) ** (move / moves)
        i = pick[int(draw(state) * len(pick))]
        s, t, k = image_s[i], image_t[i], image_k[i]
        gone[0] = gone[1] = came[0] = came[1] = 0
        kind = draw(state)
        adding = rec[s, t] < 0
        if adding and not choose_addition(state, rec, allowed, image_at, s, t, k, least, fill, came):
            continue
        if not adding and frozen[s, t]:
            continue
        if (not adding and kind < 0.15) or (adding and kind < 0.75):
            other = i
            if adding:
                near = draw(state) < 0.7
                c = segment[s, t]
                first, last = (segment_first[c], segment_first[c + 1]) if near else (sat_first[s], sat_first[s + 1])
                other = pick_recorded(state, rec, frozen, first, last, image_s, image_t)
            if other >= 0:
                choose_removal(state, rec, frozen, s, image_t[other], least, gone)
        elif not adding:
            continue
        held[: gone[1] - gone[0]] = rec[s, gone[0] : gone[1]]
        gain = 0.0
        for u in range(gone[0], gone[1]):
            gain += put(s, u, -1, rec, image_at, start, target, value, cover, segment, count, day, commands)
        for u in range(came[0], came[1]):
            gain += put(s, u, k, rec, image_at, start, target, value, cover, segment, count, day, commands)
        fits = gain >= 0 or draw(state) < np.exp(gain / warmth)
        if fits:
            fits = commands[s, day[gone[0]]] <= budget[s, day[gone[0]]] or gone[1] == gone[0]
            fits = fits and (
                came[1] == came[0]
                or (
                    commands[s, day[came[0]]] <= budget[s, day[came[0]]]
                    and commands[s, day[came[1] - 1]] <= budget[s, day[came[1] - 1]]
                )
            )
        if fits and least > 1:
            fits = long_enough(rec, frozen, s, gone[0] - 1, least) and long_enough(rec, frozen, s, gone[1], least)
            fits = fits and (came[1] == came[0] or long_enough(rec, frozen, s, came[0], least))
        if fits and reach > 0:
            for side in range(2):
                block = gone if side == 0 else came
                if fits and block[1] > block[0]:
                    fits = slews_fit(rec, frozen, s, block[0], block[1], slew, reach, initial[s])
        if fits:
            fits = resources_fit(s, offset, numbers, count, limits)
        if fits:
            totals[0] += gain
            continue
        for u in range(came[0], came[1]):
            put(s, u, -1, rec, image_at, start, target, value, cover, segment, count, day, commands)
        for u in range(gone[0], gone[1]):
            put(s, u, held[u - gone[0]], rec, image_at, start, target, value, cover, segment, count, day, commands)
