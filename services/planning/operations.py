"""A case in, a checked plan out: what both processes and the benchmarks call."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import pandas as pd

from services.planning.building import build_problem
from services.planning.check.replay import replay
from services.planning.check.verdict import Verdict
from services.planning.data_cycles import build_chunks
from services.planning.greedy import greedy_images
from services.planning.planner import Options, Plan, Progress, plan
from services.planning.problem import PlanningProblem
from services.planning.report import plan_report
from services.planning.schedule import schedule_table
from services.planning.spacecraft_limits import satellite_fields, satellite_limits
from shared.contracts.spacecraft import Spacecraft
from shared.errors import DomainError, SmokeglintError


class PlanningBugError(SmokeglintError):
    """A plan of ours that the independent replay rejects: never published."""


@dataclass(frozen=True)
class MadePlan:
    """A plan that passed the replay, with its schedule table and report."""

    problem: PlanningProblem
    plan: Plan
    schedule: pd.DataFrame
    report: dict[str, Any]


def _names(tables: dict[str, pd.DataFrame]) -> list[str]:
    return sorted(
        set(tables["opportunities"]["satellite"].astype(str)) | set(tables["contacts"]["satellite"].astype(str))
    )


def _utc(moment: datetime | None) -> pd.Timestamp | None:
    return None if moment is None else pd.Timestamp(moment).tz_convert("UTC")


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
) -> MadePlan:
    """Build, plan, replay and report. ``tables`` holds opportunities, targets, contacts and eclipses.

    Raises `DomainError` for unusable inputs and `PlanningBugError` where the replay rejects our own plan.
    """
    progress = _forward(progress)
    start = pd.Timestamp(spacecraft.horizon_start).tz_convert("UTC")
    limits = satellite_limits(spacecraft, _names(tables))
    problem = build_problem(
        **tables, spacecraft=limits, horizon_start=start, horizon_s=spacecraft.horizon_s, release=_utc(release),
        previous=previous,
    )  # fmt: skip
    made = plan(problem, options or Options(), progress)
    schedule = schedule_table(problem, made.timeline, previous)
    progress(88, "replay")
    verdict = judge(schedule, tables, spacecraft, release, previous)
    if not verdict.valid:
        raise PlanningBugError(f"the plan breaks its own rules and is not published; {verdict.violations[0]}")
    if abs(verdict.objective - made.objective) > 1e-6 * max(1.0, abs(made.objective)):
        raise PlanningBugError(f"the plan claims {made.objective} but its replay observes {verdict.objective}")
    progress(93, "report")
    report = plan_report(problem, made, greedy_images(problem, build_chunks(problem)))
    return MadePlan(problem, made, schedule, report)


def judge(
    schedule: pd.DataFrame,
    tables: dict[str, pd.DataFrame],
    spacecraft: Spacecraft,
    release: datetime | None = None,
    previous: pd.DataFrame | None = None,
) -> Verdict:
    """The independent replay of ``schedule`` on a case."""
    if spacecraft.horizon_s <= 0:
        raise DomainError(
            "the horizon is empty", field="spacecraft.horizon_s", value=spacecraft.horizon_s, accepted="> 0 seconds"
        )
    start = pd.Timestamp(spacecraft.horizon_start).tz_convert("UTC")
    fields = satellite_fields(spacecraft, _names(tables))
    return replay(
        schedule, **tables, spacecraft=fields, horizon_start=start, horizon_s=spacecraft.horizon_s,
        release=_utc(release), previous=previous,
    )  # fmt: skip
