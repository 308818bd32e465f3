"""Planning again in mid-plan: what ran stays, news come in, changes are listed and can be made to cost."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.planning.operations import judge, make_plan
from services.planning.options.rules import OperationRules, Outage, TargetChange
from services.planning.planner import Options
from tests.services.planning.planning_cases import Case, at, random_case

EXACT = Options(mip_gap=0.0)
CASE = Case(
    [(i, "CYGFM01", float(i), [i]) for i in range(10)], {i: ("prefire", 1.0 + i % 5) for i in range(10)},
    [("CYGFM01", "hawaii", 4, 9), ("CYGFM01", "dongara", 10, 13)], craft={"battery_initial_wh": 10.0},
)  # fmt: skip


def renumbered(case: Case) -> Case:
    """The same images under other ids, as the next access prediction would number them."""
    return replace(case, images=[(1000 + i, s, t, covered) for i, s, t, covered in case.images])


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(1, 10**6), now=st.integers(0, 13), lost=st.sampled_from(["", "hawaii", "dongara", "CYGFM02"]))
def test_planning_again_at_any_second_with_any_loss(seed: int, now: int, lost: str) -> None:
    """Whatever is executed by ``now`` and can still run stays; the plan passes the replay, also under new image ids."""
    case = random_case(seed, 2, 14, tight=bool(seed % 2))
    previous = make_plan(case.tables, case.spacecraft).schedule
    after = renumbered(case)
    outages = (Outage(at(now), None, **{"satellite" if lost.startswith("CYG") else "station": lost}),) if lost else ()
    rules = OperationRules(frozen_until=at(now), outages=outages)
    made = make_plan(after.tables, after.spacecraft, previous=previous, rules=rules, price=False)
    assert judge(made.schedule, after.tables, after.spacecraft, previous=previous, rules=rules).valid
    assert made.problem.frozen.dropped == 0 or lost
    early = previous[previous["start"] < at(now)]
    new = made.schedule
    for row in early[early["command"] == "collect"].itertuples():
        assert ((new["satellite"] == row.satellite) & (new["start"] == row.start)).any()


def test_leaving_out_what_is_on_board_is_refused() -> None:
    previous = make_plan(CASE.tables, CASE.spacecraft, options=EXACT).schedule
    rules = OperationRules(frozen_until=at(6))
    made = make_plan(CASE.tables, CASE.spacecraft, previous=previous, rules=rules)
    first = made.schedule.iloc[0]
    assert first["command"] == "collect" and first["start"] < at(6)
    forged = made.schedule.iloc[1:]
    found = {v.rule: v for v in judge(forged, CASE.tables, CASE.spacecraft, previous=previous, rules=rules).violations}
    assert found["frozen"].second == (first["start"] - at(0)).total_seconds()


def test_new_fires_come_in_and_only_later_commands_change() -> None:
    previous = make_plan(CASE.tables, CASE.spacecraft, options=EXACT).schedule
    news = replace(renumbered(CASE), rewards={**CASE.rewards, 9: ("active", 9.0)})
    rules = OperationRules(frozen_until=at(5))
    made = make_plan(news.tables, news.spacecraft, previous=previous, rules=rules, options=EXACT)
    assert made.report["targets"]["active"]["planned"] == 1
    changed = made.changes[made.changes["change"] != "kept"]
    assert (changed["start"] >= at(5)).all()
    listed = made.report["previous_plan"]["changes"]
    before, after = (frame["command"].eq("collect").sum() for frame in (previous, made.schedule))
    assert listed["kept"]["collect_s"] + listed["dropped"]["collect_s"] == before
    assert listed["kept"]["collect_s"] + listed["added"]["collect_s"] == after
    assert sum(listed["dropped_because"].values()) == sum(listed["dropped"].values())


def test_a_lost_satellite_and_a_lost_station_are_named_in_the_changes() -> None:
    case = random_case(3, 2, 14, tight=False)
    previous = make_plan(case.tables, case.spacecraft).schedule
    images = [image for image in case.images if image[1] != "CYGFM02"]
    gone = replace(case, images=images, contacts=[contact for contact in case.contacts if contact[0] != "CYGFM02"])
    made = make_plan(gone.tables, gone.spacecraft, previous=previous)
    lost = made.changes[(made.changes["satellite"] == "CYGFM02")]
    assert len(lost) and (lost["change"] == "dropped").all() and lost["reason"].str.contains("satellite lost").all()
    station = previous.loc[previous["command"] == "downlink", "station"].iloc[0]
    rules = OperationRules(outages=(Outage(at(0), None, station=station, why="storm"),))
    made = make_plan(case.tables, case.spacecraft, previous=previous, rules=rules, price=False)
    assert station not in set(made.schedule["station"].dropna())
    reasons = made.changes.loc[(made.changes["station"] == station), "reason"]
    assert (reasons == "contact lost or not usable").all() and len(reasons)
    assert made.report["options"]["outages"][0]["why"] == "storm"


def test_a_penalty_keeps_the_old_plan_unless_news_are_worth_it() -> None:
    previous = make_plan(CASE.tables, CASE.spacecraft, options=EXACT).schedule
    kept = set(previous["image_id"].dropna())
    slightly = {i: (kind, r + (0.0 if i in kept else 1.5)) for i, (kind, r) in CASE.rewards.items()}
    news = replace(CASE, rewards=slightly)
    free = make_plan(news.tables, news.spacecraft, previous=previous, options=EXACT)
    assert free.report["previous_plan"]["images_given_up"] > 0
    rules = OperationRules(change_penalty=5.0)
    loyal = make_plan(news.tables, news.spacecraft, previous=previous, rules=rules, options=EXACT)
    assert loyal.report["previous_plan"]["images_given_up"] == 0
    assert loyal.plan.gap == pytest.approx(0.0, abs=1e-6)
    (price,) = loyal.report["option_prices"]
    assert price["option"] == "change_penalty"
    assert price["cost"] == pytest.approx(free.report["reward"] - loyal.report["reward"]) and price["cost"] > 0
    cheap = OperationRules(change_penalty=0.01)
    moved = make_plan(news.tables, news.spacecraft, previous=previous, rules=cheap, options=EXACT)
    given_up = moved.report["previous_plan"]["images_given_up"]
    assert given_up > 0
    assert moved.plan.objective == pytest.approx(moved.report["reward"] - 0.01 * given_up)
    verdict = judge(moved.schedule, news.tables, news.spacecraft, previous=previous, rules=cheap)
    assert verdict.dropped_images == given_up and verdict.change_cost == pytest.approx(0.01 * given_up)


@pytest.mark.parametrize("seed", range(700, 706))
def test_executed_state_carries_over_into_a_later_horizon(seed: int) -> None:
    """A plan made again from the middle, with storage and charge as they are then, goes on where the old one stands."""
    case = random_case(seed, 1, 10, tight=False)
    previous = make_plan(case.tables, case.spacecraft).schedule
    half = previous[previous["start"] < at(7)].assign(end=lambda f: f["end"].clip(upper=at(7)))
    verdict = judge(half, case.tables, case.spacecraft)
    state = {"CYGFM01": {"stored_images_initial": verdict.stored_at_end["CYGFM01"],
                         "battery_initial_wh": verdict.battery_at_end_wh["CYGFM01"]}}  # fmt: skip
    later = case.spacecraft.at_horizon({"horizon_start": at(7), "horizon_s": 7, "satellites": state})
    made = make_plan(case.tables, later, previous=previous)
    assert judge(made.schedule, case.tables, later, previous=previous).valid
    assert (made.schedule["start"] >= at(7)).all() if len(made.schedule) else True
    assert (pd.to_datetime(made.changes["start"]) >= at(7)).all()


def test_giving_up_what_a_person_excluded_counts_as_no_loss() -> None:
    """Planner and replay must agree on it, or the plan is not published."""
    previous = make_plan(CASE.tables, CASE.spacecraft, options=EXACT).schedule
    collected = set(previous["image_id"].dropna().astype(int))
    seen = CASE.tables["opportunities"]
    for target in seen.loc[seen["image_id"].isin(collected), "target_id"].unique():
        change = TargetChange(int(target), "exclude", "duty officer", "only smoke", at(0))
        rules = OperationRules(target_changes=(change,))
        made = make_plan(CASE.tables, CASE.spacecraft, previous=previous, rules=rules, options=EXACT, price=False)
        assert judge(made.schedule, CASE.tables, CASE.spacecraft, previous=previous, rules=rules).valid
