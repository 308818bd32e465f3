"""The paper's days on the real data, on a small cut: what is real, what is marked simulated, what is known when."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import pytest
import shapely
import xarray as xr

from flows.cases.bundle import Case
from flows.cases.known_at import detections_known_at, incidents_known_at, perimeters_known_at, weather_known_at
from flows.cases.moved_elements import moved_elements
from flows.cases.paper_days import incidents
from flows.cases.paper_days.build import Steps, build_paper_day
from flows.cases.paper_days.days import DAYS, day_of
from flows.cases.paper_days.published_rows import KINDS, PUBLISHED_ROWS, rows_of
from flows.commands.cases import list_cases
from flows.demo import REAL
from flows.profiles import PAPER_DAYS, profile_of
from shared.errors import DomainError, MissingArtifactError

COARSE = Steps(weather=1.0, fuels=0.2, soil=0.5, burn=0.02, fire_m=1000.0)
PALISADES, EATON, HUGHES = "2025-CALFD-000738", "2025-CALAC-009087", "2025-CAANF-250270"
SMOKEHOUSE, JULIET = "2024-TXTXS-240317", "2024-TXTXS-240316"


@pytest.fixture(scope="module")
def la(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("la")
    return build_paper_day("la-2025", real_data, folder, region=(-119.5, 33.0, -116.5, 35.0), steps=COARSE)


@pytest.fixture(scope="module")
def texas(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("tx")
    return build_paper_day("smokehouse-2024", real_data, folder, region=(-103.0, 34.0, -99.0, 37.0), steps=COARSE)


def test_the_fires_of_the_day_are_known_and_none_of_later_days(la: Case) -> None:
    known = incidents_known_at(la, la.first_cutoff).set_index("incident_id")
    real = known[~known.simulated]
    assert set(real.index) == {PALISADES, EATON}
    # Discovered 06:30 UTC, so public at 12:30: half an hour late. Hughes began two weeks later.
    assert "2025-CALFD-0003294" in set(incidents_known_at(la, la.cutoff(2)).incident_id)
    assert HUGHES not in set(pd.read_parquet(la.path("incidents")).incident_id)
    # Their first outlines were published on 10 January: no area is known, no perimeter.
    assert real.area_km2.isna().all() and perimeters_known_at(la, la.first_cutoff).empty


def test_a_scrape_three_minutes_late_is_not_known(texas: Case) -> None:
    known = incidents_known_at(texas, texas.first_cutoff).set_index("incident_id")
    assert {SMOKEHOUSE, JULIET} <= set(known.index) and known.area_km2.isna().all()
    assert perimeters_known_at(texas, texas.first_cutoff).empty
    later = perimeters_known_at(texas, datetime(2024, 2, 27, 6, 4, tzinfo=UTC))
    assert list(later.incident_id) == [JULIET]  # scraped 06:03:26


@pytest.mark.parametrize("which", ["la", "texas"])
def test_nothing_enters_that_was_not_known(which: str, request: pytest.FixtureRequest) -> None:
    case: Case = request.getfixturevalue(which)
    cutoff = pd.Timestamp(case.first_cutoff)
    known = incidents_known_at(case, case.first_cutoff)
    assert (known.known_at <= cutoff).all() and (known.start < known.known_at).all()
    assert (detections_known_at(case, case.first_cutoff).delivered_at <= cutoff).all()
    weather = weather_known_at(case, case.first_cutoff)
    assert weather.issued_at.values.max() <= np.datetime64(cutoff.tz_convert(None))
    assert weather.time.values[-1] - np.datetime64(cutoff.tz_convert(None)) >= np.timedelta64(192, "h")


def test_what_is_simulated_is_marked(la: Case, texas: Case) -> None:
    made = {
        "receivers",
        "transmitters",
        "weather_analysis",
        "weather_forecast",
        "fuels",
        "smap",
        "detections",
        "surface",
    }
    for case, incidents_too in ((la, {"incidents"}), (texas, set())):
        marked = {name for name, origin in case.provenance.items() if origin.simulated}
        assert marked == made | incidents_too
    fires = pd.read_parquet(la.path("incidents"))
    assert (fires.simulated == fires.incident_id.str.startswith("SIM")).all()
    assert (fires.simulated == (fires.origin == "simulated")).all()
    assert f"{int(fires.simulated.sum())} simulated" in la.provenance["incidents"].source
    assert la.provenance["receivers"].oldest < datetime(2024, 6, 18, tzinfo=UTC)


def test_the_same_day_gives_the_same_bytes(la: Case, real_data: Path, tmp_path: Path) -> None:
    again = build_paper_day("la-2025", real_data, tmp_path, region=la.region, steps=COARSE)
    for path in sorted(la.folder.iterdir()):
        assert path.read_bytes() == (again.folder / path.name).read_bytes(), path.name


def test_pre_fire_places_are_those_of_the_published_grid(la: Case, real_data: Path) -> None:
    places = pd.read_csv(real_data / "grids/conus_prefire_points.csv")
    west, south, east, north = la.region
    inside = places[places.lon_deg.between(west, east) & places.lat_deg.between(south, north)]
    with xr.open_dataset(la.path("fuels")) as fuels:
        code = fuels.mask_code.load()
    for place in inside.itertuples():
        assert int(code.sel(latitude=place.lat_deg, longitude=place.lon_deg, method="nearest")) == 0
    assert 0 < int((code == 0).sum()) <= len(inside)
    assert (code.sel(latitude=slice(32.9, 33.3), longitude=slice(-119.6, -118.6)) == 254).all()  # the Pacific


def test_reports_after_the_cutoff_change_no_known_fire(real_data: Path) -> None:
    """Every row scraped later, moved and grown at will: what is known of the fires at the cut-off stays."""
    day = DAYS["conus-2023-07-05"]
    table = geopandas.read_parquet(real_data / day.perimeters)
    moment = pd.Timestamp(day.cutoff)
    given = table[table.initial_lat_deg.notna()]
    before = incidents.wfigs_fires(given, day.cutoff, day.cutoff)
    late = given.scraped > moment
    changed = given.assign(
        acres=given.acres.where(~late, 1e6),
        percent_contained=given.percent_contained.where(~late, 100.0),
        geometry=given.geometry.where(~late, shapely.box(-90, 40, -89, 41)),
    )
    after = incidents.wfigs_fires(changed, day.cutoff, day.cutoff)
    pd.testing.assert_frame_equal(before, after)
    assert len(before) > 30
    known = incidents.reported_areas(changed, before)
    assert (known[known.known_at <= moment].area_km2 < 500).all()


def test_contained_fires_are_left_out_once_it_is_known() -> None:
    row = {
        "unique_fire_id": "X", "incident": "x", "discovered": pd.Timestamp("2023-07-01T00:00Z"), "acres": 5.0,
        "initial_lat_deg": 35.0, "initial_lon_deg": -110.0, "scraped": pd.Timestamp("2023-07-03T06:00Z"),
        "percent_contained": 100.0,
    }  # fmt: skip
    table = geopandas.GeoDataFrame([row], geometry=[shapely.Point(-110, 35)], crs=4326)
    for hour, count in ((5, 1), (7, 0)):
        assert (
            len(incidents.wfigs_fires(table, datetime(2023, 7, 3, hour, tzinfo=UTC), day_of("la-2025").cutoff)) == count
        )


def test_ics209_gives_no_final_area_and_no_fire_twice(real_data: Path) -> None:
    day = DAYS["smokehouse-2024"]
    path = real_data / "fires/incidents_ics209_2015_2024.parquet"
    none = pd.DataFrame(columns=incidents.COLUMNS)
    fires = incidents.ics209_fires(path, none, day.cutoff, (-125.0, 24.5, -66.5, 49.5))
    assert len(fires) > 10 and fires.area_km2.isna().all() and (fires.known_at <= pd.Timestamp(day.cutoff)).all()
    assert incidents.ics209_fires(path, fires, day.cutoff, (-125.0, 24.5, -66.5, 49.5)).empty


def test_simulated_fires_stand_where_fires_of_earlier_years_did(real_data: Path) -> None:
    path = real_data / "fires/incidents_ics209_2015_2024.parquet"
    box = (-125.0, 24.5, -66.5, 49.5)
    made = incidents.simulated_fires(path, 20, datetime(2019, 7, 5, tzinfo=UTC), box, 1)
    table = pd.read_parquet(path)
    past = table[pd.to_datetime(table.ignition_date) < "2019-01-01"]
    places = set(zip(past.lon_deg, past.lat_deg, strict=True))
    assert len(made) == 20 and made.simulated.all()
    assert all(place in places for place in zip(made.longitude_deg, made.latitude_deg, strict=True))


def test_planes_are_carried_to_the_day(real_data: Path) -> None:
    """Moved back by the same rates an element set is what it was; over 18 months the node is 25 degrees off at most."""
    old = real_data / "orbits/tle_20221204/cygnss.tle"
    moved, oldest = moved_elements(old, datetime(2024, 6, 17, 15, tzinfo=UTC), ("CYGFM06",))
    assert len(moved) == 7 and oldest.year == 2022
    lines = [line for line in (real_data / "orbits/tle_20240617/cygnss.tle").read_text().splitlines() if line]
    truth = {name.strip(): float(second[17:25]) for name, second in zip(lines[0::3], lines[2::3], strict=True)}
    for message in moved:
        off = (float(message["RA_OF_ASC_NODE"]) - truth[message["OBJECT_NAME"]] + 180) % 360 - 180
        assert abs(off) < 25 and float(message["INCLINATION"]) == pytest.approx(34.95, abs=0.05)


def test_the_nine_rows_are_the_papers(la: Case) -> None:
    assert len(PUBLISHED_ROWS) == 9
    assert [row.prefire_available for row in PUBLISHED_ROWS] == [
        19034,
        19034,
        None,
        22119,
        22119,
        None,
        23216,
        23216,
        None,
    ]
    for day in DAYS.values():
        assert [row["kind"] for row in rows_of(day.published)] == list(KINDS)
    assert json.loads(la.path("published_rows").read_text()) == rows_of(DAYS["la-2025"].published)


def test_the_days_are_cases_like_any_other(real_data: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert set(PAPER_DAYS) == set(DAYS) <= set(REAL)
    assert all(profile_of(name).settings.target_radius_km == 10 for name in PAPER_DAYS)
    list_cases()
    listed = capsys.readouterr().out
    assert all(name in listed for name in PAPER_DAYS)
    with pytest.raises(DomainError, match="no day of the paper"):
        day_of("la-2024")
    with pytest.raises(MissingArtifactError, match="incidents_ics209"):
        build_paper_day("la-2025", tmp_path, tmp_path / "case")
