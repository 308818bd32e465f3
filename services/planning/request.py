"""One planning request solved: the options' restrictions before the solver, recordings after it, all in one result."""

from __future__ import annotations

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
from services.planning.problem import PlanningProblem
from services.planning.sequencing.recorded import THIS_CASE, recorded
from services.planning.spacecraft_limits import satellite_limits
from shared.contracts.spacecraft import Spacecraft
from shared.errors import DomainError

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


def sequenced(problem: PlanningProblem, rules: OperationRules) -> bool:
    """Whether the plan must be made of recordings: rules of sequence, or pointings to turn between."""
    return len(problem.pointings) > 1 or rules.sequenced


def solve(request: Request, progress: Progress, problem: PlanningProblem | None = None) -> Answer:
    """Plan the request as it stands (``active_mandatory`` ``true`` is treated as ``auto``)."""
    problem = build(request) if problem is None else problem
    rules = request.rules
    keepable = keepable_images(problem, request.previous)
    sure = with_fragile_discount(problem, request.tables["opportunities"], rules.fragile_discount)
    wished = with_change_penalty(sure, keepable, rules.change_penalty)
    mandatory = "auto" if request.options.active_mandatory == "true" else request.options.active_mandatory
    options = replace(request.options, active_mandatory=mandatory)
    if sequenced(problem, rules):
        full, made, bound_of = recorded(wished, rules, options, progress)
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
