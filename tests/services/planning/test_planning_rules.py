"""Dropping a rule from the solver yields plans that the replay rejects: the rules do bind, and both sides know them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from services.planning.operations import judge, make_plan
from shared.contracts.spacecraft import Spacecraft
from tests.services.planning.planning_cases import Case, at, random_case


def rules_broken(case: Case, blind: Spacecraft, tables: dict[str, Any] | None = None) -> set[str]:
    """Rules that a plan made for the blind spacecraft (or tables) breaks on the true case."""
    made = make_plan(tables or case.tables, blind)
    return {violation.rule for violation in judge(made.schedule, case.tables, case.spacecraft).violations}


SHOTS = [(i, "CYGFM01", float(i), [i]) for i in range(6)]
REWARDS = {i: ("prefire", 1.0 + i) for i in range(6)}


def test_without_the_energy_rule() -> None:
    case = Case(SHOTS, REWARDS, [("CYGFM01", "hawaii", 8, 12)], [("CYGFM01", 0, 8)],
                {"battery_initial_wh": 6.5, "storage_images": 6})  # fmt: skip
    blind = case.spacecraft.at_horizon({"collect_w": 0.0, "downlink_w": 0.0})
    assert rules_broken(case, case.spacecraft) == set()
    assert "battery" in rules_broken(case, blind)


def test_without_the_storage_rule() -> None:
    case = Case(SHOTS, REWARDS, [("CYGFM01", "hawaii", 8, 12)], craft={"battery_initial_wh": 10.0})
    assert rules_broken(case, case.spacecraft) == set()
    assert rules_broken(case, case.spacecraft.at_horizon({"storage_images": 6})) == {"storage"}


def test_without_station_exclusivity() -> None:
    shots = [(i, f"CYGFM0{1 + i % 2}", float(i // 2), [i]) for i in range(6)]
    case = Case(shots, REWARDS, [(f"CYGFM0{s}", "hawaii", 4, 10) for s in (1, 2)], craft={"battery_initial_wh": 10.0})
    tables = case.tables
    twin = tables["contacts"].assign(station=["hawaii", "hawaii-2"])
    made = make_plan({**tables, "contacts": twin}, case.spacecraft)
    forged = made.schedule.assign(station=made.schedule["station"].replace("hawaii-2", "hawaii"))
    assert {v.rule for v in judge(forged, tables, case.spacecraft).violations} == {"station"}
    assert rules_broken(case, case.spacecraft) == set()


def test_without_the_uplink_rule() -> None:
    case = Case(SHOTS, REWARDS, [("CYGFM01", "hawaii", 2, 5)], craft={"battery_initial_wh": 10.0})
    careless = make_plan(case.tables, case.spacecraft)
    verdict = judge(careless.schedule, case.tables, case.spacecraft, release=at(0))
    assert [v.rule for v in verdict.violations] == ["uplink"]
    careful = make_plan(case.tables, case.spacecraft, release=at(0).to_pydatetime())
    assert (careful.schedule["start"] >= at(5)).all()
    assert len(careful.schedule)
    assert (careful.schedule["uplink_contact"] == at(2)).all()


@pytest.mark.parametrize("seed", range(60, 72))
def test_the_previous_plan_runs_until_the_uplink(seed: int) -> None:
    case = random_case(seed, 2, 14, tight=False)
    release = at(4).to_pydatetime()
    previous = make_plan(case.tables, case.spacecraft).schedule
    made = make_plan(case.tables, case.spacecraft, release=release, previous=previous)
    assert judge(made.schedule, case.tables, case.spacecraft, release=release, previous=previous).valid
    assert made.problem.frozen.dropped == 0
    early = previous[previous["start"] < at(4)]
    kept = made.schedule[made.schedule["command"] == "collect"]
    wanted = early.loc[early["command"] == "collect", "image_id"]
    assert set(wanted) <= set(kept["image_id"])
    assert made.plan.objective >= 0


def test_initial_state_and_unavailable_windows_are_honoured() -> None:
    states = {"CYGFM01": {"stored_images_initial": 2, "unavailable": [{"start": at(9), "end": at(10)}]}}
    case = Case([*SHOTS, (6, "CYGFM01", 12.0, [5])], REWARDS, [("CYGFM01", "hawaii", 6, 12)],
                craft={"battery_initial_wh": 10.0, "satellites": states})  # fmt: skip
    made = make_plan(case.tables, case.spacecraft)
    collects = made.schedule[made.schedule["command"] == "collect"]
    assert collects["image_id"].tolist() == [6]
    busy = made.schedule[(made.schedule["start"] < at(10)) & (made.schedule["end"] > at(9))]
    assert busy.empty


def test_lost_contact_drops_the_previous_downlink() -> None:
    case = Case(SHOTS, REWARDS, [("CYGFM01", "hawaii", 6, 8), ("CYGFM01", "dongara", 10, 12)],
                craft={"battery_initial_wh": 10.0})  # fmt: skip
    previous = make_plan(case.tables, case.spacecraft).schedule
    lost = replace(case, contacts=[("CYGFM01", "dongara", 10, 12)])
    made = make_plan(lost.tables, lost.spacecraft, release=at(0).to_pydatetime(), previous=previous)
    assert made.report["previous_plan"]["command_s_that_cannot_run"] == 2
