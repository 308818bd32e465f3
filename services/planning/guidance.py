"""What the search is led by: multipliers, quotas and a proven bound, rough ones at once and better ones after.

The interior point takes seconds in which nothing would be there to return. Next to it, on the other core, rough
multipliers give a bound, quotas and a short search: what a guard that cuts early returns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.milp import DataCycleModel, with_cuts
from services.planning.odd_sets import odd_set_rows, violated_odd_sets
from services.planning.quotas import Quotas, whole_quotas
from services.planning.solving import Solution, solve_relaxation, trivial_bound
from services.planning.subgradient import guided_multipliers, rounds_for
from services.planning.work import guard_s

LARGE_ENTRIES = 500_000
"""Image-target pairs beyond which an interior point takes longer than averaged subgradients deserve."""
QUICK_ROUNDS, QUICK_STEPS, QUICK_LAST_STEP = 3, 60, 0.004
POINT_ROUNDS, POINT_STEPS, POINT_LAST_STEP, POINT_REACH = 6, 150, 0.001, 1.0
"""Subgradients whose mean choices show which odd sets the relaxation would break: with those from the start, one
interior point does what would take two. Cycles longer than ``POINT_REACH`` cost more than they bring here."""
RELAXATION_SHARE = 0.7
"""Share of the time left that the interior point may take before the guard cuts it."""
DOUBT = 0.4
"""Mean group values by which averaged subgradients may misjudge an image: so much less it may be worth and is searched
all the same."""
QUOTA_GUARD_S = 20.0


@dataclass(frozen=True)
class Guidance:
    """Multipliers and values (``relaxation``) of ``model``, which may have cuts, whole-image ``quotas`` to start from,
    and the proven ``bound``."""

    model: DataCycleModel
    relaxation: Solution
    quotas: Quotas
    bound: float
    time_limited: bool


def is_large(coverage: Coverage) -> bool:
    """Whether subgradients alone lead the search."""
    return len(coverage.group) > LARGE_ENTRIES


def rough_guidance(model: DataCycleModel, chunks: Chunks, coverage: Coverage, left: Callable[[], float]) -> Guidance:
    """Averaged subgradients: half a second for cases of the paper's size, however early the guard; all that large
    cases get."""
    large = is_large(coverage)
    if large:
        relaxation = guided_multipliers(model, chunks, coverage, left, rounds_for(coverage))
    else:
        relaxation = guided_multipliers(
            model, chunks, coverage, rounds=QUICK_ROUNDS, steps=QUICK_STEPS, last_step=QUICK_LAST_STEP
        )
    quotas = whole_quotas(model, chunks, coverage, relaxation, True, guard_s(left, QUOTA_GUARD_S), exact=False)
    bound, cut = relaxation.bound, relaxation.time_limited or quotas.time_limited
    if large:
        if bound < trivial_bound(model):  # where everything can be had, whole numbers prove no more
            proof = whole_quotas(model, chunks, coverage, relaxation, False, guard_s(left, QUOTA_GUARD_S), exact=True)
            bound, cut = min(bound, proof.bound), cut or proof.time_limited
        doubt = DOUBT * float(coverage.value.mean())
        relaxation = replace(relaxation, reduced=relaxation.reduced + doubt)
    return Guidance(model, relaxation, quotas, bound, cut)


def exact_guidance(
    model: DataCycleModel, chunks: Chunks, coverage: Coverage, left: Callable[[], float]
) -> Guidance | None:
    """Interior point, then both quota programs side by side; None where the guard left the interior point
    without a point."""
    tight, slow = _with_likely_cuts(model, chunks, coverage, left)
    relaxation = solve_relaxation(tight, guard_s(lambda: left() * RELAXATION_SHARE, math.inf))
    if relaxation.dual is None:
        return None
    with ThreadPoolExecutor(max_workers=2) as pool:
        guard = guard_s(left, QUOTA_GUARD_S)
        tasks = [pool.submit(whole_quotas, tight, chunks, coverage, relaxation, guide, guard, True)
                 for guide in (True, False)]  # fmt: skip
        guide, proof = (task.result() for task in tasks)
    bound = min(relaxation.bound, proof.bound)
    cut = slow or relaxation.time_limited or guide.time_limited or proof.time_limited
    return Guidance(tight, relaxation, guide, bound, cut)


def _with_likely_cuts(
    model: DataCycleModel, chunks: Chunks, coverage: Coverage, left: Callable[[], float]
) -> tuple[DataCycleModel, bool]:
    """The model with the odd sets that its relaxation is likely to break; as it is where time cut their finding."""
    rough = guided_multipliers(
        model, chunks, coverage, left, rounds=POINT_ROUNDS, steps=POINT_STEPS, last_step=POINT_LAST_STEP
    )
    if rough.time_limited:
        return model, True
    seen, mean = coverage.matrix(), rough.images
    sets = violated_odd_sets(seen, mean, np.minimum(1.0, seen.T @ mean), POINT_REACH)
    return with_cuts(model, *odd_set_rows(seen, sets, len(model.cost))), False
