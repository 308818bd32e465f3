"""The one truth about time: moving anything past the cut-off changes nothing of what a cycle sees."""

from __future__ import annotations

import shutil
from datetime import timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from flows.cases.bundle import Case, read_case
from flows.cases.known_at import detections_known_at, incidents_known_at, weather_known_at
from shared.contracts import tables
from shared.contracts.grids import WEATHER_GRID, write_netcdf
from shared.contracts.schema import read_table, write_table
from shared.errors import DomainError


def test_detections_by_delivery_not_by_overpass(tiny: Case) -> None:
    everything = read_table(tiny.path("detections"), tables.DETECTIONS)
    cutoff = everything.time.iloc[len(everything) // 2].to_pydatetime() + timedelta(minutes=5)  # just after an overpass
    known = detections_known_at(tiny, cutoff)
    assert (known.delivered_at <= pd.Timestamp(cutoff)).all()
    seen_but_late = (everything.time <= pd.Timestamp(cutoff)) & (everything.delivered_at > pd.Timestamp(cutoff))
    assert seen_but_late.any()
    assert len(known) == (everything.delivered_at <= pd.Timestamp(cutoff)).sum()


def test_what_is_delivered_later_changes_nothing(tiny: Case, tmp_path: Path) -> None:
    shutil.copytree(tiny.folder, tmp_path / "case")
    other = read_case(tmp_path / "case")
    table = read_table(other.path("detections"), tables.DETECTIONS)
    later = table.delivered_at > pd.Timestamp(tiny.first_cutoff)
    table.loc[later, "delivered_at"] += pd.Timedelta(days=3)
    write_table(other.path("detections"), table, tables.DETECTIONS)
    pd.testing.assert_frame_equal(
        detections_known_at(tiny, tiny.first_cutoff), detections_known_at(other, tiny.first_cutoff)
    )


def test_incidents_appear_and_grow_as_reported(tiny: Case) -> None:
    first, second = incidents_known_at(tiny, tiny.cutoff(1)), incidents_known_at(tiny, tiny.cutoff(2))
    assert list(first.incident_id) == ["SIM001"]
    assert list(second.incident_id) == ["SIM001", "SIM002"]
    assert second.area_km2[0] > first.area_km2[0] > 0.2


def test_weather_is_analysis_then_forecast(tiny: Case) -> None:
    cutoff = tiny.first_cutoff + timedelta(hours=6)
    weather = WEATHER_GRID.check(weather_known_at(tiny, cutoff))
    limit = np.datetime64(cutoff.replace(tzinfo=None))
    assert (np.diff(weather.time.values) == np.timedelta64(1, "h")).all()
    assert (weather.issued_at.values <= limit).all()
    assert weather.time.values[-1] == limit + np.timedelta64(192, "h")
    ahead = weather.time.values >= limit
    assert set(weather.issued_at.values[ahead]) == {limit}
    analysed = weather.isel(time=~ahead)
    assert (analysed.issued_at.values == analysed.time.values + np.timedelta64(1, "h")).all()


def test_later_analyses_and_forecasts_change_nothing(tiny: Case, tmp_path: Path) -> None:
    shutil.copytree(tiny.folder, tmp_path / "case")
    other = read_case(tmp_path / "case")
    cutoff = tiny.first_cutoff
    limit = np.datetime64(cutoff.replace(tzinfo=None))
    for logical, name in (("weather_analysis", "issued_at"), ("weather_forecast", "issue")):
        with xr.open_dataset(other.path(logical)) as opened:
            changed = opened.load()
        late = changed[name] > limit
        assert late.any()
        changed["temperature_c"] = changed.temperature_c.where(~late, -40.0)
        write_netcdf(other.path(logical), changed)
    xr.testing.assert_identical(weather_known_at(tiny, cutoff), weather_known_at(other, cutoff))


def test_no_forecast_yet_is_an_error(tiny: Case) -> None:
    with pytest.raises(DomainError, match="forecast"):
        weather_known_at(tiny, tiny.first_cutoff - timedelta(hours=1))
