"""The Black Fire case on the real data: what is real, what is derived, and that no perimeter is known too early."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from flows.cases.bundle import Case
from flows.cases.hms import closest_pass, read_elements
from flows.cases.known_at import detections_known_at, incidents_known_at, perimeters_known_at, weather_known_at
from flows.cases.scoring import perimeter_scores, read_arrival
from shared.contracts import tables
from shared.contracts.schema import read_table
from shared.errors import MissingArtifactError

DATA = os.environ.get("SMOKEGLINT_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="SMOKEGLINT_DATA is not set: no real data to test on")
BLACK = "2022-NMGNF-000185"


@pytest.fixture(scope="module")
def black(tmp_path_factory: pytest.TempPathFactory) -> Case:
    from flows.cases.black_2022 import build_black_2022

    return build_black_2022(Path(str(DATA)), tmp_path_factory.mktemp("black"))


@needs_data
def test_seven_perimeters_are_trusted(black: Case) -> None:
    perimeters = read_table(black.path("perimeters"), tables.PERIMETERS)
    age = perimeters.known_at - perimeters.time
    assert len(perimeters) == 7  # as the data's README counts them
    assert perimeters.time.is_unique
    assert (age < pd.Timedelta(hours=36)).all() and (age >= pd.Timedelta(0)).all()
    areas = perimeters.to_crs(32613).area / 1e6
    assert areas.to_numpy() == pytest.approx(perimeters.acres.to_numpy() * 0.00404686, rel=0.02)
    assert (np.diff(areas) > 0).all()


@needs_data
def test_perimeters_and_incident_obey_the_cutoff(black: Case) -> None:
    cutoff = pd.Timestamp("2022-05-17T00:00Z")
    known = perimeters_known_at(black, cutoff)
    assert list(known.time) == [pd.Timestamp("2022-05-16T03:04:00Z")]
    assert perimeters_known_at(black, pd.Timestamp("2022-05-16T12:00Z")).empty  # dated before, published after
    incident = incidents_known_at(black, cutoff).iloc[0]
    assert incident.incident_id == BLACK
    assert incident.area_km2 == pytest.approx(75.9, abs=0.1)
    assert incidents_known_at(black, pd.Timestamp("2022-05-14T04:00Z")).empty


@needs_data
def test_detections_are_hms_and_derived_looks_are_marked(black: Case) -> None:
    detections = read_table(black.path("detections"), tables.DETECTIONS)
    assert set(detections.instrument) == {"VIIRS", "MODIS"}
    assert set(detections.satellite) <= {"SUOMI NPP", "NOAA 20", "TERRA"}
    assert detections.confidence.isna().all()
    assert (detections.delivered_at - detections.time <= pd.Timedelta(hours=6)).all()
    assert detections.derived.dtype == bool and (detections.derived == ~detections.fire).all()
    assert detections.along_m[detections.instrument == "VIIRS"].eq(375).all()
    assert detections.along_m[detections.instrument == "MODIS"].eq(1000).all()
    assert (detections_known_at(black, black.first_cutoff).time < pd.Timestamp(black.first_cutoff)).all()


@needs_data
def test_no_fire_looks_keep_off_whatever_burned_before(black: Case) -> None:
    detections = read_table(black.path("detections"), tables.DETECTIONS).to_crs(32613)
    looks, fires = detections[~detections.fire], detections[detections.fire]
    assert len(looks) > 1000
    for moment in looks.time.unique()[::7]:
        before = fires[fires.time <= moment]
        sample = looks[looks.time == moment].iloc[::20]
        gap = sample.geometry.apply(lambda point, before=before: before.distance(point).min())
        assert gap.min() > 2400
        same = fires[(fires.time == moment)]
        assert sample.geometry.apply(lambda point, same=same: same.distance(point).min()).max() < 15_500


@needs_data
def test_tracks_from_the_elements_agree_with_the_minutes_of_hms(black: Case) -> None:
    """HMS times are the start of a granule: the pass must follow within minutes, and within the swath."""
    satellites = read_elements(Path(str(DATA)) / "orbits/tle_20220505/viirs_modis.tle")
    detections = read_table(black.path("detections"), tables.DETECTIONS)
    snapshots = detections[~detections.fire].drop_duplicates(["time", "satellite"])
    assert len(snapshots) > 50
    for row in snapshots.itertuples():
        offset, distance = closest_pass(satellites[row.satellite], row.time, (-108.06, 33.2))
        assert pd.Timedelta(0) <= offset <= pd.Timedelta(minutes=8)
        assert distance <= {"VIIRS": 1530, "MODIS": 1165}[row.instrument]


@needs_data
def test_simulated_parts_are_marked_and_real_ones_are_not(black: Case) -> None:
    simulated = {name for name, origin in black.provenance.items() if origin.simulated}
    assert simulated == {"weather_analysis", "weather_forecast", "fuels", "smap", "surface", "truth"}
    assert "not independent" in black.provenance["truth"].source
    source = Path(str(DATA)) / "orbits/tle_20220505"
    assert black.path("receivers").read_bytes() == (source / "cygnss.tle").read_bytes()
    assert black.path("transmitters").read_bytes() == (source / "gps.tle").read_bytes()


@needs_data
def test_the_burn_of_the_simulator_keeps_every_perimeter(black: Case) -> None:
    truth = read_arrival(black.path("truth"), f"fire_arrival_time_{BLACK}")
    for row in read_table(black.path("perimeters"), tables.PERIMETERS).itertuples():
        scores = perimeter_scores(truth, row.geometry, row.time, row.known_at)
        assert scores["sorensen_at_polygon_time"] > 0.99
        assert scores["outline_missed"] == 0


@needs_data
def test_ndvi_is_real_and_weather_goes_on(black: Case) -> None:
    with xr.open_dataset(black.path("fuels")) as fuels:
        near = fuels.sel(latitude=33.25, longitude=-108.0, method="nearest")
        assert 0.3 < float(near.ndvi_min) <= float(near.ndvi) <= float(near.ndvi_max) < 0.6
    weather = weather_known_at(black, black.cutoff(2))
    assert weather.time.values[-1] == np.datetime64("2022-05-25T00:00")


def test_a_folder_without_the_data_is_named(tmp_path: Path) -> None:
    from flows.cases.black_2022 import build_black_2022

    with pytest.raises(MissingArtifactError, match="perimeters_wfigs_black_2022"):
        build_black_2022(tmp_path, tmp_path / "case")
