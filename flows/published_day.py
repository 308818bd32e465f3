"""A day with published planner rows: plans under the conditions of that table, and the map of its priorities."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from flows.loop_types import CaseInputs, CycleProducts
from flows.runner import Runner
from flows.steps import ACTIVE_ONLY, PLANNER_ROWS, PRIORITY_MAP

PUBLISHED_ROWS = "published_rows"  # the case input that holds them
ROWS = "planner-rows"  # the part of the case under which our plans beside them lie: no cycle bears such a name
# The three tests of a day in the paper's Table 1. Its solver stops at a gap of 1e-4 unless told 0.01; ours besides when
# its counted work is done, about a minute on two cores.
_WORK = 8.0
TESTS = tuple({"mip_gap": gap, "work_limit": _WORK} for gap in (0.0001, 0.01, 0.0001))
_GUARD_S = 600.0


def map_priorities(runner: Runner, case: CaseInputs, title: str, cycle: CycleProducts) -> Mapping[str, Any]:
    """The map of a cycle's priorities over the country."""
    steps = cycle.steps
    drawn = {
        "title": title,
        "region": list(case.region),
        "cutoff": cycle.cutoff.isoformat(),
        "targets": steps["apply-decisions"]["targets"],
        "incidents": steps["assemble-inputs"]["incidents"],
        "ratings": steps["rate-active-fires"]["ratings"],
        "opportunities": steps["predict-access"]["opportunities"],
    }
    return runner.local(PRIORITY_MAP, drawn)


def plan_rows(runner: Runner, case: CaseInputs, cycle: CycleProducts) -> Mapping[str, Any]:
    """Our rows beside the published ones, with the seconds that each plan took in this run.

    As in the paper the plans begin with the first second of the day, with empty storage and no plan before them. They
    are no plans of the cycle: the runner must keep them apart from it.
    """
    steps = cycle.steps
    both = {name: steps["predict-access"][name] for name in ("opportunities", "contacts", "eclipses")}
    both |= {"targets": steps["apply-decisions"]["targets"], "spacecraft": steps["set-horizon"]["spacecraft"]}
    alone = runner.local(ACTIVE_ONLY, {name: both[name] for name in ("targets", "opportunities")})
    reports, seconds = [], []
    for given, options in zip((both, both, {**both, **alone}), TESTS, strict=True):
        begun = time.monotonic()
        planned = runner.service("planning", "plan-observations", {**given, **options, "time_limit_s": _GUARD_S})
        seconds.append(time.monotonic() - begun)
        reports.append(planned["report"])
    made = runner.local(PLANNER_ROWS, {"published": case.inputs[PUBLISHED_ROWS], "reports": reports})
    return {"rows": _timed(made["rows"], seconds), "table": made["table"]}


def _timed(rows: list[dict[str, Any]], seconds: list[float]) -> list[dict[str, Any]]:
    """Our rows with their seconds in this run: of reading, planning, replay and report, small if the store had it."""
    ours = iter(seconds)
    return [row if row["whose"] == "paper" else {**row, "solve_time": f"{next(ours):.1f} s"} for row in rows]
