"""The plan against every possible plan, on cases small enough to try them all."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.planning.operations import judge, make_plan
from services.planning.planner import Options
from tests.services.planning.planning_cases import exhaustive_optimum, random_case


@pytest.mark.parametrize("seed", range(24))
def test_plan_reaches_the_exhaustive_optimum(seed: int) -> None:
    case = random_case(seed)
    best = exhaustive_optimum(case)
    made = make_plan(case.tables, case.spacecraft, options=Options(mip_gap=0.0, active_mandatory="false"))
    assert made.plan.objective == pytest.approx(best, abs=1e-6)
    assert made.plan.bound >= best - 1e-6


@pytest.mark.parametrize("seed", range(100, 112))
def test_mandatory_targets_cost_what_the_exhaustive_search_says(seed: int) -> None:
    case = random_case(seed)
    forced, free = exhaustive_optimum(case, mandatory=True), exhaustive_optimum(case)
    made = make_plan(case.tables, case.spacecraft, options=Options(mip_gap=0.0, active_mandatory="auto"))
    held = made.report["active_mandatory"]["held"]
    assert held == (forced > float("-inf"))
    assert made.plan.objective == pytest.approx(forced if held else free, abs=1e-6)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(1000, 10**6), satellites=st.integers(1, 3), images=st.integers(1, 20), tight=st.booleans())
def test_every_plan_passes_the_replay_and_keeps_its_bound(seed: int, satellites: int, images: int, tight: bool) -> None:
    case = random_case(seed, satellites, images, tight)
    made = make_plan(case.tables, case.spacecraft)
    verdict = judge(made.schedule, case.tables, case.spacecraft)
    assert verdict.valid
    assert verdict.objective == pytest.approx(made.plan.objective)
    assert made.plan.objective <= made.plan.bound + 1e-9
    assert made.report["greedy_baseline"]["objective"] <= made.plan.bound + 1e-9


def test_same_inputs_same_schedule() -> None:
    case = random_case(7, 3, 20)
    first, second = (make_plan(case.tables, case.spacecraft).schedule for _ in range(2))
    assert first.equals(second)
