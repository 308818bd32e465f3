"""Odd files: none may end in a traceback, lose a row in silence, or be refused for nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pytest
import shapely

from services.access.coverage.grid import cells_at, even_grid
from services.access.fleets import read_fleet
from services.access.horizon import Horizon
from services.access.orbits.elements import ElementSet
from services.access.orbits.ephemeris import propagate
from services.access.orbits.formats import read_files, read_orbits
from services.access.orbits.preparation import name_transmitters, prepare
from services.access.processes import PROCESSES
from services.access.specular.antenna import antenna_system
from services.access.specular.roll import read_rolls
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.errors import DomainError
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.access.orbit_files import OMM, oem_kvn, sp3
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS
from tests.services.access.staging import stage


def _sets(text: str) -> list[ElementSet]:
    return [orbit for orbit in read_orbits(text) if isinstance(orbit, ElementSet)]


def _two_days() -> str:
    """Three GPS satellites as SP3 over two days from the start, every 15 minutes; GPS time is 18 s ahead."""
    named, _ = name_transmitters(_sets(TRANSMITTERS)[:3], START)
    sets = [each for each in named if isinstance(each, ElementSet)]
    orbits, _ = propagate(sets, START, 2 * 86400.0, 900.0)
    positions = {orbit.name: orbit.position_m / 1000.0 for orbit in orbits}
    return sp3(START + timedelta(seconds=18), orbits[0].times_s, positions)


def _part(first: int, last: int) -> str:
    """Those epochs of the two days."""
    lines = _two_days().splitlines()
    epochs = [row for row, line in enumerate(lines) if line.startswith("*")]
    return "\n".join(lines[: epochs[0]] + lines[epochs[first] : epochs[last]])


def test_daily_sp3_files_make_one_orbit_over_midnight() -> None:
    """A day from 06:00 needs two files of a day each; the join is as exact as the same states in one file."""
    noon = START + timedelta(hours=6)
    days = read_files([("b.sp3", _part(96, 192)), ("a.sp3", _part(0, 96))])
    whole = read_orbits(_part(0, 192))
    joined, single = (prepare(orbits, noon, 86400.0, 60.0, 30.0, "transmitters") for orbits in (days, whole))
    assert [orbit.name for orbit in joined.used] == [orbit.name for orbit in single.used] and len(joined.used) == 3
    for ours, theirs in zip(joined.ephemerides, single.ephemerides, strict=True):
        assert np.abs(ours.position_m - theirs.position_m).max() < 1e-4
    assert joined.used[0].where == "lines 25 to 405 of a.sp3 and lines 25 to 405 of b.sp3"


def test_the_epoch_that_daily_sp3_files_share_counts_once() -> None:
    files = [("a.sp3", _part(0, 96)), ("b.sp3", _part(95, 192))]
    orbit = read_files(files)[0]
    assert len(orbit.segments) == 1 and len(orbit.segments[0].times_s) == 192


def test_sp3_files_that_overlap_or_leave_a_gap_are_named() -> None:
    overlapping = read_files([("a.sp3", _part(0, 96)), ("b.sp3", _part(48, 144))])
    with pytest.raises(DomainError, match=r"G13 is given twice, in lines .* of a.sp3 and lines .* of b.sp3"):
        name_transmitters(overlapping, START)
    apart = read_files([("a.sp3", _part(0, 96)), ("b.sp3", _part(104, 192))])
    with pytest.raises(
        DomainError, match=r"a gap from .*T23:45:00Z \(lines .* of a.sp3\) to .*T02:00:00Z \(lines .* of b"
    ):
        prepare(apart, START + timedelta(hours=12), 86400.0, 60.0, 30.0, "transmitters")


def test_catalogue_numbers_of_nine_digits_are_what_omm_is_for() -> None:
    rows = [{**OMM, "NORAD_CAT_ID": "799501234"}, {**OMM, "OBJECT_NAME": "B"}]
    long, short = _sets(json.dumps(rows))
    assert (long.catalogue_number, short.catalogue_number) == (799501234, 41884)
    states = [propagate([orbit], START, 600.0, 10.0)[0][0].position_m for orbit in (long, short)]
    assert np.array_equal(*states)


def test_transmitters_without_a_code_are_all_told_even_under_one_name() -> None:
    rows = [{**OMM, "OBJECT_NAME": "TBA", "NORAD_CAT_ID": str(number)} for number in (99991, 99992)]
    _, dropped = name_transmitters([*_sets(TRANSMITTERS), *_sets(json.dumps(rows))], START)
    assert list(dropped) == ["TBA", "TBA (row 1)"]


def _oem(**changes: str) -> str:
    (orbit,), _ = propagate(_sets(RECEIVERS)[:1], START, 600.0, 60.0)
    text = oem_kvn(
        "CYGFM05", START, orbit.times_s, orbit.position_m / 1e3, orbit.velocity_m_s / 1e3, REF_FRAME="ITRF2014"
    )
    for old, new in changes.values():
        text = text.replace(old, new)
    return text


def _sp3_line(number: int, text: str) -> str:
    lines = _part(0, 24).splitlines()
    lines[number - 1] = text
    return "\n".join(lines)


TEXTS = {
    "word for an epoch": (_oem(a=("2022-12-04T00:05:00.000000", "NaT")), "line 19: 'NaT' is not an epoch"),
    "the reader's clock": (_oem(a=("2022-12-04T00:05:00.000000", "now")), "line 19: 'now' is not an epoch"),
    "creation date": (_oem(a=("2022-12-03T12:00:00", "NaT")), "line 2: 'NaT' is not an epoch"),
    "year 9999": (_oem(a=("2022-", "9999-")), "line 2: '9999-12-03T12:00:00' is not an epoch"),
    "sp3 code": (_sp3_line(25, "P  ? 1.0"), "line 25: '  \\?' is not a satellite's code"),
    "sp3 bare record": (_sp3_line(25, "P"), "line 25: '' is not a satellite's code"),
    "sp3 seconds": (_sp3_line(24, "*  2022 12  4  0  0  1e300"), "line 24: not an epoch"),
    "sp3 year": (_sp3_line(24, "*  1 12  4  0  0  0.0"), "line 24: not an epoch"),
    "omm depth": ("[" * 100_000, "nested too deeply"),
    "omm number": (json.dumps([{**OMM, "NORAD_CAT_ID": "-5"}]), "row 0: catalogue number -5"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_odd_orbit_files_are_refused_with_their_line(case: str) -> None:
    text, words = TEXTS[case]
    with pytest.raises(DomainError, match=words):
        read_orbits(text)


@pytest.mark.parametrize(
    "start",
    [datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=14))), datetime(9999, 12, 31, 23, tzinfo=UTC)],
)
def test_a_start_without_satellites_is_refused(start: datetime) -> None:
    with pytest.raises(DomainError, match="is no time of satellites"):
        Horizon(start)


@pytest.mark.parametrize("satellite", [None, 41884, ["CYGFM05"]])
def test_a_roll_without_a_satellite_is_not_lost(satellite: object) -> None:
    table = pd.DataFrame(
        {"satellite": ["CYGFM05", satellite], "time": [pd.Timestamp(START)] * 2, "roll_deg": [0.0, 9.0]}
    )
    with pytest.raises(DomainError, match=r"row 1: .* is no satellite's name"):
        read_rolls(table, {"CYGFM05"}, START)


def test_an_antenna_of_endless_channels_is_refused() -> None:
    with pytest.raises(DomainError, match="does not describe an antenna system"):
        antenna_system({"name": "x", "channels": float("inf"), "floor_dbi": 0.0, "antennas": []})


@pytest.mark.parametrize("edge", [float("nan"), float("inf")])
def test_a_grid_without_numbers_is_no_box(edge: float) -> None:
    with pytest.raises(DomainError, match="is not a box"):
        even_grid(1.0, (0.0, edge, 5.0, 5.0))


def test_cells_by_centres_turn_their_longitudes_and_name_their_row() -> None:
    assert cells_at([0.0, 1.0, 2.0], [359.0, 180.0, -180.0]).longitude_deg.tolist() == [-1.0, 180.0, -180.0]
    for latitude, longitude, words in (
        ([0.0, np.nan], [0.0, 0.0], "grid_cells: row 1"),
        ([0.0], [500.0], "longitude 500"),
        ([], [], "the table has 0 rows"),
    ):
        with pytest.raises(DomainError, match=words) as caught:
            cells_at(latitude, longitude)
        assert caught.value.field == "grid_cells"


def test_a_fleet_does_not_take_another_satellite_of_the_same_name() -> None:
    rows = [{"satellite": "CYGFM05", "catalogue_number": 99999}, {"satellite": "CYGFM04", "catalogue_number": 41885}]
    orbits = _sets(RECEIVERS)
    picked, missing = read_fleet({"satellites": rows}).pick(orbits)
    assert [orbit.name for orbit in picked] == ["CYGFM04"] and list(missing) == ["CYGFM05"]
    by_name_only = read_orbits(_oem())
    assert len(read_fleet({"satellites": rows}).pick([replace(by_name_only[0], catalogue_number=None)])[0]) == 1


def _run(root: Path, edit: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    store = ArtifactStore(Roots(str(root)))
    inputs = {**stage(root), "duration_s": 600, "step_s": 10, "with_specular_points": False, **edit(root / "in")}
    step = resolve_step(PROCESSES[0], validate_inputs(PROCESSES[0], inputs), store, "test")
    return run_step(step, store, "test", "job", lambda percent, message: None)


def test_targets_that_are_no_points_are_named(tmp_path: Path) -> None:
    def edit(folder: Path) -> dict[str, Any]:
        columns = {"target_id": [1, 2], "kind": ["prefire"] * 2, "priority": [0.1] * 2}
        shapes = [shapely.Point(0, 0), shapely.Point(0, 0).buffer(1.0)]
        geopandas.GeoDataFrame(columns, geometry=shapes, crs="EPSG:4326").to_parquet(folder / "targets.parquet")
        return {}

    with pytest.raises(DomainError, match="targets: row 1 is a Polygon, not a point"):
        _run(tmp_path, edit)


def _cells(latitude: Any) -> Callable[[Path], dict[str, Any]]:
    def edit(folder: Path) -> dict[str, Any]:
        pd.DataFrame({"latitude_deg": latitude, "longitude_deg": [0.0, 1.0]}).to_parquet(folder / "cells.parquet")
        return {"targets": None, "grid_cells": {"href": "in/cells.parquet"}}

    return edit


def test_cells_of_nullable_columns_are_read(tmp_path: Path) -> None:
    assert _run(tmp_path, _cells(pd.array([1.0, 2.0], dtype="Float64")))["cells"] is not None


@pytest.mark.parametrize(
    "latitude", [pd.array([1.0, None], dtype="Float64"), pd.Categorical(["a", "b"]), [True, False], ["a", "b"]]
)
def test_cells_without_numbers_are_named(tmp_path: Path, latitude: Any) -> None:
    with pytest.raises(DomainError, match="grid_cells: ") as caught:
        _run(tmp_path, _cells(latitude))
    assert caught.value.field == "grid_cells"
