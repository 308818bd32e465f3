"""Execution: storage first in first out, downlinks that pause, losses, and the battery against a plain loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from flows.steps.replay import AS_RUN_COLUMNS, battery_after, execute_schedule, is_lost
from shared.contracts import tables
from shared.contracts.spacecraft import Spacecraft

START = pd.Timestamp("2025-09-01T00:00:00Z")
NO_ECLIPSES = pd.DataFrame({"satellite": [], "start": [], "end": []})
NOTHING_CARRIED = pd.DataFrame({name: [] for name in AS_RUN_COLUMNS})


def spacecraft(**changes: Any) -> Spacecraft:
    values = {
        "storage_images": 3,
        "downlink_s_per_image": 4,
        "battery_capacity_wh": 90.0,
        "battery_min_wh": 10.0,
        "battery_initial_wh": 85.0,
        "generation_w": 40.0,
        "nominal_w": 20.0,
        "collect_w": 15.0,
        "downlink_w": 25.0,
        "horizon_start": START.to_pydatetime(),
        "horizon_s": 1000,
    }
    return Spacecraft.model_validate(values | changes)


def schedule(*rows: tuple[int, int, str]) -> pd.DataFrame:
    frame = pd.DataFrame(rows, columns=["first", "last", "command"]).astype({"first": int, "last": int})
    second = pd.Timedelta(seconds=1)
    collects = frame["command"] == "collect"
    made = pd.DataFrame(
        {
            "satellite": "CYGFM01",
            "start": START + frame["first"] * second,
            "end": START + frame["last"] * second,
            "command": frame["command"],
            "image_id": np.where(collects, np.arange(len(frame)), np.nan),
            "station": np.where(collects, None, "hawaii"),
            "cycle": 0,
            "uplink_contact": pd.NaT,
        }
    )
    return tables.SCHEDULE.check(made)


def test_images_come_down_in_order_across_a_pause() -> None:
    plan = schedule((0, 1, "collect"), (5, 6, "collect"), (10, 13, "downlink"), (20, 25, "downlink"))
    done = execute_schedule(plan, NOTHING_CARRIED, NO_ECLIPSES, spacecraft(), 100, 0.0).as_run
    tables.AS_RUN.check(done)
    assert done["status"].tolist() == ["downlinked", "downlinked"]
    assert done["downlinked_at"].tolist() == [START + pd.Timedelta(seconds=21), START + pd.Timedelta(seconds=25)]


def test_a_downlink_cut_by_the_end_leaves_the_image_on_board_for_the_next_cycle() -> None:
    plan = schedule((0, 1, "collect"), (10, 20, "downlink"))
    first = execute_schedule(plan, NOTHING_CARRIED, NO_ECLIPSES, spacecraft(), 12, 0.0)
    assert first.as_run["status"].tolist() == ["collected"]
    assert first.states["CYGFM01"].stored_images_initial == 1
    later = spacecraft(horizon_start=(START + pd.Timedelta(seconds=100)).to_pydatetime())
    second = execute_schedule(schedule((110, 114, "downlink")), first.as_run, NO_ECLIPSES, later, 100, 0.0)
    assert second.as_run["status"].tolist() == ["downlinked"]
    assert second.as_run["start"].tolist() == [START], "the carried image keeps the time it was taken"


def test_full_storage_loses_what_a_blind_plan_adds() -> None:
    plan = schedule(*((n, n + 1, "collect") for n in range(5)))
    done = execute_schedule(plan, NOTHING_CARRIED, NO_ECLIPSES, spacecraft(), 100, 0.0)
    assert done.as_run["status"].value_counts().to_dict() == {"collected": 3, "lost": 2}
    assert done.states["CYGFM01"].stored_images_initial == 3


def test_what_was_on_board_before_the_first_cycle_is_sent_first() -> None:
    craft = spacecraft(satellites={"CYGFM01": {"stored_images_initial": 2}})
    plan = schedule((0, 1, "collect"), (10, 18, "downlink"))
    done = execute_schedule(plan, NOTHING_CARRIED, NO_ECLIPSES, craft, 100, 0.0)
    assert done.as_run["status"].tolist() == ["collected"], "eight seconds send the two older images"
    assert done.states["CYGFM01"].stored_images_initial == 1


def test_states_keep_what_execution_does_not_change_and_name_idle_satellites() -> None:
    window = {"start": "2025-09-03T00:00:00Z", "end": "2025-09-03T01:00:00Z"}
    craft = spacecraft(satellites={"CYGFM01": {"unavailable": [window], "uplink_margin_s": 30}})
    states = execute_schedule(schedule(), NOTHING_CARRIED, NO_ECLIPSES, craft, 100, 0.0, ["CYGFM07"]).states
    assert states["CYGFM01"].uplink_margin_s == 30
    assert len(states["CYGFM01"].unavailable) == 1
    assert states["CYGFM07"].battery_initial_wh == pytest.approx(85.0 + 100 * 20.0 / 3600)


def test_losses_are_the_stated_share_and_the_same_each_time() -> None:
    times = [START + pd.Timedelta(seconds=n) for n in range(4000)]
    lost = [is_lost("CYGFM02", time, 0.1) for time in times]
    assert 0.08 < np.mean(lost) < 0.12
    assert lost == [is_lost("CYGFM02", time, 0.1) for time in times]


@pytest.mark.parametrize("initial", [85.0, 30.0])
def test_battery_agrees_with_a_plain_loop(initial: float) -> None:
    craft = spacecraft(battery_initial_wh=initial, battery_capacity_wh=85.02)
    rng = np.random.default_rng(5)
    starts = np.sort(rng.choice(900, 40, replace=False))
    commands = pd.DataFrame({"first": starts, "last": starts + 1, "command": rng.choice(["collect", "downlink"], 40)})
    umbra = pd.DataFrame(
        {
            "satellite": "CYGFM01",
            "start": [START + pd.Timedelta(seconds=199.5)],
            "end": [START + pd.Timedelta(seconds=500.2)],
            "kind": "umbra",
        }
    )
    charge = initial
    for second in range(1000):
        dark = 199 <= second < 501
        power = (0.0 if dark else 40.0) - 20.0
        for row in commands.itertuples():
            if row.first <= second < row.last:
                power -= 15.0 if row.command == "collect" else 25.0
        charge = min(85.02, charge + power / 3600.0)
    assert battery_after(commands, umbra, craft, "CYGFM01", 1000) == pytest.approx(charge, abs=1e-9)
