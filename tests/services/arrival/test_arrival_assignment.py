"""Detections go to the incident they belong to."""

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from shapely.geometry import Point, Polygon

from services.arrival.assignment import assign
from shared.errors import DomainError

T0 = pd.Timestamp("2022-06-01T00:00Z")


def _incidents(geometries: list, starts: list[pd.Timestamp] | None = None) -> gpd.GeoDataFrame:
    ids = [f"fire-{k}" for k in range(len(geometries))]
    return gpd.GeoDataFrame({"incident_id": ids, "start": starts or [T0] * len(ids)}, geometry=geometries, crs=4326)


def _detections(lon: list[float], lat: list[float], hours: list[float]) -> gpd.GeoDataFrame:
    times = pd.Series([T0 + pd.Timedelta(hours=h) for h in hours])
    return gpd.GeoDataFrame({"time": times, "fire": True}, geometry=gpd.points_from_xy(lon, lat), crs=4326)


def test_fires_apart_get_their_own_and_strangers_go_to_nobody() -> None:
    incidents = _incidents([Point(-108.0, 33.0), Point(-107.0, 33.0)])
    found = assign(_detections([-108.01, -107.02, -105.0], [33.0, 33.01, 35.0], [5, 6, 7]), incidents)
    assert found.fire["fire-0"].tolist() == [0]
    assert found.fire["fire-1"].tolist() == [1]
    assert found.unassigned.tolist() == [2]


def test_a_run_of_detections_carries_a_fire_far_from_its_ignition() -> None:
    lon = np.arange(-108.0, -107.5, 0.02)
    found = assign(_detections(lon.tolist(), [33.0] * lon.size, [5.0] * lon.size), _incidents([Point(-108.0, 33.0)]))
    assert found.fire["fire-0"].size == lon.size


def test_merged_fires_are_divided_by_nearness() -> None:
    lon = np.arange(-108.0, -107.79, 0.02)
    incidents = _incidents([Point(-108.0, 33.0), Point(-107.8, 33.0)])
    found = assign(_detections(lon.tolist(), [33.0] * lon.size, [5.0] * lon.size), incidents)
    assert found.fire["fire-0"].max() < found.fire["fire-1"].min()
    assert found.fire["fire-0"].size + found.fire["fire-1"].size == lon.size


def test_the_middle_of_a_large_outline_belongs_to_it() -> None:
    square = Polygon([(-108.4, 33.0), (-108.0, 33.0), (-108.0, 33.4), (-108.4, 33.4)])
    found = assign(_detections([-108.2], [33.2], [5.0]), _incidents([square]))
    assert found.fire["fire-0"].tolist() == [0]


def test_an_older_fire_at_the_same_place_is_not_taken() -> None:
    found = assign(_detections([-108.0, -108.0], [33.0, 33.0], [-200.0, 4.0]), _incidents([Point(-108.0, 33.0)]))
    assert found.fire["fire-0"].tolist() == [1]
    assert found.unassigned.tolist() == [0]


def test_an_incident_at_the_antimeridian_takes_both_sides() -> None:
    found = assign(_detections([179.99, -179.99], [66.0, 66.0], [3, 4]), _incidents([Point(180.0, 66.0)]))
    assert found.fire["fire-0"].size == 2


def test_without_incidents_every_detection_is_unassigned() -> None:
    found = assign(_detections([10.0], [10.0], [3]), _incidents([Point(0, 0)]).iloc[:0])
    assert found.fire == {} and found.unassigned.tolist() == [0]


def test_a_position_that_is_no_position_is_named() -> None:
    with pytest.raises(DomainError) as caught:
        assign(_detections([10.0, float("nan")], [10.0, 10.0], [3, 4]), _incidents([Point(10, 10)]))
    assert caught.value.field == "detections.geometry" and "row 1" in str(caught.value)
