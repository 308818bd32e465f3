"""Multipliers and guidance for cases too large for interior points: averaged subgradients on the coverage rows.

With multipliers y on equation 2 an image is worth the sum of its groups' y, so that the best plan for given images per
chunk takes each chunk's dearest. Groups covered more than once make y fall, uncovered ones make it rise (Held, Wolfe
and Crowder 1974, doi:10.1007/BF01580223, with geometric steps); counts per chunk are settled anew by the quota program
at a few fixed moments. The bound comes from the quota program for the averaged y, and holds however rough that is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.milp import DataCycleModel
from services.planning.problem import FloatArray, IntArray
from services.planning.quotas import whole_quotas
from services.planning.solving import Solution, trivial_bound
from services.planning.work import guard_s

ROUNDS = 12
STEPS_PER_ROUND = 150
MOST_ROUNDS, ROUNDS_WORK = 36, 3e9
"""More rounds where they are cheap: up to so many, as steps times image-target pairs allow."""
ROUNDS_S = 120.0
"""Seconds that must be left for more than the least rounds."""
LARGE, SMALL = 0.15, 0.0002
"""First and last step, as shares of a group's value for each image too many or too few."""
QUOTA_GUARD_S = 60.0
"""Guard of one quota program, s."""


@njit(cache=True, nogil=True)
def _steps(steps, large, small, y, mean_y, mean_w, quota, order, first, start, group, value):  # type: ignore[no-untyped-def]
    """``steps`` subgradient steps on y in place; ``mean_y`` and ``mean_w`` average over the second half."""
    n = len(start) - 1
    price = np.empty(n)
    cover = np.empty(len(value), np.int64)
    mean_y[:] = 0.0
    mean_w[:] = 0.0
    kept = steps - steps // 2
    for step in range(steps):
        theta = large * (small / large) ** (step / steps)
        cover[:] = 0
        for i in range(n):
            total = 0.0
            for e in range(start[i], start[i + 1]):
                total += y[group[e]]
            price[i] = total
        for c in range(len(quota)):
            mine = order[first[c] : first[c + 1]]
            if quota[c] <= 0 or len(mine) == 0:
                continue
            ranked = np.argsort(-price[mine])
            for k in range(min(quota[c], len(mine))):
                i = mine[ranked[k]]
                if step >= steps - kept:
                    mean_w[i] += 1.0 / kept
                for e in range(start[i], start[i + 1]):
                    cover[group[e]] += 1
        for g in range(len(value)):
            if cover[g] != 1:
                y[g] = min(value[g], max(0.0, y[g] - theta * value[g] * (cover[g] - 1)))
            if step >= steps - kept:
                mean_y[g] += y[g] / kept


def rounds_for(coverage: Coverage) -> int:
    """Rounds that a case of this size is worth."""
    return int(np.clip(ROUNDS_WORK / (STEPS_PER_ROUND * max(1, len(coverage.group))), ROUNDS, MOST_ROUNDS))


def guided_multipliers(
    model: DataCycleModel, chunks: Chunks, coverage: Coverage, left: Callable[[], float] = lambda: QUOTA_GUARD_S,
    rounds: int = ROUNDS, steps: int = STEPS_PER_ROUND, last_step: float = SMALL,
) -> Solution:  # fmt: skip
    """In the form of a relaxation: mean choices as values, reduced costs, multipliers and a proven bound.

    Where ``left`` (seconds) runs out, the rounds made so far count, at least one.
    """
    chunk_of = chunks.image_chunk[coverage.image]
    order = np.argsort(chunk_of, kind="stable").astype(np.int64)
    first = np.searchsorted(chunk_of[order], np.arange(len(chunks) + 1)).astype(np.int64)
    value = coverage.value.astype(float)
    y, mean_y, mean_w = 0.4 * value, 0.4 * value, np.zeros(len(coverage.image))
    found = _as_solution(model, chunks, coverage, mean_w, mean_y, np.zeros(model.links), trivial_bound(model))
    best = found.bound
    cut = rounds > ROUNDS and left() < ROUNDS_S
    rounds = ROUNDS if cut else rounds
    for index in range(rounds):
        quotas = whole_quotas(model, chunks, coverage, found, True, guard_s(left, QUOTA_GUARD_S), exact=False)
        cut |= quotas.time_limited
        large, small = (LARGE * (last_step / LARGE) ** (x / rounds) for x in (index, index + 1))
        _steps(steps, large, small, y, mean_y, mean_w, quotas.images, order, first, coverage.start, coverage.group,
               value)  # fmt: skip
        found = _as_solution(model, chunks, coverage, mean_w, mean_y, quotas.links, best)
        if left() <= 0:
            cut = True
            break
    proof = whole_quotas(model, chunks, coverage, found, False, guard_s(left, QUOTA_GUARD_S), exact=False)
    return _as_solution(model, chunks, coverage, mean_w, mean_y, quotas.links, min(best, proof.bound), cut)


def _as_solution(
    model: DataCycleModel, chunks: Chunks, coverage: Coverage, weight: FloatArray, y: FloatArray, links: FloatArray,
    bound: float, cut: bool = False,
) -> Solution:  # fmt: skip
    dual = np.zeros(len(model.row_low))
    dual[: model.groups] = y
    price = coverage.matrix() @ y
    return Solution(
        weight.copy(), links, bound, price - _thresholds(price, weight, chunks.image_chunk[coverage.image]),
        feasible=True, time_limited=cut, dual=dual,
    )  # fmt: skip


def _thresholds(price: FloatArray, weight: FloatArray, chunk: IntArray) -> FloatArray:
    """What an image of each one's chunk must be worth: the mean price of those sometimes chosen, sometimes not."""
    between = (weight > 0.02) & (weight < 0.98)
    total = np.bincount(chunk[between], price[between], minlength=int(chunk.max(initial=0)) + 1)
    count = np.bincount(chunk[between], minlength=len(total))
    return np.where(count > 0, total / np.maximum(1, count), np.inf)[chunk]
