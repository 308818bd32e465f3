"""A case in which energy and station time both bind: without any one rule the plan is one that check-plan rejects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from services.planning.operations import judge, make_plan
from services.planning.planner import Options
from services.planning.spacecraft_limits import read_spacecraft
from shared.contracts.spacecraft import Spacecraft
from tests.services.planning.test_planning_real import load, thin

QUICK = Options(mip_gap=0.01, work_limit=1.0, active_mandatory="false")
Tight = tuple[dict[str, pd.DataFrame], Spacecraft]


@pytest.fixture(scope="module")
def tight(real_data: Path) -> Tight:
    """Nine hours of three satellites, an eighth of the pre-fire targets, a third of the storage, and a low battery."""
    frames, document = load(real_data / "planning/table1-la", "spacecraft_tight.json")
    frames = thin(frames, 8)
    start = pd.Timestamp(document["horizon_start"])  # type: ignore[arg-type]
    few = {"CYGFM01", "CYGFM04", "CYGFM07"}
    for name, column in (("opportunities", "time"), ("contacts", "start"), ("eclipses", "start")):
        frame = frames[name]
        inside = (frame[column] < start + pd.Timedelta(hours=9)) & frame["satellite"].isin(few)
        frames[name] = frame[inside].reset_index(drop=True)
    return frames, read_spacecraft({**document, "horizon_s": 32_400, "storage_images": 20, "battery_initial_wh": 70.0})


def rejected(tight: Tight, blind: Spacecraft, tables: dict[str, pd.DataFrame] | None = None, **judged: Any) -> set[str]:
    """Rules of the true case that a plan made for the blind one breaks."""
    frames, craft = tight
    schedule = make_plan(tables or frames, blind, options=QUICK).schedule
    schedule = schedule.assign(station=schedule["station"].str.split("@").str[0])
    return {violation.rule for violation in judge(schedule, frames, craft, **judged).violations}


def test_with_every_rule_the_plan_holds(tight: Tight) -> None:
    frames, craft = tight
    made = make_plan(frames, craft, options=QUICK)
    assert judge(made.schedule, frames, craft).valid
    low = min(row["battery_min_wh"] for row in made.report["satellites"].values())
    assert craft.battery_min_wh <= low < craft.battery_min_wh + 1.0


def test_without_the_energy_rule_the_plan_is_rejected(tight: Tight) -> None:
    assert "battery" in rejected(tight, tight[1].at_horizon({"battery_min_wh": 0.0}))


def test_without_the_storage_rule_the_plan_is_rejected(tight: Tight) -> None:
    assert "storage" in rejected(tight, tight[1].at_horizon({"storage_images": 500}))


def test_without_station_exclusivity_the_plan_is_rejected(tight: Tight) -> None:
    frames, craft = tight
    own = frames["contacts"].assign(station=frames["contacts"]["station"] + "@" + frames["contacts"]["satellite"])
    generous = craft.at_horizon({"battery_initial_wh": 90.0})
    assert "station" in rejected(tight, generous, {**frames, "contacts": own})


def test_without_the_uplink_rule_the_plan_is_rejected(tight: Tight) -> None:
    release = pd.Timestamp(tight[1].horizon_start) + pd.Timedelta(hours=1)
    assert rejected(tight, tight[1], release=release) == {"uplink"}
