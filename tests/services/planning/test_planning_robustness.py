"""Looks that an along-track error may spoil: the plan prefers robust ones by as much as asked, proven and replayed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from services.planning.operations import judge, make_plan
from services.planning.options.rules import OperationRules
from services.planning.planner import Options
from shared.errors import DomainError
from tests.services.planning.planning_cases import Case, exhaustive_optimum, random_case

EXACT = Options(mip_gap=0.0)


def marked(case: Case, ahead: list[bool | None], behind: list[bool | None]) -> dict[str, Any]:
    """The case's tables with what an error does to each opportunity."""
    seen = case.tables["opportunities"]
    columns = {"covered_ahead": pd.array(ahead, "boolean"), "covered_behind": pd.array(behind, "boolean")}
    return {**case.tables, "opportunities": seen.assign(**columns)}


ONE_PLACE = {"storage_images": 1, "battery_initial_wh": 10.0}
EITHER = Case(
    [(0, "CYGFM01", 2.0, [0]), (1, "CYGFM01", 3.0, [1])],
    {0: ("prefire", 1.0), 1: ("prefire", 0.8)}, [("CYGFM01", "hawaii", 8, 12)], craft=ONE_PLACE,
)  # fmt: skip


@pytest.mark.parametrize(("discount", "target", "cost"), [(0.0, 0, 0.0), (0.1, 0, 0.1), (0.5, 1, 0.0)])
def test_a_robust_look_is_preferred_by_as_much_as_the_discount_says(discount: float, target: int, cost: float) -> None:
    tables = marked(EITHER, [True, True], [False, True])
    rules = OperationRules(fragile_discount=discount)
    made = make_plan(tables, EITHER.spacecraft, options=EXACT, rules=rules)
    assert set(made.schedule["image_id"].dropna()) == {target}
    assert made.plan.objective == pytest.approx(made.report["reward"] - cost)
    assert made.report["robustness"]["cost"] == pytest.approx(cost)
    assert made.report["robustness"]["observed_robustly"]["prefire"] == (target == 1)
    verdict = judge(made.schedule, tables, EITHER.spacecraft, rules=rules)
    assert verdict.valid
    assert verdict.fragile_targets == (target == 0)
    assert verdict.fragile_cost == pytest.approx(cost)
    if target == 1:
        price = {row["option"]: row["cost"] for row in made.report["option_prices"]}
        assert price["fragile_discount"] == pytest.approx(0.2)


@pytest.mark.parametrize("seed", range(8))
def test_discounted_plans_are_optimal(seed: int) -> None:
    case = random_case(seed)
    count = len(case.tables["opportunities"])
    rng = np.random.default_rng(seed)
    marks = rng.choice(np.array([True, True, False, None], object), (2, count)).tolist()
    marks[0][0] = marks[1][0] = True
    tables = marked(case, marks[0], marks[1])
    robust = [a is True and b is True for a, b in zip(*marks, strict=True)]
    looks = [(place, t) for place, (_, _, _, covered) in enumerate(case.images) for t in covered]

    def worth(one: Case, mask: int, mandatory: bool) -> float:
        earned: dict[int, float] = {}
        for (place, target), sure in zip(looks, robust, strict=True):
            if mask >> place & 1:
                earned[target] = max(earned.get(target, 0.0), 1.0 if sure else 0.6)
        return sum((10 if one.rewards[t][0] == "active" else 1) * one.rewards[t][1] * s for t, s in earned.items())

    options = replace(EXACT, active_mandatory="false")
    made = make_plan(tables, case.spacecraft, options=options, rules=OperationRules(fragile_discount=0.4))
    assert made.plan.objective == pytest.approx(exhaustive_optimum(case, worth=worth))
    assert made.plan.bound == pytest.approx(made.plan.objective)


def test_nobody_says_which_looks_are_fragile() -> None:
    with pytest.raises(DomainError, match="robust"):
        make_plan(EITHER.tables, EITHER.spacecraft, rules=OperationRules(fragile_discount=0.2))
    assert make_plan(EITHER.tables, EITHER.spacecraft).report["robustness"] is None
