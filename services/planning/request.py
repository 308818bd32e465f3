"""One planning request solved: the options' restrictions before the solver, recordings after it, all in one result."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from services.planning.building import build_problem
from services.planning.options.robustness import with_fragile_discount
from services.planning.options.rules import OperationRules
from services.planning.options.wishes import Keepable, keepable_images, with_change_penalty, without_added_targets
from services.planning.planner import Options, Plan, Progress, plan
from services.planning.problem import BoolArray, PlanningProblem
from services.planning.sequencing.sequence import one_pointing, sequence
from services.planning.spacecraft_limits import satellite_limits
from shared.contracts.spacecraft import Spacecraft
from shared.errors import DomainError

GUIDE_SHARE = 0.5
"""Share of work and time for the plan by totals, where recordings are searched after it."""
THIS_CASE = "this case"
STRETCHES = ", with raw-IF data in the stretch of each pass that was set aside for them"
"""``nominal_share`` leaves the choice of seconds within a pass to the plan; one stretch is settled before the proof."""


@dataclass(frozen=True)
class Request:
    """A planning case and what is asked of its plan. ``tables``: opportunities, targets, contacts, eclipses."""

    tables: dict[str, pd.DataFrame]
    spacecraft: Spacecraft
    release: datetime | None = None
    previous: pd.DataFrame | None = None
    options: Options = field(default_factory=Options)
    rules: OperationRules = field(default_factory=OperationRules)

    @property
    def start(self) -> pd.Timestamp:
        """Start of the horizon, UTC."""
        return pd.Timestamp(self.spacecraft.horizon_start).tz_convert("UTC")

    @property
    def satellites(self) -> list[str]:
        """Every satellite that the tables name."""
        named = (set(self.tables[name]["satellite"].astype(str)) for name in ("opportunities", "contacts"))
        return sorted(set.union(*named))

    def case(self) -> dict[str, Any]:
        """What problem and replay alike are built from, spacecraft apart."""
        release = None if self.release is None else pd.Timestamp(self.release).tz_convert("UTC")
        return {
            **self.tables, "horizon_start": self.start, "horizon_s": self.spacecraft.horizon_s, "release": release,
            "previous": self.previous, "rules": self.rules,
        }  # fmt: skip


@dataclass(frozen=True)
class Answer:
    """A solved request. ``plan``'s objective and bound are equation 1 less what changes and fragile looks cost;
    ``reward`` is equation 1, ``fragile_cost`` what the discount on fragile looks takes off it."""

    problem: PlanningProblem
    plan: Plan
    reward: float
    keepable: Keepable
    dropped_images: int
    fragile_cost: float
    bound_of: str


def build(request: Request) -> PlanningProblem:
    """The request as a planning problem; `DomainError` where an input cannot be used."""
    limits = satellite_limits(request.spacecraft, request.satellites)
    return build_problem(**request.case(), spacecraft=limits)


def solve(request: Request, progress: Progress, problem: PlanningProblem | None = None) -> Answer:
    """Plan the request as it stands (``active_mandatory`` ``true`` is treated as ``auto``)."""
    problem = build(request) if problem is None else problem
    rules = request.rules
    keepable = keepable_images(problem, request.previous)
    sure = with_fragile_discount(problem, request.tables["opportunities"], rules.fragile_discount)
    wished = with_change_penalty(sure, keepable, rules.change_penalty)
    mandatory = "auto" if request.options.active_mandatory == "true" else request.options.active_mandatory
    options = replace(request.options, active_mandatory=mandatory)
    if len(problem.pointings) > 1 or rules.sequenced:
        full, made, bound_of = _recorded(wished, rules, options, progress)
    else:
        full, made, bound_of = wished, plan(wished, options, progress), THIS_CASE
    if rules.nominal_share > 0:
        bound_of += STRETCHES
    constant = rules.change_penalty * keepable.groups
    made = replace(made, objective=made.objective - constant, bound=made.bound - constant)
    plain = without_added_targets(full, problem)
    dropped, reward = keepable.dropped(made.timeline.images), plain.objective(made.timeline.images)
    fragile = max(0.0, reward - rules.change_penalty * dropped - made.objective) if rules.fragile_discount > 0 else 0.0
    answer = Answer(plain, made, reward, keepable, dropped, fragile, bound_of)
    _demand_pins(answer)
    return answer


def _recorded(
    wished: PlanningProblem, rules: OperationRules, options: Options, progress: Progress
) -> tuple[PlanningProblem, Plan, str]:
    """A plan of recordings: guided and bounded by the plan that totals per data cycle allow."""
    started = time.monotonic()
    guide = one_pointing(wished) if len(wished.pointings) > 1 else wished
    share = replace(
        options, time_limit_s=options.time_limit_s * GUIDE_SHARE, work_limit=options.work_limit * GUIDE_SHARE
    )
    found = plan(guide, share, progress)
    progress(82, "recordings")
    left: Callable[[], float] = lambda: options.time_limit_s - (time.monotonic() - started)  # noqa: E731
    required = _required(wished, options)
    best = sequence(
        wished, rules, guide, found.timeline.images, found.timeline.downlink, required,
        options.work_limit * (1 - GUIDE_SHARE), left,
    )  # fmt: skip
    objective = best.problem.objective(best.timeline.images)
    bound = max(objective, min(found.bound, best.bound))
    met = bool(best.problem.covered_targets(best.timeline.images)[required].all())
    exact = bool(np.isfinite(best.bound))
    # A search that misses one proves nothing; a plan that not even the case without recordings can make does.
    missed = False if (exact and not best.time_limited) or found.mandatory_possible is False else None
    made = replace(
        found, timeline=best.timeline, objective=objective, bound=bound, method=best.method,
        mandatory=found.mandatory and met, mandatory_possible=found.mandatory_possible if met else missed,
        time_limited=found.time_limited or best.time_limited,
    )  # fmt: skip
    return best.problem, made, THIS_CASE if exact else "the same case without recordings, switches and slews"


def _required(problem: PlanningProblem, options: Options) -> BoolArray:
    seen = problem.covered_targets(np.arange(len(problem.images)))
    wanted = problem.targets.demanded()
    if options.active_mandatory != "false":
        wanted = wanted | problem.targets.active
    return wanted & seen


def _demand_pins(answer: Answer) -> None:
    """Raise where a pinned target that commands can reach is not observed."""
    problem = answer.problem
    reachable = problem.covered_targets(np.arange(len(problem.images)))
    missed = problem.targets.demanded() & reachable & ~problem.covered_targets(answer.plan.timeline.images)
    if missed.any():
        raise DomainError(
            "the pinned targets cannot all be observed: storage, battery, stations or the options forbid it together",
            field="target_changes", value=[int(target) for target in problem.targets.target_id[missed][:20]],
            accepted="fewer pinned targets",
        )  # fmt: skip
