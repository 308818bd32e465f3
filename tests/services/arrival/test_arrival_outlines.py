"""Perimeters and ignition points: read on the grid, turned into looks, and honoured by the map."""

from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from services.arrival.looks import BURNED_AREA, FIRE
from services.arrival.outlines import area_of, honour, looks_from_outlines, read_outlines
from tests.services.arrival.exports.made_maps import REFERENCE, round_fire
from tests.services.arrival.requests import (
    detections_at,
    incident_at,
    perimeters_of,
    product_of,
    report_of,
    run_request,
)

HERE = shapely.Point(-106.0, 33.5)


@pytest.mark.parametrize(
    ("geometry", "km2_deg"),
    [
        (shapely.box(0, 0, 1, 1), 1.0),
        (shapely.LineString([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]), 1.0),
        (shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), 0.5),  # a bow tie
        (shapely.GeometryCollection([shapely.box(0, 0, 1, 1), shapely.LineString([(0, 0), (5, 5)])]), 1.0),
        (shapely.MultiLineString([[(0, 0), (1, 0), (1, 1), (0, 0)], [(3, 3), (4, 4)]]), 0.5),
        (shapely.LineString([(0, 0), (1, 1)]), None),
        (shapely.Polygon([(0, 0), (1, 1), (2, 2)]), None),
    ],
)
def test_the_area_of_whatever_people_map(geometry: shapely.Geometry, km2_deg: float | None) -> None:
    area = area_of(geometry)
    assert (area is None) if km2_deg is None else (area is not None and area.area == pytest.approx(km2_deg))


def _rows(*rows: tuple[float, shapely.Geometry]) -> gpd.GeoDataFrame:
    times = [REFERENCE + pd.Timedelta(hours=hours) for hours, _ in rows]
    return gpd.GeoDataFrame({"time": times}, geometry=[geometry for _, geometry in rows], crs=4326)


def _disc(radius_km: float) -> shapely.Geometry:
    grid = round_fire().grid
    east, north = grid.origin_km
    angle = np.linspace(0, 2 * np.pi, 73)
    lon, lat = grid.degrees((east + radius_km * np.cos(angle)) * 1e3, (north + radius_km * np.sin(angle)) * 1e3)
    return shapely.Polygon(np.column_stack([lon, lat]))


def test_outlines_become_looks_that_say_what_they_know() -> None:
    made = round_fire()
    outlines = read_outlines(_rows((12.0, _disc(4.0)), (1.0, HERE)), made.grid, REFERENCE)
    looks = looks_from_outlines(outlines, made.grid)
    distance = np.hypot(looks.x_km, looks.y_km)
    inside = (looks.kind == BURNED_AREA) & (looks.probability > 0.5)
    assert inside.sum() > 200 and distance[inside].max() <= 4.01
    outside = (looks.kind == BURNED_AREA) & (looks.probability < 0.5)
    assert distance[outside].min() > 3.99 and distance[outside].max() < 7.5
    assert (looks.time_h[inside | outside] == 12.0).all()
    assert (looks.kind == FIRE).sum() == 1 and looks.time_h[looks.kind == FIRE][0] == 1.0


def test_the_map_obeys_its_perimeters() -> None:
    made = round_fire(speed_km_h=0.25, end_h=40.0)  # reaches 6 km at 24 h
    distance = np.hypot(*made.grid.cell_centres_km())
    rows = _rows((12.0, _disc(5.0)), (30.0, _disc(5.0)))  # mapped further out early, and then at rest
    outlines = read_outlines(rows, made.grid, REFERENCE)
    looks = looks_from_outlines(outlines, made.grid)
    kept = honour(made, outlines, looks, 0.0)
    assert (kept.arrival_h[distance < 4.9] <= 12.0).all()
    assert np.isnan(kept.arrival_h[(distance > 5.4) & (distance < 7.4)]).all(), "outside a later outline, no fire since"
    assert np.isfinite(kept.arrival_h[(distance > 7.7) & (distance < 9.9)]).any(), "what burned after the last outline"
    burned = np.isfinite(kept.arrival_h)
    assert (kept.q05_h[burned] <= kept.arrival_h[burned]).all() and (kept.arrival_h[burned] <= kept.q95_h[burned]).all()
    assert (kept.q95_h[distance < 4.9] <= 12.0).all() and (kept.sd_h[burned] >= 0).all()
    assert (kept.burned_probability[distance < 4.9] >= 0.97).all() and "perimeters" in kept.flags


def test_a_mapped_area_without_any_estimate_burns_within_its_bracket() -> None:
    made = round_fire(end_h=4.0)  # 1 km only
    outlines = read_outlines(_rows((10.0, _disc(2.0)), (20.0, _disc(5.0))), made.grid, REFERENCE)
    kept = honour(made, outlines, looks_from_outlines(outlines, made.grid), 0.0)
    distance = np.hypot(*made.grid.cell_centres_km())
    ring = (distance > 2.4) & (distance < 4.9)
    assert ((kept.arrival_h[ring] > 10) & (kept.arrival_h[ring] <= 20)).all()
    assert np.allclose(kept.sd_h[ring], 10 / np.sqrt(12)) and (kept.q05_h[ring] >= 10).all()


def test_without_perimeters_the_map_stays_as_it_is() -> None:
    made = round_fire()
    outlines = read_outlines(_rows((1.0, HERE)), made.grid, REFERENCE)
    kept = honour(made, outlines, looks_from_outlines(outlines, made.grid), 0.0)
    assert kept == replace(made, flags=kept.flags) or np.array_equal(kept.arrival_h, made.arrival_h, equal_nan=True)


def test_through_the_process_perimeters_bound_and_ignitions_date_the_fire(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    lon, lat = -106.0 + 0.03 * rng.standard_normal(60), 33.5 + 0.03 * rng.standard_normal(60)
    hours = np.repeat([9.0, 15.0, 27.0, 33.0, 39.0, 45.0], 10)
    staged = {"detections": detections_at(lon, lat, hours), "incidents": incident_at(HERE.buffer(0.05), hours=5.0)}
    shape = HERE.buffer(0.03)
    perimeters = perimeters_of([("one", 20.0, shape), ("one", 60.0, HERE.buffer(0.2)), ("other", 20.0, shape)])
    ignitions = perimeters_of([("one", 2.0, shapely.Point(-106.01, 33.49))])
    outputs = run_request(
        tmp_path, {**staged, "perimeters": perimeters, "ignitions": ignitions}, method="nearest-detection"
    )
    product, report = product_of(outputs), report_of(outputs)
    assert report["counts"]["perimeters_not_yet_known"] == 1 == report["counts"]["perimeters_of_other_incidents"]
    assert "perimeters" in product.attrs["flags"] and product.attrs["reference_time"] == "2022-06-01T20:00:00Z"
    from pyproj import Transformer

    to_deg = Transformer.from_crs(str(product["crs"].attrs["epsg_code"]), 4326, always_xy=True)
    x, y = np.meshgrid(product["x"], product["y"])
    inside = shapely.contains_xy(HERE.buffer(0.028), *to_deg.transform(x, y))
    arrival_h = product["fire_arrival_time"].to_numpy()[inside] / 3600 + 2  # hours since 18 UTC
    assert np.isfinite(arrival_h).all() and arrival_h.max() <= 20.0 and arrival_h.min() < 5.0
