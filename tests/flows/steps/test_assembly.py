"""The cut-off: what lies past it can be moved or changed at will, and what a cycle knows stays the same to the byte."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import geopandas
import pandas as pd
import pytest
from shapely.geometry import box

from flows.cases.bundle import Case
from flows.cases.simulated import build_simulated_case
from flows.steps import ASSEMBLE_INPUTS
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.process import execution

NAMES = ("incidents", "incident_reports", "detections", "weather_analysis", "weather_forecast")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return build_simulated_case("tiny", tmp_path_factory.mktemp("case") / "tiny")


def assembled(case: Case, root: Path, changed: Path | None = None) -> dict[str, str]:
    """Hashes of what is known at the second cycle's cut-off, with another detections table if one is given."""
    store = ArtifactStore(Roots(str(root), (str(case.folder), str(root.parent))))
    given: dict[str, Any] = {name: {"href": str(case.path(name))} for name in NAMES}
    if changed is not None:
        given["detections"] = {"href": str(changed)}
    inputs = execution.validate_inputs(ASSEMBLE_INPUTS, {"cutoff": case.cutoff(2).isoformat(), **given})
    step = execution.resolve_step(ASSEMBLE_INPUTS, inputs, store, "test")
    outputs = execution.run_step(step, store, "test", "job", lambda *_: None)
    files = [outputs[name]["href"].removeprefix("file://") for name in ("incidents", "detections", "weather")]
    return {Path(name).name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in files}


def moved(frame: pd.DataFrame, late: pd.Series[bool]) -> pd.DataFrame:
    """Late rows a day later and turned into fires elsewhere."""
    changed = frame.copy()
    changed.loc[late, "time"] += timedelta(days=1)
    changed.loc[late, "delivered_at"] += timedelta(days=1)
    changed.loc[late, "fire"] = True
    changed.loc[late, "geometry"] = changed.loc[late].geometry.translate(xoff=0.3)
    return changed


def dropped(frame: pd.DataFrame, late: pd.Series[bool]) -> pd.DataFrame:
    return frame[~late]


@pytest.mark.parametrize("change", [moved, dropped])
def test_what_comes_after_the_cut_off_changes_nothing(
    case: Case, tmp_path: Path, change: Callable[..., pd.DataFrame]
) -> None:
    frame = read_table(case.path("detections"), tables.DETECTIONS)
    late = frame["delivered_at"] > pd.Timestamp(case.cutoff(2))
    assert late.any()
    assert not late.all()
    other = tmp_path / "detections.parquet"
    write_table(other, change(frame, late), tables.DETECTIONS)
    assert assembled(case, tmp_path / "a") == assembled(case, tmp_path / "b", other)


def test_one_known_observation_moved_past_the_cut_off_is_gone(case: Case, tmp_path: Path) -> None:
    """The control: the hash does tell a change of what is known."""
    frame = read_table(case.path("detections"), tables.DETECTIONS)
    first = frame["delivered_at"].idxmin()
    frame.loc[first, "delivered_at"] = pd.Timestamp(case.cutoff(2)) + timedelta(seconds=1)
    other = tmp_path / "detections.parquet"
    write_table(other, frame, tables.DETECTIONS)
    before, after = assembled(case, tmp_path / "a"), assembled(case, tmp_path / "b", other)
    assert before["detections.parquet"] != after["detections.parquet"]
    assert before["incidents.parquet"] == after["incidents.parquet"]


def test_weather_is_forecast_from_the_cut_off_on(case: Case, tmp_path: Path) -> None:
    from shared.contracts.grids import WEATHER_GRID, read_netcdf

    assembled(case, tmp_path / "a")
    weather = read_netcdf(next((tmp_path / "a").rglob("weather.nc")), WEATHER_GRID)
    issued = pd.DatetimeIndex(weather["issued_at"].values)
    assert issued.max() <= pd.Timestamp(case.cutoff(2)).tz_localize(None)
    assert pd.DatetimeIndex(weather["time"].values).max() > issued.max() + timedelta(days=1)


def test_perimeters_are_known_once_published(case: Case, tmp_path: Path) -> None:
    """Of a case that has any: those published by the cut-off, and none at all before the first one is."""
    cutoff = pd.Timestamp(case.cutoff(2))
    times = [cutoff - timedelta(hours=9), cutoff - timedelta(hours=5)]
    published = [cutoff - timedelta(hours=2), cutoff + timedelta(seconds=1)]
    frame = geopandas.GeoDataFrame(
        {"incident_id": ["a", "a"], "time": times, "known_at": published},
        geometry=[box(-106, 33, -105, 34), box(-106, 33, -104, 34)],
        crs="EPSG:4326",
    )
    other = tmp_path / "perimeters.parquet"
    write_table(other, frame, tables.PERIMETERS)
    store = ArtifactStore(Roots(str(tmp_path / "a"), (str(case.folder), str(tmp_path))))
    given = {name: {"href": str(case.path(name))} for name in NAMES} | {"perimeters": {"href": str(other)}}
    found = []
    for time in (cutoff, cutoff - timedelta(hours=3)):
        inputs = execution.validate_inputs(ASSEMBLE_INPUTS, {"cutoff": time.isoformat(), **given})
        step = execution.resolve_step(ASSEMBLE_INPUTS, inputs, store, "test")
        found.append(execution.run_step(step, store, "test", "job", lambda *_: None)["perimeters"])
    known = read_table(Path(found[0]["href"].removeprefix("file://")), tables.PERIMETERS)
    assert known["time"].tolist() == times[:1]
    assert found[1] is None
