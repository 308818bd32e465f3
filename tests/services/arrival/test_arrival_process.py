"""infer-fire-arrival as a step: two fires of one region, contracts, same bytes, named errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from pydantic import ValidationError
from pyproj import CRS, Transformer

from services.arrival.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.grids import FIRE_ARRIVAL, read_netcdf
from shared.contracts.schema import write_table
from shared.errors import DomainError
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.arrival.seeds import TESTS
from tests.services.arrival.synthetic_fires import CELL_KM, SyntheticFire, make_fire

FIRES = [
    make_fire(TESTS[3], observations=1500, tracks=8),
    make_fire(TESTS[4], observations=1500, corner_m=(450_000.0, 3_700_000.0)),
]


def _together(name: str) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(pd.concat([getattr(fire, name) for fire in FIRES], ignore_index=True), crs=4326)


def _stage(root: Path, **tables_changed: gpd.GeoDataFrame) -> dict[str, Any]:
    (root / "in").mkdir(parents=True)
    for name in ("detections", "burned_area", "incidents"):
        frame = tables_changed.get(name, _together(name))
        write_table(root / f"in/{name}.parquet", frame, getattr(tables, name.upper()))
    return {
        "detections": {"href": "in/detections.parquet"},
        "incidents": {"href": "in/incidents.parquet"},
        "burned_area": [{"href": "in/burned_area.parquet"}],
        "start": FIRES[0].start.isoformat(),
        "end": FIRES[0].end.isoformat(),
        "epochs": 15,
        "ensemble": 2,
        "formats": [],
    }


def _run(root: Path, changed: dict[str, gpd.GeoDataFrame] | None = None, **inputs: Any) -> dict[str, Any]:
    store = ArtifactStore(Roots(str(root)))
    request = validate_inputs(PROCESSES[0], {**_stage(root, **(changed or {})), **inputs})
    return run_step(resolve_step(PROCESSES[0], request, store, "test"), store, "test", "job", lambda *_: None)


def _file(reference: dict[str, Any]) -> Path:
    return Path(reference["href"].removeprefix("file://"))


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return _run(tmp_path_factory.mktemp("first"), formats=["pictures", "animation", "geotiff", "kml", "wrfxweb"])


def _truth_at(fire: SyntheticFire, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    column = ((x_m - fire.x_m[0]) / (CELL_KM * 1e3) + 0.5).astype(int)
    row = ((y_m - fire.y_m[0]) / (CELL_KM * 1e3) + 0.5).astype(int)
    ok = (column >= 0) & (row >= 0) & (column < fire.x_m.size) & (row < fire.y_m.size)
    return np.where(ok, fire.arrival_h[np.clip(row, 0, 99), np.clip(column, 0, 99)], np.nan)


def test_every_incident_gets_its_own_product_and_the_right_fire(outputs: dict[str, Any]) -> None:
    assert outputs["incident_count"] == 2 and len(outputs["maps"]) == 2
    for reference, fire in zip(outputs["fire_arrival"], FIRES, strict=True):
        product = read_netcdf(_file(reference), FIRE_ARRIVAL, decode_times=False)
        assert product.attrs["incident_id"] == f"synthetic-{fire.seed}"
        assert _file(reference).name == f"fire_arrival_synthetic-{fire.seed}.nc"
        lead_h = (fire.start - pd.Timestamp(product.attrs["reference_time"])).total_seconds() / 3600
        x, y = np.meshgrid(product["x"].to_numpy(), product["y"].to_numpy())
        truth = _truth_at(fire, x, y) + lead_h
        hours = product["fire_arrival_time"].to_numpy() / 3600
        both = np.isfinite(truth) & np.isfinite(hours)
        assert both.sum() > 0.75 * np.isfinite(truth).sum()
        assert np.abs(hours[both] - truth[both]).mean() < 12


def test_product_is_cf_with_a_crs_that_others_read(outputs: dict[str, Any]) -> None:
    with xr.open_dataset(_file(outputs["fire_arrival"][0])) as product:
        assert product["fire_arrival_time"].dtype.kind == "M", "a CF reader decodes the time"
        assert CRS.from_wkt(product["crs"].attrs["crs_wkt"]).to_epsg() == 32613
        assert product["information"].attrs["flag_meanings"].split()[0] == "not_seen"
        assert product.attrs["Conventions"].startswith("CF-1.11")
        raw = product["burned_probability"]
        assert float(raw.min()) >= 0 and float(raw.max()) <= 1
        burned = product["fire_arrival_time"].notnull()
        assert not product["fire_arrival_time_sd"].isnull().where(burned, False).any()
        assert (product["fire_arrival_time_q05"] <= product["fire_arrival_time_q95"]).where(burned, True).all()


def test_isochrones_are_geojson_in_utc_around_the_fires(outputs: dict[str, Any]) -> None:
    collection = json.loads(_file(outputs["isochrones"]).read_text())
    assert collection["type"] == "FeatureCollection" and "crs" not in collection
    by_fire = gpd.GeoDataFrame.from_features(collection["features"], crs=4326)
    assert set(by_fire["incident_id"]) == {f"synthetic-{fire.seed}" for fire in FIRES}
    for _, rows in by_fire.groupby("incident_id"):
        times = pd.to_datetime(rows["time"])
        assert rows["time"].str.endswith("Z").all() and times.is_monotonic_increasing
        assert rows["area_km2"].is_monotonic_increasing
    ignition = FIRES[1].incidents.geometry.iloc[0]
    last = by_fire[by_fire["incident_id"] == f"synthetic-{FIRES[1].seed}"].geometry.iloc[-1]
    assert last.convex_hull.buffer(0.05).contains(ignition)
    to_m = Transformer.from_crs(4326, 32613, always_xy=True)
    assert to_m.transform(*last.centroid.coords[0])[0] > 450_000


def test_maps_are_png_and_report_counts_add_up(outputs: dict[str, Any]) -> None:
    assert all(_file(picture).read_bytes()[:4] == b"\x89PNG" for picture in outputs["maps"])
    report = json.loads(_file(outputs["report"]).read_text())
    own = sum(entry["fire_detections"] for entry in report["incidents"])
    detections = _together("detections")
    assert 0.97 * detections["fire"].sum() <= own + report["counts"]["detections_unassigned"]
    assert report["incidents"][0]["burned_area_points"] > 0 == report["incidents"][1]["burned_area_points"]
    assert 0 < report["incidents"][0]["network_parameters"] <= 10_000
    assert report["incidents"][0]["beside_nearest_detection"]["sorensen"] > 0.5


def test_the_same_inputs_give_the_same_bytes(outputs: dict[str, Any], tmp_path: Path) -> None:
    again = _run(tmp_path, formats=["pictures", "animation", "geotiff", "kml", "wrfxweb"])
    kinds = ("fire_arrival", "maps", "information_maps", "front_maps", "animations", "geotiffs", "isochrones_kml")
    for name in kinds:
        assert len(again[name]) == (4 if name == "geotiffs" else 2)
        assert [ref["sha256"] for ref in again[name]] == [ref["sha256"] for ref in outputs[name]], name
    assert again["isochrones"]["sha256"] == outputs["isochrones"]["sha256"]


def test_data_after_the_end_change_nothing(tmp_path: Path) -> None:
    end = FIRES[0].start + pd.Timedelta(hours=60)
    detections = _together("detections")
    early = detections[detections["time"] <= end].reset_index(drop=True)
    quick = {"end": end.isoformat(), "method": "nearest-detection"}
    all_rows, cut = _run(tmp_path / "a", **quick), _run(tmp_path / "b", {"detections": early}, **quick)

    def arrival(outputs: dict[str, Any]) -> np.ndarray:
        return read_netcdf(_file(outputs["fire_arrival"][0]), decode_times=False)["fire_arrival_time"].to_numpy()

    np.testing.assert_array_equal(arrival(all_rows), arrival(cut))


def test_low_confidence_is_left_out_and_null_passes(tmp_path: Path) -> None:
    detections = _together("detections")
    fire = detections["fire"].to_numpy()
    doubtful = detections.assign(confidence=np.where(fire & (np.arange(fire.size) % 2 == 0), 70.0, np.nan))
    outputs = _run(tmp_path, {"detections": doubtful}, method="nearest-detection")
    report = json.loads(_file(outputs["report"]).read_text())
    assert report["counts"]["detections_low_confidence"] == (fire & (np.arange(fire.size) % 2 == 0)).sum()


def test_an_incident_without_detections_gets_an_empty_flagged_product(tmp_path: Path) -> None:
    none = FIRES[0].detections
    outputs = _run(
        tmp_path,
        {
            "detections": none[~none["fire"]].reset_index(drop=True),
            "incidents": FIRES[0].incidents,
            "burned_area": FIRES[0].burned_area.iloc[:0],
        },
    )
    product = read_netcdf(_file(outputs["fire_arrival"][0]), FIRE_ARRIVAL, decode_times=False)
    assert "no-detection" in product.attrs["flags"]
    assert product["fire_arrival_time"].isnull().all() and set(np.unique(product["information"])) <= {0, 1}
    assert json.loads(_file(outputs["isochrones"]).read_text())["features"] == []


def test_an_incident_reported_after_the_end_does_not_enter(tmp_path: Path) -> None:
    fire = replace(FIRES[1], incidents=FIRES[1].incidents.assign(known_at=FIRES[1].end + pd.Timedelta(hours=1)))
    both = gpd.GeoDataFrame(pd.concat([FIRES[0].incidents, fire.incidents], ignore_index=True), crs=4326)
    outputs = _run(tmp_path, {"incidents": both}, method="nearest-detection")
    assert outputs["incident_count"] == 1


def test_bad_input_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(DomainError) as caught:
        _run(tmp_path, end="2022-05-01T00:00:00Z")
    assert caught.value.field == "end"
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.parent.name != "in"]


@pytest.mark.parametrize(("name", "value"), [("method", "guess"), ("cell_m", 1.0), ("end", "2022-06-03T00:00:00")])
def test_parameters_are_checked_before_anything_runs(tmp_path: Path, name: str, value: Any) -> None:
    with pytest.raises(ValidationError) as caught:
        _run(tmp_path, **{name: value})
    assert caught.value.errors()[0]["loc"] == (name,)


def test_no_detection_row_and_no_incident_are_answered(tmp_path: Path) -> None:
    empty = _together("detections").iloc[:0]
    outline = FIRES[0].incidents.set_geometry([FIRES[0].incidents.geometry.iloc[0].buffer(0.02)], crs=4326)
    nothing_seen = _run(
        tmp_path / "a", {"detections": empty, "incidents": outline, "burned_area": FIRES[1].burned_area}
    )
    product = read_netcdf(_file(nothing_seen["fire_arrival"][0]), FIRE_ARRIVAL, decode_times=False)
    assert (product["information"] == 0).all() and "no-detection" in product.attrs["flags"]
    nobody = _run(tmp_path / "b", {"incidents": outline.iloc[:0]})
    assert nobody["incident_count"] == 0 and nobody["fire_arrival"] == []
