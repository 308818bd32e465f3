"""Mandatory active targets: named with their reason where they cannot all be met, and what the demand costs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from services.planning.operations import make_plan
from services.planning.planner import Options
from shared.errors import DomainError
from tests.services.planning.planning_cases import Case, exhaustive_optimum, random_case

# storage of two: either two small active targets, or one small and a rich pre-fire image, before the only pass
CASE = Case(
    [(0, "CYGFM01", 1, [1]), (1, "CYGFM01", 2, [2]), (2, "CYGFM01", 3, [3]), (3, "CYGFM01", 4, [5])],
    {1: ("active", 0.4), 2: ("active", 0.3), 3: ("active", 0.2), 4: ("active", 1.0), 5: ("prefire", 9.0)},
    [("CYGFM01", "hawaii", 8, 9)], craft={"battery_initial_wh": 10.0},
)  # fmt: skip


def test_auto_drops_the_constraint_and_says_what_that_gains_and_loses() -> None:
    made = make_plan(CASE.tables, CASE.spacecraft, options=Options(mip_gap=0.0))
    mandatory = made.report["active_mandatory"]
    assert not mandatory["held"]
    assert made.plan.objective == pytest.approx(13.0)
    price = mandatory["dropping"]
    assert (price["active_observed"], price["active_observed_at_most"], price["active_lost_by_dropping"]) == (1, 2, 1)
    assert price["reward_with_most_active"] == pytest.approx(7.0)
    assert price["reward_gained_by_dropping"] == pytest.approx(6.0)
    reasons = {row["target_id"]: row["reason"] for row in made.report["active_targets_not_observed"]}
    assert reasons[4] == "no opportunity"
    assert reasons[2] == reasons[3] == "crowded out: storage of CYGFM01 in cycle 0"


def test_true_refuses_and_names_every_target_with_its_reason_and_the_price() -> None:
    with pytest.raises(DomainError) as caught:
        make_plan(CASE.tables, CASE.spacecraft, options=Options(mip_gap=0.0, active_mandatory="true"))
    message = caught.value.message
    assert caught.value.field == "active_mandatory"
    crowded = "target 2: crowded out: storage of CYGFM01 in cycle 0"
    for text in (crowded, "target 4: no opportunity", "reward 13", "6 more"):
        assert text in message


def test_battery_and_cycle_are_named_where_they_are_short() -> None:
    dark = replace(
        CASE, eclipses=[("CYGFM01", 0, 14)], craft={"battery_initial_wh": 10.0, "storage_images": 4},
        contacts=[("CYGFM01", "hawaii", 0, 1)],
    )  # fmt: skip
    made = make_plan(dark.tables, dark.spacecraft, options=Options(mip_gap=0.0))
    reasons = [row["reason"] for row in made.report["active_targets_not_observed"] if row["opportunities"]]
    assert reasons and all(reason == "crowded out: battery of CYGFM01 in cycle 1" for reason in reasons)


@pytest.mark.parametrize("seed", range(120, 130))
def test_true_gives_the_forced_optimum_or_refuses(seed: int) -> None:
    case = random_case(seed)
    forced = exhaustive_optimum(case, mandatory=True)
    reachable = {t for _, _, _, covered in case.images for t in covered}
    unseen = [t for t, (kind, _) in case.rewards.items() if kind == "active" and t not in reachable]
    options = Options(mip_gap=0.0, active_mandatory="true")
    if forced == float("-inf") or unseen:
        with pytest.raises(DomainError, match="not all active targets can be observed"):
            make_plan(case.tables, case.spacecraft, options=options)
    else:
        made = make_plan(case.tables, case.spacecraft, options=options)
        assert made.plan.objective == pytest.approx(forced, abs=1e-6)
        assert made.report["active_mandatory"]["dropping"] is None
