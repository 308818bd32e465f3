"""Options of an operations centre: each binds the plan, check-plan refuses what breaks it, the report has its price."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.planning.operations import judge, make_plan
from services.planning.options.rules import OperationRules, Outage, TargetChange
from services.planning.planner import Options
from shared.errors import DomainError
from tests.services.planning.planning_cases import START, Case, at, exhaustive_optimum, random_case

EXACT = Options(mip_gap=0.0)
SHOTS = [(i, "CYGFM01", float(i), [i]) for i in range(8)]
CASE = Case(
    SHOTS, {i: ("prefire", 1.0 + i) for i in range(8)}, [("CYGFM01", "hawaii", 8, 12), ("CYGFM01", "dongara", 4, 7)],
    craft={"battery_initial_wh": 10.0},
)  # fmt: skip


def change(target: int, action: str, priority: float | None = None) -> TargetChange:
    return TargetChange(target, action, "duty officer", "crew on site", START, priority)


def booked(*slots: tuple[str, float, float]) -> pd.DataFrame:
    return pd.DataFrame(
        [("CYGFM01", station, at(a), at(b)) for station, a, b in slots],
        columns=["satellite", "station", "start", "end"],
    )


RULES = {
    "booking": OperationRules(booked=booked(("hawaii", 9, 12))),
    "acquisition": OperationRules(acquisition_s=2.0),
    "nominal": OperationRules(nominal_share=0.5),
    "outage": OperationRules(outages=(Outage(at(5), None, station="dongara"),)),
    "min-collect": OperationRules(min_collect_s=3),
    "mode-switch": OperationRules(mode_switch_s=3),
    "commands": OperationRules(max_commands_per_day=1),
    "pinned": OperationRules(target_changes=(change(0, "pin"),)),
}
PRICED = {
    "booking": "booked_passes", "acquisition": "acquisition_s", "nominal": "nominal_share", "outage": "unavailable",
    "min-collect": "min_collect_s", "mode-switch": "mode_switch_s", "commands": "max_commands_per_day",
    "pinned": "target_changes",
}  # fmt: skip


@pytest.mark.parametrize("rule", RULES)
def test_an_option_is_kept_checked_and_priced(rule: str) -> None:
    free = make_plan(CASE.tables, CASE.spacecraft, options=EXACT)
    refused = judge(free.schedule, CASE.tables, CASE.spacecraft, rules=RULES[rule])
    found = {violation.rule: violation for violation in refused.violations}
    assert rule in found, refused.violations
    assert found[rule].satellite == "CYGFM01" and 0 <= found[rule].second < 14
    bound = make_plan(CASE.tables, CASE.spacecraft, options=EXACT, rules=RULES[rule])
    assert judge(bound.schedule, CASE.tables, CASE.spacecraft, rules=RULES[rule]).valid
    assert ("stretch" in bound.report["bound_of"]) == (rule == "nominal")
    (price,) = bound.report["option_prices"]
    assert price["option"] == PRICED[rule]
    assert price["cost"] == pytest.approx(free.plan.objective - bound.plan.objective)
    assert price["cost"] > 0


def test_no_option_no_price_and_the_same_plan() -> None:
    free = make_plan(CASE.tables, CASE.spacecraft, options=EXACT)
    assert free.report["option_prices"] == []
    assert make_plan(CASE.tables, CASE.spacecraft, options=EXACT, rules=OperationRules()).schedule.equals(free.schedule)


@pytest.mark.parametrize("seed", range(20, 28))
def test_restricted_contacts_give_the_optimum_of_the_restricted_case(seed: int) -> None:
    """Outages and acquisition are no more than other contacts: the exhaustive optimum of those is reached."""
    case = random_case(seed, 2, 8)
    rules = OperationRules(acquisition_s=1.0, outages=(Outage(at(3), at(6), station="hawaii"),))
    parts = [
        (s, g, begin + 1.0, end)
        for s, g, a, b in case.contacts
        for begin, end in (((a, min(b, 3.0)), (max(a, 6.0), b)) if g == "hawaii" else ((a, b),))
        if end > begin
    ]
    best = exhaustive_optimum(replace(case, contacts=[part for part in parts if part[3] > part[2]]))
    options = Options(mip_gap=0.0, active_mandatory="false")
    made = make_plan(case.tables, case.spacecraft, options=options, rules=rules, price=False)
    assert made.plan.objective == pytest.approx(best, abs=1e-6)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(5000, 10**6), acquisition=st.integers(0, 3), share=st.sampled_from([0.0, 0.2, 0.5, 1.0]),
    lost=st.sampled_from([None, "hawaii", "CYGFM02"]), book=st.booleans(),
)  # fmt: skip
def test_any_mix_of_options_gives_a_plan_that_the_replay_accepts(
    seed: int, acquisition: int, share: float, lost: str | None, book: bool
) -> None:
    case = random_case(seed, 2, 14, tight=bool(seed % 2))
    contacts = case.tables["contacts"]
    outage = () if lost is None else (Outage(at(4), at(9), **{"station" if lost == "hawaii" else "satellite": lost}),)
    slots = contacts.iloc[::2].assign(end=contacts["end"] - pd.Timedelta(seconds=0.5)) if book else None
    rules = OperationRules(acquisition_s=acquisition, nominal_share=share, outages=outage, booked=slots)
    made = make_plan(case.tables, case.spacecraft, rules=rules)
    assert judge(made.schedule, case.tables, case.spacecraft, rules=rules).valid
    assert all(price["cost"] >= 0 for price in made.report["option_prices"])
    down = made.schedule[made.schedule["command"] == "downlink"]
    for row in contacts.itertuples():
        inside = (down["satellite"] == row.satellite) & (down["station"] == row.station)
        inside &= (down["start"] >= row.start) & (down["end"] <= row.end)
        used = (down["end"] - down["start"])[inside].sum()
        assert used <= (1 - share) * (row.end - row.start) + pd.Timedelta(milliseconds=1)


def test_a_persons_changes_are_followed_and_kept_with_their_author() -> None:
    rules = OperationRules(target_changes=(change(7, "exclude"), change(0, "reweight", 50.0), change(1, "pin")))
    made = make_plan(CASE.tables, CASE.spacecraft, options=EXACT, rules=rules)
    seen = set(made.schedule["image_id"].dropna())
    assert {0, 1} <= seen and 7 not in seen
    kept = made.report["options"]["target_changes"]
    assert [row["action"] for row in kept] == ["exclude", "reweight", "pin"]
    authors = {(row["who"], row["why"], row["when"]) for row in kept}
    assert authors == {("duty officer", "crew on site", START.isoformat())}
    verdict = judge(made.schedule, CASE.tables, CASE.spacecraft, rules=rules)
    assert verdict.objective == pytest.approx(made.plan.objective)
    assert verdict.objective > judge(made.schedule, CASE.tables, CASE.spacecraft).objective


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ([change(99, "pin")], "target_changes[0].target_id"),
        ([change(0, "reweight")], "target_changes[0].priority"),
        ([change(0, "reweight", float("nan"))], "target_changes[0].priority"),
        ([change(0, "pin"), change(0, "exclude")], "target_changes[1]"),
        ([change(0, "paint")], "target_changes[0].action"),
        ([change(i, "pin") for i in range(8)], "target_changes"),
    ],
)
def test_changes_that_cannot_be_are_refused(changes: list[TargetChange], field: str) -> None:
    with pytest.raises(DomainError) as caught:
        make_plan(CASE.tables, CASE.spacecraft, rules=OperationRules(target_changes=tuple(changes)))
    assert caught.value.field == field


def test_a_pin_that_nothing_sees_is_reported_not_refused() -> None:
    case = replace(CASE, rewards={**CASE.rewards, 50: ("prefire", 1.0)})
    rules = OperationRules(target_changes=(change(50, "pin"),))
    made = make_plan(case.tables, case.spacecraft, rules=rules)
    (row,) = made.report["pinned_targets_not_observed"]
    assert (row["target_id"], row["reason"]) == (50, "no opportunity")
    assert judge(made.schedule, case.tables, case.spacecraft, rules=rules).valid


def test_unavailable_windows_have_a_price() -> None:
    states: dict[str, Any] = {"CYGFM01": {"unavailable": [{"start": at(6), "end": at(9)}]}}
    made = make_plan(CASE.tables, CASE.spacecraft.at_horizon({"satellites": states}), options=EXACT)
    (price,) = made.report["option_prices"]
    assert price["option"] == "unavailable" and price["cost"] > 0


def test_an_agile_opportunity_needs_a_slew_time() -> None:
    case = replace(CASE, pointing={i: f"side-{i % 2}" for i in range(8)}, craft={"slew": {"side-0": {"side-1": 3}}})
    with pytest.raises(DomainError) as caught:
        make_plan(case.tables, case.spacecraft)
    assert caught.value.field == "spacecraft.slew"
    assert "side-1 -> side-0" in str(caught.value.value)
    turned = replace(case, craft={"slew": {"side-0": {"side-1": 3}, "side-1": {"side-0": 3}}})
    still = replace(case, pointing={})
    hasty = make_plan(still.tables, still.spacecraft, options=EXACT).schedule
    found = {violation.rule for violation in judge(hasty, turned.tables, turned.spacecraft).violations}
    assert "slew" in found
