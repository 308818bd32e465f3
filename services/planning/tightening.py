"""A tighter bound: the relaxation solved again with the odd-set inequalities that it breaks, then whole counts.

What the search finds does not depend on it, so it runs beside the search.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import sparse

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.milp import DataCycleModel, with_cuts
from services.planning.odd_sets import odd_set_rows, violated_odd_sets
from services.planning.problem import FloatArray
from services.planning.quotas import whole_quotas
from services.planning.solving import Solution, solve_relaxation
from services.planning.work import guard_s

PRICED = 1e-7
"""Inequalities with a smaller multiplier, in the largest group value, do not matter and go."""
LEAST_GAIN = 2e-6
"""A round that takes less than this share off the bound is the last."""
QUOTA_GUARD_S = 20.0


def tightened_bound(
    model: DataCycleModel, chunks: Chunks, coverage: Coverage, relaxation: Solution, rounds: int,
    left: Callable[[], float], tell: Callable[[float], None] = lambda bound: None,
) -> tuple[float, bool]:  # fmt: skip
    """A bound on the objective of any plan, and whether time (``left`` seconds) cut it short.

    ``relaxation`` is the interior point's of ``model``, which may have cuts; each of at most ``rounds`` rounds adds the
    odd sets that the last point violates and solves again. ``tell`` hears of every bound on the way. The bound follows
    from multipliers alone (`lagrangian_bound`, `whole_quotas`), whatever the solver says.
    """
    seen, last, best = coverage.matrix(), relaxation, relaxation.bound
    sets = sparse.csr_array(model.matrix[model.groups : model.priced, model.images : model.images + model.groups])
    for _ in range(rounds):
        if last.groups is None or last.dual is None:
            break
        if left() <= 0:
            return best, True
        new = violated_odd_sets(seen, _share(last.images), _share(last.groups))
        if not new.shape[0]:
            break
        sets = sparse.csr_array(sparse.vstack([sets, new]))
        tight = with_cuts(model, *odd_set_rows(seen, sets, len(model.cost)))
        found = solve_relaxation(tight, guard_s(left, math.inf))
        gain, best = best - found.bound, min(best, found.bound)
        tell(best)
        if found.dual is None or found.time_limited:
            return best, True
        sets, model, last = _without_slack(sets, tight, found)
        if gain < LEAST_GAIN * best:
            break
    if last is relaxation or left() <= 0:
        return best, left() <= 0
    proof = whole_quotas(model, chunks, coverage, last, False, guard_s(left, QUOTA_GUARD_S))
    return min(best, proof.bound), proof.time_limited


def _share(values: FloatArray) -> FloatArray:
    return np.clip(values, 0.0, 1.0)


def _without_slack(
    sets: sparse.csr_array, model: DataCycleModel, found: Solution
) -> tuple[sparse.csr_array, DataCycleModel, Solution]:
    """Sets, model and solution without the cuts that carry no multiplier: the bound stays what it is."""
    assert found.dual is not None
    price = found.dual[model.groups : model.priced]
    keep = np.flatnonzero(price > PRICED * float(model.cost.max()))
    rows = model.groups + keep
    dual = np.concatenate([found.dual[: model.groups], price[keep], found.dual[model.priced :]])
    smaller = with_cuts(model, model.matrix[rows], model.row_high[rows])
    return sparse.csr_array(sets[keep]), smaller, replace(found, dual=dual)
