"""What a request with poor or odd input gets: a clear answer, or a product that says how weak it is."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from shared.errors import ContractError, DomainError
from tests.services.arrival.readers.granule_files import VIIRS_M, made_up, write_viirs_file
from tests.services.arrival.requests import (
    START,
    detections_at,
    file_of,
    incident_at,
    perimeters_of,
    product_of,
    report_of,
    run_request,
)

HERE = shapely.Point(-106.0, 33.5)
RNG = np.random.default_rng(5)
LON, LAT = -106.0 + 0.03 * RNG.standard_normal(60), 33.5 + 0.03 * RNG.standard_normal(60)
HOURS = np.repeat([3.0, 9.0, 15.0, 27.0, 33.0, 39.0], 10)
FIRES = detections_at(LON, LAT, HOURS)


def _hours(outputs: dict[str, Any], name: str = "fire_arrival_time") -> np.ndarray:
    return product_of(outputs)[name].to_numpy() / 3600.0


def test_no_detection_is_an_empty_product_that_says_so(tmp_path: Path) -> None:
    outputs = run_request(tmp_path, {"detections": FIRES.iloc[:0], "incidents": incident_at(HERE)})
    product = product_of(outputs)
    assert "no-detection" in product.attrs["flags"] and product["fire_arrival_time"].isnull().all()
    assert not product["front24_probability"].any() and outputs["animations"] == []
    assert report_of(outputs)["incidents"][0]["front24"]["basis"] == "none"


def test_one_detection_is_flagged_and_wide(tmp_path: Path) -> None:
    outputs = run_request(tmp_path, {"detections": FIRES.iloc[:1], "incidents": incident_at(HERE)})
    product = product_of(outputs)
    assert "one-detection" in product.attrs["flags"]
    width = _hours(outputs, "fire_arrival_time_q95") - _hours(outputs, "fire_arrival_time_q05")
    assert np.isfinite(width).any() and np.nanmin(width) > 12
    assert report_of(outputs)["incidents"][0]["front24"]["basis"] == "climatology"


def test_detections_at_one_instant_are_flagged_and_wide(tmp_path: Path) -> None:
    outputs = run_request(tmp_path, {"detections": detections_at(LON, LAT, 20.0), "incidents": incident_at(HERE)})
    assert "one-instant" in product_of(outputs).attrs["flags"]
    width = _hours(outputs, "fire_arrival_time_q95") - _hours(outputs, "fire_arrival_time_q05")
    assert np.nanmean(width) > 12


def test_all_cloud_is_no_information_and_not_no_fire(tmp_path: Path) -> None:
    made = made_up(VIIRS_M, -40.0, -145.0, lines=320)
    made.mask[made.mask == 5] = 4  # what was clear is cloud
    row, column = made.fires[0]
    there = shapely.Point(float(made.longitude[row, column]) + 0.4, float(made.latitude[row, column]))
    (tmp_path / "in").mkdir()
    write_viirs_file(tmp_path / "in/cloudy.nc", made)
    start, end = "2023-01-14T00:00:00Z", "2023-01-16T00:00:00Z"
    incidents = incident_at(there).assign(
        **{name: START.replace(year=2023, month=1, day=14) for name in ("start", "known_at")}
    )
    outputs = run_request(
        tmp_path, {"incidents": incidents}, files={"detections": {"href": "in/cloudy.nc"}}, start=start, end=end
    )
    product = product_of(outputs)
    assert (product["information"] == 0).all(), "nobody saw: not 'no fire'"
    assert float((product["look_state"] == 1).mean()) > 0.8 and "no-detection" in product.attrs["flags"]
    assert product["latest_hidden_pass"].notnull().mean() > 0.8 and product["latest_observation"].isnull().all()
    assert report_of(outputs)["files"][0]["cloud"] > 100 == 100 + report_of(outputs)["files"][0]["no_fire"]


def test_duplicates_change_nothing(tmp_path: Path) -> None:
    incidents = incident_at(HERE)
    once = run_request(tmp_path / "a", {"detections": FIRES, "incidents": incidents})
    twice = FIRES.iloc[np.repeat(np.arange(len(FIRES)), 2)].reset_index(drop=True)
    again = run_request(tmp_path / "b", {"detections": twice, "incidents": incidents})
    np.testing.assert_array_equal(_hours(once), _hours(again))
    files = {"detections": [{"href": "in/detections.parquet"}, {"href": "in/detections.parquet"}]}
    listed = run_request(tmp_path / "a", {"detections": FIRES, "incidents": incidents}, files=files)
    np.testing.assert_array_equal(_hours(once), _hours(listed))


def test_times_before_the_reported_start_are_used_and_flagged(tmp_path: Path) -> None:
    outputs = run_request(tmp_path, {"detections": FIRES, "incidents": incident_at(HERE, hours=20.0)})
    product = product_of(outputs)
    assert "detections-before-reported-start" in product.attrs["flags"]
    assert product.attrs["reference_time"] == "2022-06-01T21:00:00Z"
    assert np.nanmin(_hours(outputs)) < 17
    early = run_request(
        tmp_path / "b", {"detections": FIRES, "incidents": incident_at(HERE, hours=5 * 24.0)}, end_h=140
    )
    assert "no-detection" in product_of(early).attrs["flags"], "more than three days before belongs to another fire"


@pytest.mark.parametrize("latitude", [-17.0, 66.0])
def test_a_fire_across_the_antimeridian_is_one_fire(tmp_path: Path, latitude: float) -> None:
    lon = (180.0 + (LON + 106.0) / np.cos(np.radians(latitude)) + 180.0) % 360.0 - 180.0
    detections = detections_at(lon, latitude + LAT - 33.5, HOURS)
    assert (lon > 0).any() and (lon < 0).any()
    outputs = run_request(
        tmp_path,
        {"detections": detections, "incidents": incident_at(shapely.Point(-180.0, latitude))},
        formats=["pictures", "geotiff", "kml", "wrfxweb"],
    )
    product = product_of(outputs)
    assert product.sizes["x"] < 120 and report_of(outputs)["counts"]["detections_unassigned"] == 0
    assert int(str(product["crs"].attrs["epsg_code"])[-5:-2]) in (326, 327)
    lines = json.loads(file_of(outputs["isochrones"]).read_text())["features"]
    for feature in lines:
        for part in feature["geometry"]["coordinates"]:
            steps = np.abs(np.diff(np.array(part)[:, 0]))
            assert steps.max(initial=0.0) < 1.0, "no line round the world"
    assert len(outputs["maps"]) == len(outputs["information_maps"]) == len(outputs["front_maps"]) == 1


def test_a_perimeter_that_is_a_line_is_left_out_and_flagged(tmp_path: Path) -> None:
    line = perimeters_of([("one", 20.0, shapely.LineString([(-106.1, 33.5), (-106.0, 33.6)]))])
    staged = {"detections": FIRES, "incidents": incident_at(HERE)}
    outputs = run_request(tmp_path / "a", {**staged, "perimeters": line})
    assert "perimeter-without-area" in product_of(outputs).attrs["flags"]
    plain = run_request(tmp_path / "b", staged)
    both = (
        np.isfinite(_hours(outputs)) == np.isfinite(_hours(plain))
        if _hours(plain).shape == _hours(outputs).shape
        else None
    )
    assert both is None or both.mean() > 0.95
    ring = shapely.LineString(HERE.buffer(0.03).exterior.coords)
    closed = run_request(tmp_path / "c", {**staged, "perimeters": perimeters_of([("one", 20.0, ring)])})
    assert product_of(closed).attrs["flags"].split()[-1] == "perimeters"


def test_an_incident_whose_outline_is_a_line_still_gets_its_fire(tmp_path: Path) -> None:
    outline = shapely.LineString([(-106.1, 33.45), (-106.0, 33.5), (-105.9, 33.55)])
    outputs = run_request(tmp_path, {"detections": FIRES, "incidents": incident_at(outline)})
    assert np.isfinite(_hours(outputs)).any()


def test_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    staged = {"detections": FIRES, "incidents": incident_at(HERE)}
    with pytest.raises(DomainError) as caught:
        run_request(tmp_path / "a", {**staged, "ignitions": perimeters_of([("one", 1.0, HERE.buffer(0.1))])})
    assert caught.value.field == "ignitions.geometry"
    (tmp_path / "b/in").mkdir(parents=True)
    (tmp_path / "b/in/notes.txt").write_text("no detections here")
    with pytest.raises(DomainError) as caught:
        run_request(tmp_path / "b", {"incidents": staged["incidents"]}, files={"detections": {"href": "in/notes.txt"}})
    assert caught.value.field == "detections" and "notes.txt" in caught.value.message
    with pytest.raises((DomainError, ContractError)):
        run_request(tmp_path / "c", {"detections": detections_at(200.0, 33.5, 1.0), "incidents": staged["incidents"]})
    left = [path for path in tmp_path.rglob("*") if path.is_file() and path.parent.name != "in"]
    assert not left, "nothing half-written"
