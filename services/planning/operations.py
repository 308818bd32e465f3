"""A case in, a checked plan out: what both processes and the benchmarks call."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import pandas as pd

from services.planning.baselines.manual import manual_plan
from services.planning.bugs import PlanningBugError
from services.planning.check.replay import replay
from services.planning.check.verdict import Verdict
from services.planning.data_cycles import build_chunks
from services.planning.greedy import greedy_images
from services.planning.options.rules import OperationRules
from services.planning.planner import Options, Plan, Progress
from services.planning.pricing import price_mandatory, price_options
from services.planning.problem import PlanningProblem
from services.planning.products.changes import plan_changes
from services.planning.products.reasons import unmet_active
from services.planning.products.report import Comparison, plan_report
from services.planning.products.schedule import schedule_table
from services.planning.request import Answer, Request, build, solve
from services.planning.sequencing.sequence import one_pointing
from services.planning.spacecraft_limits import satellite_fields
from services.planning.validation import check_horizon
from shared.contracts.spacecraft import Spacecraft
from shared.errors import DomainError

NAMED_TARGETS = 20
"""Targets that a refusal names one by one."""


@dataclass(frozen=True)
class MadePlan:
    """A plan that passed the replay, with its schedule table, its changes against the previous one, and its report."""

    problem: PlanningProblem
    plan: Plan
    schedule: pd.DataFrame
    report: dict[str, Any]
    changes: pd.DataFrame


def _forward(progress: Progress) -> Progress:
    """``progress`` that never runs backwards, since small cases may be solved more than once."""
    furthest = 0.0

    def report(percent: float, text: str) -> None:
        nonlocal furthest
        furthest = max(furthest, percent)
        progress(furthest, text)

    return report


def make_plan(
    tables: dict[str, pd.DataFrame],
    spacecraft: Spacecraft,
    release: datetime | None = None,
    previous: pd.DataFrame | None = None,
    options: Options | None = None,
    progress: Progress = lambda percent, text: None,
    rules: OperationRules | None = None,
    price: bool = True,
) -> MadePlan:
    """Build, plan, replay and report. ``tables`` holds opportunities, targets, contacts and eclipses.

    ``price``: plan again without each option in force, to say what it costs. Raises `DomainError` for unusable inputs
    and where ``active_mandatory`` is ``true`` and cannot be, `PlanningBugError` where the replay rejects our own plan.
    """
    progress = _forward(progress)
    request = Request(tables, spacecraft, release, previous, options or Options(), rules or OperationRules())
    problem = build(request)
    answer = solve(request, progress, problem)
    mandatory, unpriced = price_mandatory(answer, request)
    if request.options.active_mandatory == "true":
        _demand_active(answer, mandatory)
    schedule = schedule_table(answer.problem, answer.plan.timeline, previous)
    progress(88, "replay")
    _check(schedule, request, answer)
    prices = price_options(request, answer, progress) if price else None
    progress(93, "report")
    changes = plan_changes(answer.problem, answer.plan.timeline, previous)
    guide = one_pointing(problem) if len(problem.pointings) > 1 else problem
    comparison = Comparison(
        greedy=guide.covered_targets(greedy_images(guide, build_chunks(guide))),
        manual=guide.covered_targets(manual_plan(guide).images), prices=prices, mandatory=mandatory,
        unpriced=unpriced,
    )  # fmt: skip
    report = plan_report(request, answer, comparison, changes)
    return MadePlan(answer.problem, answer.plan, schedule, report, changes)


def _check(schedule: pd.DataFrame, request: Request, answer: Answer) -> None:
    """The independent replay must accept the plan and find the same worth in it."""
    fields = satellite_fields(request.spacecraft, request.satellites)
    verdict = replay(schedule, spacecraft=fields, **request.case())
    if not verdict.valid:
        raise PlanningBugError(f"the plan breaks its own rules and is not published; {verdict.violations[0]}")
    scale = max(1.0, abs(answer.reward))
    if abs(verdict.objective - answer.reward) > 1e-6 * scale:
        raise PlanningBugError(f"the plan claims {answer.reward} but its replay observes {verdict.objective}")
    if abs(verdict.fragile_cost - answer.fragile_cost) > 1e-6 * scale:
        raise PlanningBugError(
            f"the plan claims that fragile looks cost {answer.fragile_cost} but its replay finds {verdict.fragile_cost}"
        )
    if verdict.dropped_images != answer.dropped_images:
        raise PlanningBugError(
            f"the plan claims {answer.dropped_images} dropped images but its replay counts {verdict.dropped_images}"
        )


def _demand_active(answer: Answer, price: dict[str, Any] | None) -> None:
    """Refuse a plan that leaves active targets out: each with its reason, and what the plan without the demand is."""
    unmet = unmet_active(answer.problem, answer.plan.timeline)
    if not unmet:
        return
    named = "; ".join(f"target {row['target_id']}: {row['reason']}" for row in unmet[:NAMED_TARGETS])
    more = f"; and {len(unmet) - NAMED_TARGETS} more" if len(unmet) > NAMED_TARGETS else ""
    dropping = f"without the demand a plan of reward {answer.reward:.6g} exists"
    if price is not None:
        dropping += f", {price['reward_gained_by_dropping']:.6g} more than with as many active targets as can be"
    raise DomainError(
        f"not all active targets can be observed: {named}{more}. Dropping the constraint: {dropping}",
        field="active_mandatory", value="true", accepted="auto or false, which plan the rest and name what is left out",
    )  # fmt: skip


def judge(
    schedule: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    spacecraft: Spacecraft,
    release: datetime | None = None,
    previous: pd.DataFrame | None = None,
    rules: OperationRules | None = None,
) -> Verdict:
    """The independent replay of ``schedule`` on a case."""
    check_horizon(spacecraft.horizon_s)
    request = Request(tables, spacecraft, release, previous, Options(), rules or OperationRules())
    fields = satellite_fields(spacecraft, request.satellites)
    return replay(schedule, spacecraft=fields, **request.case())
