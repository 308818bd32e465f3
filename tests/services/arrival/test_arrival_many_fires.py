"""64 fires at once: one after the other, over a pool of processes and over Dask give the same bytes."""

import hashlib
import json
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from shared.fan_out import VARIABLE
from tests.services.arrival.requests import detections_at, file_of, incident_at, product_of, report_of, run_request

FIRES = 64
COARSE = {"method": "nearest-detection", "cell_m": 2000.0, "margin_km": 2.0}
PLACES = [(-120.0 + 2.5 * (k % 8), 33.0 + 1.5 * (k // 8)) for k in range(FIRES)]


def _tables() -> dict[str, gpd.GeoDataFrame]:
    """64 fires over twenty degrees of longitude: four UTM zones, each its own detections."""
    rng = np.random.default_rng(4)
    detections, incidents = [], []
    for index, (lon, lat) in enumerate(PLACES):
        hours = np.sort(rng.uniform(2.0, 40.0, 6))
        detections.append(
            detections_at(lon + 0.02 * rng.standard_normal(6), lat + 0.02 * rng.standard_normal(6), hours)
        )
        incidents.append(incident_at(shapely.Point(lon, lat), incident_id=f"fire-{index:02d}"))
    return {
        name: gpd.GeoDataFrame(pd.concat(parts, ignore_index=True), crs=4326)
        for name, parts in (("detections", detections), ("incidents", incidents))
    }


def _hashes(outputs: dict[str, Any]) -> dict[str, str]:
    kept = [*outputs["fire_arrival"], outputs["isochrones"], outputs["report"]]
    return {file_of(ref).name: hashlib.sha256(file_of(ref).read_bytes()).hexdigest() for ref in kept}


@pytest.fixture(scope="module")
def in_turn(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return run_request(tmp_path_factory.mktemp("turn"), _tables(), **COARSE)


def test_each_of_many_fires_gets_its_own_product_in_its_own_zone(in_turn: dict[str, Any]) -> None:
    report = report_of(in_turn)
    assert in_turn["incident_count"] == FIRES and report["counts"]["detections_unassigned"] == 0
    assert all(entry["fire_detections"] == 6 for entry in report["incidents"])
    assert len({entry["epsg"] for entry in report["incidents"]}) >= 4
    lines = json.loads(file_of(in_turn["isochrones"]).read_text())["features"]
    assert {line["properties"]["incident_id"] for line in lines} == {f"fire-{k:02d}" for k in range(FIRES)}


def test_a_pool_of_processes_gives_the_same_bytes(
    in_turn: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, "processes:2")
    spread = run_request(tmp_path, _tables(), **COARSE)
    assert _hashes(spread) == _hashes(in_turn)


def test_dask_gives_the_same_bytes(in_turn: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "processes": True}
    with distributed.LocalCluster(**options, silence_logs=50) as cluster:
        monkeypatch.setenv(VARIABLE, f"dask:{cluster.scheduler_address}")
        spread = run_request(tmp_path, _tables(), **COARSE)
    assert _hashes(spread) == _hashes(in_turn)


def test_incidents_whose_names_no_file_can_carry_keep_files_of_their_own(tmp_path: Path) -> None:
    names = ["a/b", "a:b", "a_b", "a" * 200, "a" * 201]
    where = PLACES[: len(names)]
    staged = {
        "detections": pd.concat([detections_at(lon, lat, 5.0) for lon, lat in where], ignore_index=True),
        "incidents": pd.concat(
            [incident_at(shapely.Point(*place), incident_id=name) for place, name in zip(where, names, strict=True)],
            ignore_index=True,
        ),
    }
    outputs = run_request(tmp_path, staged, **COARSE)
    inside = {product_of(outputs, index).attrs["incident_id"] for index in range(outputs["incident_count"])}
    assert inside == set(names)
    assert "fire_arrival_a_b.nc" in {file_of(ref).name for ref in outputs["fire_arrival"]}
