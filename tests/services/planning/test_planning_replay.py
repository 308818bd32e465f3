"""The replay names each broken rule, its second and its satellite."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

from services.planning.operations import judge, make_plan
from tests.services.planning.planning_cases import Case, at, random_case

CASE = Case(
    images=[(1, "CYGFM01", 1, [10]), (2, "CYGFM01", 2, [11]), (3, "CYGFM01", 3, [12]), (4, "CYGFM02", 2, [10])],
    rewards={10: ("active", 2.0), 11: ("prefire", 1.0), 12: ("prefire", 0.5)},
    contacts=[("CYGFM01", "hawaii", 4.5, 10), ("CYGFM02", "hawaii", 4, 10)],
    craft={"battery_initial_wh": 10.0},
)


def rows(*records: tuple[str, float, float, str, Any]) -> pd.DataFrame:
    """(satellite, start, end, command, image or station) as a schedule."""
    return pd.DataFrame({
        "satellite": [r[0] for r in records],
        "start": [at(r[1]) for r in records],
        "end": [at(r[2]) for r in records],
        "command": [r[3] for r in records],
        "image_id": pd.array([r[4] if r[3] == "collect" else None for r in records], "Int32"),
        "station": [r[4] if r[3] == "downlink" else None for r in records],
        "cycle": 0,
        "uplink_contact": pd.NaT,
    })  # fmt: skip


def collect(satellite: str, second: float, image: int) -> tuple[str, float, float, str, Any]:
    return (satellite, second, second + 1, "collect", image)


GOOD = (
    collect("CYGFM01", 1, 1), collect("CYGFM01", 2, 2), ("CYGFM01", 5, 9, "downlink", "hawaii"),
    collect("CYGFM02", 2, 4), ("CYGFM02", 9, 10, "downlink", "hawaii"),
)  # fmt: skip


def test_a_sound_schedule_is_accepted() -> None:
    verdict = judge(rows(*GOOD), CASE.tables, CASE.spacecraft)
    assert verdict.valid, verdict.violations
    assert verdict.objective == pytest.approx(21.0)
    assert verdict.stored_at_end == {"CYGFM01": 0, "CYGFM02": 1}


@pytest.mark.parametrize(
    ("extra", "rule", "satellite", "second"),
    [
        ([collect("CYGFM01", 3, 3)], "storage", "CYGFM01", 3),
        ([("CYGFM01", 9, 10, "downlink", "hawaii")], "station", "CYGFM02", 9),
        ([("CYGFM01", 4, 5, "downlink", "hawaii")], "contact", "CYGFM01", 4),
        ([("CYGFM02", 2, 3, "downlink", "hawaii")], "simultaneous", "CYGFM02", 2),
        ([collect("CYGFM02", 3, 4)], "image", "CYGFM02", 3),
        ([collect("CYGFM02", 3, 99)], "image", "CYGFM02", 3),
        ([("CYGFM02", 3, 3.5, "downlink", "hawaii")], "interval", "CYGFM02", 3),
        ([("CYGFM02", 13, 15, "downlink", "hawaii")], "interval", "CYGFM02", 13),
        ([("CYGFM09", 1, 2, "downlink", "hawaii")], "command", "CYGFM09", 1),
    ],
)
def test_each_broken_rule_is_named(extra: list[Any], rule: str, satellite: str, second: int) -> None:
    verdict = judge(rows(*GOOD, *extra), CASE.tables, CASE.spacecraft)
    found = {violation.rule: violation for violation in verdict.violations}
    assert rule in found, verdict.violations
    assert (found[rule].satellite, found[rule].second) == (satellite, second)


def test_downlink_from_empty_storage() -> None:
    schedule = rows(collect("CYGFM02", 2, 4), ("CYGFM02", 4, 7, "downlink", "hawaii"))
    (violation,) = judge(schedule, CASE.tables, CASE.spacecraft).violations
    assert (violation.rule, violation.satellite, violation.second) == ("empty", "CYGFM02", 6)


def test_battery_floor_and_eclipse() -> None:
    # 2 Wh above the floor; in umbra nominal draw takes 0.5 Wh a second, an image another 0.5
    dark = replace(CASE, eclipses=[("CYGFM01", 0.5, 2.9)], craft={"battery_initial_wh": 4.0})
    assert judge(rows(), dark.tables, dark.spacecraft).valid
    verdict = judge(rows(collect("CYGFM01", 1, 1), collect("CYGFM01", 2, 2)), dark.tables, dark.spacecraft)
    (violation,) = verdict.violations
    assert (violation.rule, violation.satellite, violation.second) == ("battery", "CYGFM01", 2)
    penumbra = {**dark.tables, "eclipses": dark.tables["eclipses"].assign(kind="penumbra")}
    assert judge(rows(collect("CYGFM01", 1, 1)), penumbra, dark.spacecraft).valid


def test_uplink_and_unavailable() -> None:
    states = {"CYGFM01": {"uplink_margin_s": 1}, "CYGFM02": {"unavailable": [{"start": at(9.5), "end": at(11)}]}}
    case = replace(CASE, contacts=[*CASE.contacts, ("CYGFM01", "dongara", 0, 1)], craft={"satellites": states})
    late, early = rows(collect("CYGFM01", 2, 2)), rows(collect("CYGFM01", 1, 1))
    assert judge(late, case.tables, case.spacecraft, release=at(0)).valid
    (violation,) = judge(early, case.tables, case.spacecraft, release=at(0)).violations
    assert (violation.rule, violation.second) == ("uplink", 1)
    assert judge(early, case.tables, case.spacecraft, release=at(0), previous=early).valid
    (violation,) = judge(rows(*GOOD), case.tables, case.spacecraft).violations
    assert (violation.rule, violation.satellite, violation.second) == ("unavailable", "CYGFM02", 9)


@pytest.mark.parametrize("seed", range(40, 52))
def test_tampering_with_a_plan_is_noticed(seed: int) -> None:
    """Every collect moved by a second is no image; every downlink doubled onto another satellite takes its station."""
    case = random_case(seed, 2, 12, tight=False)
    schedule = make_plan(case.tables, case.spacecraft).schedule
    moved = schedule.copy()
    which = (moved["command"] == "collect") & (moved["start"] > at(0))
    moved.loc[which, ["start", "end"]] -= pd.Timedelta(seconds=1)
    assert not which.any() or not judge(moved, case.tables, case.spacecraft).valid
    down = schedule[schedule["command"] == "downlink"]
    other = {"CYGFM01": "CYGFM02", "CYGFM02": "CYGFM01"}
    doubled = pd.concat([schedule, down.assign(satellite=down["satellite"].map(other))])
    assert not len(down) or not judge(doubled, case.tables, case.spacecraft).valid
