"""Scores against cases worked by hand: a disc that grows steadily."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import pytest
import shapely
import xarray as xr
from pyproj import CRS, Transformer

from flows.cases.scoring import (
    ArrivalField,
    arrival_scores,
    burned_area_scores,
    perimeter_scores,
    polygonal,
    rank_auc,
    read_arrival,
    truth_incidents,
)
from shared.contracts.grids import write_netcdf
from shared.errors import DomainError

START = datetime(2025, 9, 1, tzinfo=UTC)
UTM = CRS.from_epsg(32612)
CENTRE = (600_000.0, 3_700_000.0)
SPEED = 500.0  # m/h


def _disc(
    cell_m: float = 250.0, late_h: float = 0.0, until_h: float = 24.0, reference: datetime = START
) -> ArrivalField:
    steps = np.arange(-15_000.0, 15_001.0, cell_m)
    x, y = CENTRE[0] + steps, CENTRE[1] + steps
    hours = np.hypot(*np.meshgrid(steps, steps)) / SPEED + late_h
    seconds = (hours + (START - reference) / timedelta(hours=1)) * 3600
    return ArrivalField(np.where(hours <= until_h, seconds, np.nan), x, y, UTM, reference)


def test_a_perfect_product_scores_perfectly() -> None:
    scores = arrival_scores(_disc(), _disc(), START + timedelta(hours=20))
    assert scores["mae_h"] == 0 and scores["bias_h"] == 0
    assert scores["sorensen"] == scores["f1_extent"] == scores["precision"] == scores["recall"] == 1
    assert scores["truth_km2"] == pytest.approx(np.pi * 10**2, rel=0.01)


def test_a_late_product_is_biased_late_and_too_small() -> None:
    scores = arrival_scores(_disc(late_h=2.0), _disc(), START + timedelta(hours=20))
    assert scores["bias_h"] == pytest.approx(2.0)
    assert scores["mae_h"] == pytest.approx(2.0)
    assert scores["precision"] == 1
    assert scores["sorensen"] == pytest.approx(
        2 * 18**2 / (18**2 + 20**2), rel=0.01
    )  # areas go with the radius squared


def test_other_grid_and_clock_do_not_matter() -> None:
    coarse = _disc(cell_m=500.0, reference=START - timedelta(days=3))
    scores = arrival_scores(coarse, _disc(), START + timedelta(hours=20))
    assert abs(scores["bias_h"]) < 0.02
    assert scores["sorensen"] > 0.97


def test_other_projection_does_not_matter() -> None:
    truth = _disc()
    back = Transformer.from_crs(UTM, 32613, always_xy=True)
    x0, y0 = back.transform(*CENTRE)
    steps = np.arange(-16_000.0, 16_001.0, 250.0)
    x, y = np.meshgrid(x0 + steps, y0 + steps)
    east, north = Transformer.from_crs(32613, UTM, always_xy=True).transform(x, y)
    seconds = np.hypot(east - CENTRE[0], north - CENTRE[1]) / SPEED * 3600
    other = ArrivalField(seconds, x0 + steps, y0 + steps, CRS.from_epsg(32613), START)
    scores = arrival_scores(other, truth, START + timedelta(hours=20))
    assert scores["sorensen"] > 0.98 and scores["mae_h"] < 0.3


def test_nothing_burned_yet_is_undefined_not_perfect() -> None:
    scores = arrival_scores(_disc(), _disc(), START - timedelta(hours=1))
    assert np.isnan(scores["sorensen"]) and np.isnan(scores["mae_h"])


def _outline(hours: float) -> shapely.Polygon:
    circle = shapely.Point(*CENTRE).buffer(hours * SPEED, quad_segs=64)
    return geopandas.GeoSeries([circle], crs=UTM).to_crs(4326).iloc[0]


def test_a_perfect_product_keeps_the_bracket() -> None:
    scores = perimeter_scores(_disc(), _outline(12), START + timedelta(hours=10), START + timedelta(hours=14))
    assert scores["bracket_fraction"] == 1 and scores["bracket_error_h"] == 0 and scores["outline_missed"] == 0
    ends = scores["sorensen_at_polygon_time"], scores["sorensen_at_known_at"]
    assert ends[0] == pytest.approx(2 * 100 / (100 + 144), rel=0.02)
    assert ends[1] == pytest.approx(2 * 144 / (144 + 196), rel=0.02)
    assert min(ends) < scores["sorensen"] < 1


def test_a_late_product_breaks_the_inner_side_by_its_delay() -> None:
    scores = perimeter_scores(_disc(late_h=6.0), _outline(12), START + timedelta(hours=10), START + timedelta(hours=14))
    assert scores["bracket_fraction"] == pytest.approx(0.5, abs=0.05)  # inner cells late by 4 h, outer ones fine
    assert scores["bracket_error_h"] == pytest.approx(2.0, abs=0.3)


def test_an_early_product_breaks_the_outer_side() -> None:
    scores = perimeter_scores(
        _disc(late_h=-6.0), _outline(12), START + timedelta(hours=10), START + timedelta(hours=14)
    )
    assert scores["bracket_fraction"] == pytest.approx(0.5, abs=0.05)


def test_an_empty_product_misses_the_outline() -> None:
    scores = perimeter_scores(
        _disc(until_h=-1.0), _outline(12), START + timedelta(hours=10), START + timedelta(hours=14)
    )
    assert scores["sorensen"] == 0 and scores["outline_missed"] == 1
    assert scores["bracket_fraction"] == pytest.approx(0.5, abs=0.05)


def test_collections_keep_their_polygons() -> None:
    collection = shapely.GeometryCollection([shapely.Point(0, 0).buffer(1), shapely.LineString([(0, 0), (9, 9)])])
    assert polygonal(collection).geom_type == "Polygon"
    assert polygonal(collection).area == pytest.approx(shapely.Point(0, 0).buffer(1).area)


def test_burned_area_points_are_scored_at_their_own_time() -> None:
    to_degrees = Transformer.from_crs(UTM, 4326, always_xy=True)
    places = [to_degrees.transform(CENTRE[0] + offset, CENTRE[1]) for offset in (0.0, 4000.0, 4000.0, 9000.0)]
    times = [START + timedelta(hours=h) for h in (5, 5, 12, 5)]
    points = geopandas.GeoDataFrame(
        {
            "time": pd.to_datetime(times, utc=True),
            "along_m": 1000.0,
            "across_m": 800.0,
            "burned_probability": [0.9, 0.2, 0.8, 0.7],
            "burned": [True, False, True, True],
        },
        geometry=geopandas.points_from_xy(*zip(*places, strict=True)),
        crs=4326,
    )
    scores = burned_area_scores(points, [_disc()])  # true: yes, no, yes, no
    assert scores["base_rate"] == 0.5
    assert scores["accuracy"] == 0.75
    assert scores["f1"] == pytest.approx(2 * 2 / (3 + 2))
    assert scores["auc"] == 1.0
    assert scores["brier"] == pytest.approx((0.01 + 0.04 + 0.04 + 0.49) / 4)


def test_auc_shares_ties() -> None:
    assert rank_auc(np.array([0.1, 0.5, 0.5, 0.9]), np.array([False, False, True, True])) == pytest.approx(0.875)
    assert np.isnan(rank_auc(np.array([0.1, 0.5]), np.array([True, True])))


def test_reads_a_product_and_counts_improbable_cells_as_unburned(tmp_path: Path) -> None:
    field = _disc(cell_m=1000.0)
    probability = np.where(field.x_m[None, :] < CENTRE[0], 0.9, 0.1) * np.ones(field.arrival_s.shape)
    dataset = xr.Dataset(
        {
            "fire_arrival_time": (("y", "x"), field.arrival_s, {"grid_mapping": "crs"}),
            "burned_probability": (("y", "x"), probability),
            "crs": ((), 0, {"crs_wkt": UTM.to_wkt()}),
        },
        coords={"x": field.x_m, "y": field.y_m},
        attrs={"reference_time": "2025-09-01T00:00:00Z", "incident_id": "A"},
    )
    write_netcdf(tmp_path / "fire_arrival_A.nc", dataset)
    read = read_arrival(tmp_path / "fire_arrival_A.nc")
    assert read.reference_time == START and read.crs == UTM
    assert np.isnan(read.arrival_s[:, read.x_m > CENTRE[0]]).all()
    np.testing.assert_array_equal(read.arrival_s[:, read.x_m < CENTRE[0]], field.arrival_s[:, field.x_m < CENTRE[0]])
    with pytest.raises(DomainError, match="fire_arrival_time_B"):
        read_arrival(tmp_path / "fire_arrival_A.nc", "fire_arrival_time_B")
    assert truth_incidents(tmp_path / "fire_arrival_A.nc") == []
