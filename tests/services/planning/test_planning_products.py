"""What a plan gives out: command files, tables, maps, baselines and a report that agree with the schedule."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import geopandas
import numpy as np
import pandas as pd
import pytest

from services.planning.baselines.manual import manual_plan
from services.planning.downlinks import Timeline
from services.planning.operations import judge, make_plan
from services.planning.options.rules import OperationRules
from services.planning.products import outcomes
from services.planning.products.schedule import schedule_table
from services.planning.request import Request, build
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from tests.services.planning.planning_cases import START, Case, at, random_case
from tests.services.planning.test_planning_process import local, run, stage

CASE = random_case(11, 3, 24, tight=False)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A plan against a previous one, with two options and specular points, and all its files."""
    root = tmp_path_factory.mktemp("planned")
    inputs = stage(root, CASE)
    first = run(root, 0, inputs)
    points = geopandas.GeoDataFrame(
        {
            "satellite": [s for _, s, _, _ in CASE.images], "transmitter": "G07",
            "time": [at(t) for _, _, t, _ in CASE.images], "incidence_deg": 30.0, "rx_gain_dbi": 10.0,
            "rx_range_m": 7e5, "tx_range_m": 2e7,
        },
        geometry=geopandas.points_from_xy([-118 + 0.1 * t for _, _, t, _ in CASE.images], 34.0), crs="EPSG:4326",
    )  # fmt: skip
    write_table(root / "in/points.parquet", points, tables.SPECULAR_POINTS)
    body = {
        **inputs, "previous_schedule": first["schedule"], "frozen_until": at(4).isoformat(), "acquisition_s": 1,
        "specular_points": {"href": "in/points.parquet"},
        "target_changes": [
            {"target_id": 2, "action": "exclude", "who": "incident command", "why": "contained",
             "when": START.isoformat()}
        ],
    }  # fmt: skip
    return {"root": root, "body": body, **run(root, 0, body)}


def test_command_files_say_what_the_schedule_says(planned: dict[str, Any]) -> None:
    schedule = read_table(local(planned, "schedule"), tables.SCHEDULE)
    seconds: dict[str, set[tuple[str, int]]] = {}
    for reference in planned["commands"]:
        text = Path(reference["href"].removeprefix("file://")).read_text()
        assert text.startswith("# commands of CYGFM0")
        rows = list(csv.DictReader(io.StringIO("".join(x for x in text.splitlines(True) if not x.startswith("#")))))
        name = text.split()[3].rstrip(",")
        assert [int(row["number"]) for row in rows] == list(range(1, len(rows) + 1))
        assert [row["start_utc"] for row in rows] == sorted(row["start_utc"] for row in rows)
        own = seconds.setdefault(name, set())
        for row in rows:
            begin = round((pd.Timestamp(row["start_utc"]) - at(0)).total_seconds())
            own.update((row["command"], begin + k) for k in range(int(row["duration_s"])))
            assert (row["source"] == "previous") == (begin < 4)
    for name, own in seconds.items():
        mine = schedule[schedule["satellite"] == name]
        begins = ((mine["start"] - at(0)).dt.total_seconds(), (mine["end"] - at(0)).dt.total_seconds())
        expected = {(c, t) for c, a, b in zip(mine["command"], *begins, strict=True) for t in range(int(a), int(b))}
        assert own == expected


def test_tables_of_images_and_targets_add_up_to_the_report(planned: dict[str, Any]) -> None:
    report = json.loads(local(planned, "report").read_text())
    images = read_table(local(planned, "images"), outcomes.IMAGES)
    assert images["reward"].sum() == pytest.approx(report["reward"])
    assert len(images) == report["images_planned"]
    down = images.dropna(subset=["downlinked_at"])
    hours = (down["downlinked_at"] - down["start"]).dt.total_seconds() / 3600
    assert np.allclose(hours, down["latency_h"]) and (hours > 0).all()
    assert report["latency"]["images_downlinked"] == len(down) and report["latency"]["within_limit"] is True
    targets = read_table(local(planned, "target_outcomes"), outcomes.TARGETS)
    assert targets["observed"].sum() == planned["targets_planned"]
    assert (targets["reason"] == "").equals(targets["observed"])
    assert targets.loc[targets["observed"], "reward"].sum() == pytest.approx(report["reward"])
    assert 2 not in set(targets["target_id"])
    assert report["options"]["target_changes"][0]["who"] == "incident command"
    manifest = json.loads((local(planned, "report").parent / "manifest.json").read_text())
    assert manifest["parameters"]["target_changes"][0]["why"] == "contained"


def test_profiles_follow_the_replay(planned: dict[str, Any]) -> None:
    from services.planning.products.profiles import PROFILES

    profiles = read_table(local(planned, "profiles"), PROFILES)
    schedule = read_table(local(planned, "schedule"), tables.SCHEDULE)
    previous = read_table(local({"s": planned["body"]["previous_schedule"]}, "s"), tables.SCHEDULE)
    verdict = judge(schedule, CASE.tables, CASE.spacecraft, previous=previous,
                    rules=OperationRules(frozen_until=at(4), acquisition_s=1))  # fmt: skip
    last = profiles.groupby("satellite").last()
    for name, charge in verdict.battery_at_end_wh.items():
        assert last.loc[name, "battery_wh"] == pytest.approx(charge)
        assert last.loc[name, "stored_images"] == verdict.stored_at_end[name]
    assert local(planned, "profiles_chart").read_bytes().startswith(b"\x89PNG")


def test_maps_hold_targets_and_tracks(planned: dict[str, Any]) -> None:
    features = json.loads(local(planned, "footprints").read_text())["features"]
    tracks = [feature for feature in features if feature["properties"]["kind"] == "track"]
    assert len(features) - len(tracks) == planned["targets_planned"]
    assert sum(max(1, np.ndim(t["geometry"]["coordinates"]) and len(np.atleast_2d(t["geometry"]["coordinates"])))
               for t in tracks) == len(read_table(local(planned, "images"), outcomes.IMAGES))  # fmt: skip
    tree = ElementTree.fromstring(local(planned, "footprints_kml").read_text())
    names = [element.text for element in tree.iter("{http://www.opengis.net/kml/2.2}name")]
    assert {"CYGFM01", "CYGFM02", "CYGFM03"} <= set(names)
    places = list(tree.iter("{http://www.opengis.net/kml/2.2}Point"))
    assert len(places) >= planned["targets_planned"]


def test_changes_are_a_file_only_where_there_was_a_plan(planned: dict[str, Any], tmp_path: Path) -> None:
    text = local(planned, "changes").read_text()
    rows = list(csv.DictReader(io.StringIO("".join(x for x in text.splitlines(True) if not x.startswith("#")))))
    assert {row["change"] for row in rows} <= {"kept", "dropped", "added"} and rows
    assert run(tmp_path, 0, stage(tmp_path, CASE))["changes"] is None


def test_the_same_request_gives_the_same_bytes_in_one_process(planned: dict[str, Any], tmp_path: Path) -> None:
    again = run(tmp_path, 0, stage(tmp_path, CASE))
    first = run(planned["root"] / "again", 0, stage(planned["root"] / "again", CASE))
    for name in ("footprints_kml", "profiles", "profiles_chart", "images", "target_outcomes"):
        assert local(again, name).read_bytes() == local(first, name).read_bytes(), name
    for mine, theirs in zip(again["commands"], first["commands"], strict=True):
        assert mine["sha256"] == theirs["sha256"]


def test_check_plan_takes_the_same_options(planned: dict[str, Any]) -> None:
    body = {name: value for name, value in planned["body"].items() if name != "specular_points"}
    assert run(planned["root"], 1, {**body, "schedule": planned["schedule"]})["valid"]
    refused = run(planned["root"], 1, {**body, "schedule": planned["schedule"], "acquisition_s": 5})
    assert any(text.startswith("acquisition") or text.startswith("contact") for text in refused["violations"])


@pytest.mark.parametrize("seed", range(30, 42))
def test_manual_practice_keeps_the_rules_and_stays_below_the_bound(seed: int) -> None:
    case = random_case(seed, 2, 16, tight=bool(seed % 2))
    problem = build(Request(case.tables, case.spacecraft))
    manual = manual_plan(problem)
    table = schedule_table(problem, Timeline(manual.images, manual.downlink, np.zeros(0, np.int64)))
    assert judge(table, case.tables, case.spacecraft).valid
    made = make_plan(case.tables, case.spacecraft)
    baseline = made.report["manual_baseline"]["objective"]
    assert baseline == pytest.approx(problem.objective(manual.images))
    assert baseline <= made.plan.bound + 1e-9


def test_manual_practice_takes_the_best_unbroken_track() -> None:
    shots = [(i, "CYGFM01", float(t), [i]) for i, t in enumerate((0, 1, 4, 5, 6))]
    rewards = {i: ("prefire", r) for i, r in enumerate((3.0, 0.1, 1.0, 2.0, 1.5))}
    case = Case(shots, rewards, [("CYGFM01", "hawaii", 8, 13)], craft={"battery_initial_wh": 10.0})
    problem = build(Request(case.tables, case.spacecraft))
    assert sorted(manual_plan(problem).images.tolist()) == [3, 4]
