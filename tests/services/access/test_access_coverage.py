"""Coverage by columns of space against SciPy's KD-tree and by footprints against shapely; dateline, poles, gaps."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod
from scipy.spatial import cKDTree

from services.access.coverage.grid import cells_at, even_grid
from services.access.coverage.places import places
from services.access.coverage.revisit import Revisits, join_visits, summary, visits
from services.access.coverage.search import covered
from services.access.ellipsoid import arc_from_chord_m, chord_from_arc_m, to_cartesian, up_vector
from services.access.horizon import Horizon
from services.access.specular.footprint import Footprints
from shared.errors import DomainError

Array = np.ndarray


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 10_000), st.sampled_from([3.0, 25.0, 180.0]),
    st.sampled_from([(0.0, 180.0), (89.5, 0.0), (-89.9, 10.0), (40.0, -105.0)]),
)  # fmt: skip
def test_rows_are_those_of_a_tree_and_the_best_point_wins(
    seed: int, radius_km: float, centre: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    spread = 4.0 * radius_km / 111.0
    towards = to_cartesian(*(np.array([c]) for c in centre))[0]
    cloud = towards + rng.normal(scale=spread * 111e3 / 2, size=(160, 3))
    latitude = np.degrees(np.arctan2(cloud[:, 2], np.hypot(cloud[:, 0], cloud[:, 1])))
    longitude = np.degrees(np.arctan2(cloud[:, 1], cloud[:, 0]))
    targets, points = slice(0, 100), slice(100, 160)
    step = np.sort(rng.integers(0, 12, 60)).astype(np.int32)
    gain = rng.integers(0, 4, 60).astype(float)  # equal gains happen: then the nearer point counts
    position = to_cartesian(latitude[points], longitude[points])
    found = covered(step, position, gain, places(latitude[targets], longitude[targets], radius_km))

    place = to_cartesian(latitude[targets], longitude[targets])
    near = cKDTree(place).query_ball_point(position, chord_from_arc_m(radius_km * 1000.0))
    expected: dict[tuple[int, int], int] = {}
    for index, rows in enumerate(near):
        for row in rows:
            key = (int(step[index]), int(row))
            apart = np.linalg.norm(position[index] - place[row])
            other = expected.get(key)
            if other is None or (-gain[index], apart) < (-gain[other], np.linalg.norm(position[other] - place[row])):
                expected[key] = index
    rows = list(zip(found.time_index.tolist(), found.row.tolist(), strict=True))
    assert rows == sorted(expected)
    assert found.point.tolist() == [expected[key] for key in rows]
    assert (found.distance_km <= radius_km + 1e-6).all()
    nearest = cKDTree(position).query(place)[0] / 1000.0
    within = nearest < max(radius_km, 25.0) * 0.999
    assert np.allclose(found.nearest_km[0][within], nearest[within], rtol=1e-3)
    assert (found.nearest_km[0][nearest > max(radius_km, 25.0) * 1.001] > max(radius_km, 25.0)).all()


def test_neighbours_across_the_dateline_and_around_the_pole() -> None:
    targets = places(np.array([10.0, 89.99, 10.0]), np.array([179.98, 0.0, 178.0]), 10.0)
    position = to_cartesian(np.array([10.0, 89.99]), np.array([-179.98, 180.0]))
    found = covered(np.array([0, 1], dtype=np.int32), position, np.zeros(2), targets)
    assert found.time_index.tolist() == [0, 1]
    assert found.row.tolist() == [0, 1]
    assert found.distance_km[0] == pytest.approx(0.04 * 111.32 * np.cos(np.radians(10.0)), rel=0.01)
    assert found.distance_km[1] == pytest.approx(0.02 * 111.69, rel=0.01)


def test_distances_are_those_of_the_geodesic_at_any_latitude() -> None:
    rng = np.random.default_rng(1)
    latitude, longitude = rng.uniform(-89.9, 89.9, 300), rng.uniform(-180, 180, 300)
    azimuth, distance_m = rng.uniform(0, 360, 300), rng.uniform(0, 24_000, 300)
    east, north, _ = Geod(ellps="WGS84").fwd(longitude, latitude, azimuth, distance_m)
    found = covered(
        np.arange(300, dtype=np.int32), to_cartesian(north, east), np.zeros(300), places(latitude, longitude, 25.0)
    )
    own = found.row == found.time_index
    assert own.sum() == 300
    assert np.abs(found.distance_km[own] * 1000.0 / distance_m - 1.0).max() < 0.004


def test_no_targets_and_no_places_are_refused_by_row() -> None:
    with pytest.raises(DomainError, match="targets: the table is empty"):
        places(np.array([]), np.array([]), 10.0)
    with pytest.raises(DomainError, match="row 1"):
        places(np.array([1.0, np.nan]), np.array([1.0, 2.0]), 10.0)
    with pytest.raises(DomainError, match="row 0"):
        places(np.array([91.0]), np.array([0.0]), 10.0)


def test_no_points_cover_nothing() -> None:
    found = covered(
        np.zeros(0, dtype=np.int32), np.zeros((0, 3)), np.zeros(0), places(np.array([1.0]), np.array([1.0]), 10.0)
    )
    assert len(found.row) == 0 and np.isinf(found.nearest_km).all()


def _frames(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    up = up_vector(latitude, longitude)
    east = np.stack([-np.sin(np.radians(longitude)), np.cos(np.radians(longitude)), 0 * longitude], axis=-1)
    return east, np.cross(up, east)


@pytest.mark.parametrize("at", [(12.0, 179.9), (-34.0, 20.0), (88.0, 60.0)])
def test_cells_and_points_under_a_footprint_are_those_of_plane_geometry(at: tuple[float, float]) -> None:
    """The footprint as a shapely polygon: an ellipse dragged along its motion, against cells and points."""
    rng = np.random.default_rng(7)
    grid = even_grid(0.05, (at[1] - 0.35, at[0] - 0.35, (at[1] + 0.35 + 180) % 360 - 180, at[0] + 0.35))
    latitude, longitude = at[0] + rng.uniform(-0.1, 0.1, 40), at[1] + rng.uniform(-0.1, 0.1, 40)
    axes = rng.uniform(300.0, 2500.0, (40, 2))
    turn, motion = rng.uniform(0, np.pi, 40), rng.uniform(-7000, 7000, (40, 2))
    shapes = np.zeros((40, 5))
    for k in range(40):
        rotation = np.array([[np.cos(turn[k]), -np.sin(turn[k])], [np.sin(turn[k]), np.cos(turn[k])]])
        factor = np.linalg.cholesky(rotation @ np.diag(1.0 / axes[k] ** 2) @ rotation.T)
        shapes[k] = factor[0, 0], factor[1, 0], factor[1, 1], *motion[k]
    position = to_cartesian(latitude, longitude)
    east, north = _frames(latitude, longitude)
    sized, bare = grid.places(None), cells_at(grid.latitude_deg, grid.longitude_deg).places(None)
    step = np.arange(40, dtype=np.int32)
    cells = covered(step, position, np.zeros(40), sized, footprints=Footprints(shapes))
    points = covered(step, position, np.zeros(40), bare, footprints=Footprints(shapes))
    corners = [
        to_cartesian(np.minimum(grid.latitude_deg + dy, 90.0), grid.longitude_deg + dx)
        for dx, dy in ((-0.025, -0.025), (0.025, -0.025), (0.025, 0.025), (-0.025, 0.025))
    ]
    middle = to_cartesian(grid.latitude_deg, grid.longitude_deg)
    wrong, seen = 0, 0
    for k in range(40):
        angle = np.linspace(0, 2 * np.pi, 181)[:-1] + turn[k]
        ring = axes[k] * np.stack([np.cos(angle - turn[k]), np.sin(angle - turn[k])], axis=1)
        ring = ring @ np.array([[np.cos(turn[k]), np.sin(turn[k])], [-np.sin(turn[k]), np.cos(turn[k])]])
        swept = shapely.convex_hull(shapely.multipoints(np.concatenate([ring, ring + motion[k]])))

        def flat(some: Array, k: int = k) -> Array:
            offset = some - position[k]
            return np.stack([offset @ east[k], offset @ north[k]], axis=-1)

        quads = shapely.polygons(np.stack([flat(corner) for corner in corners], axis=1))
        for found, shape in ((cells, quads), (points, shapely.points(flat(middle)))):
            mine = np.zeros(len(grid), dtype=bool)
            mine[found.row[found.time_index == k]] = True
            sure = shapely.distance(shape, swept) > 20.0  # the plane and the polygon are good to some metres
            inside = shapely.intersects(shape, shapely.buffer(swept, -20.0))
            wrong += int((mine & sure).sum() + (~mine & inside).sum())
            seen += int(mine.sum())
    assert wrong == 0 and seen > 100


def test_even_grids_fill_their_box_over_dateline_and_poles() -> None:
    globe = even_grid(0.5)
    assert len(globe) == 360 * 720 and globe.shape == (360, 720)
    assert globe.latitude_deg.max() == 89.75 and globe.longitude_deg.min() == -179.75
    box = even_grid(1.0, (170.0, -5.0, -170.0, 5.0))
    assert box.shape == (10, 20) and set(box.longitude_deg) == {*np.arange(170.5, 180), *np.arange(-179.5, -170)}
    assert np.abs(even_grid(0.7).latitude_deg).max() <= 90.0
    with pytest.raises(DomainError, match="not a box"):
        even_grid(1.0, (0.0, 10.0, 10.0, 5.0))
    with pytest.raises(DomainError, match="makes"):
        even_grid(0.01)


@pytest.mark.parametrize("spacing_deg", [0.25, 1.0, 5.0, 30.0])
def test_cells_of_any_size_are_boxes_of_longitude_and_latitude(spacing_deg: float) -> None:
    """By footprints of 300 m a cell is covered where the point lies in its box, or within 0.5 km of it; poles too."""
    rng = np.random.default_rng(3)
    latitude = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 1500)))
    latitude[:400] = rng.uniform(84.0, 90.0, 400) * rng.choice([-1.0, 1.0], 400)
    longitude = rng.uniform(-180.0, 180.0, 1500)
    latitude[:2], longitude[2:4] = [90.0, -90.0], [180.0, -180.0]
    zones = Footprints(np.tile([1 / 300.0, 0.0, 1 / 300.0, 1.0, 1.0], (1500, 1)))
    grid = even_grid(spacing_deg)
    index = np.arange(1500, dtype=np.int32)
    ready = grid.places(None)
    found = covered(index, to_cartesian(latitude, longitude), np.zeros(1500), ready, footprints=zones)
    row = np.minimum(((90.0 - latitude) / spacing_deg).astype(int), grid.shape[0] - 1)
    holder = row * grid.shape[1] + ((longitude + 180.0) / spacing_deg).astype(int) % grid.shape[1]
    assert set(zip(index, holder, strict=True)) <= set(zip(found.time_index, found.row, strict=True))
    north = np.abs(latitude[found.time_index] - grid.latitude_deg[found.row]) - spacing_deg / 2
    turn = (longitude[found.time_index] - grid.longitude_deg[found.row] + 180.0) % 360.0 - 180.0
    east = (np.abs(turn) - spacing_deg / 2).clip(0.0) * np.cos(np.radians(latitude[found.time_index]))
    assert 111.4 * np.hypot(north.clip(0.0), east).max() < 0.5
    assert len(ready) == len(grid) and found.nearest_km.shape == (1, len(grid))
    near = np.isfinite(found.nearest_km[0])
    middles = to_cartesian(grid.latitude_deg, grid.longitude_deg)[near]
    nearest, _ = cKDTree(to_cartesian(latitude, longitude)).query(middles)
    inside = nearest < 25e3
    assert np.allclose(1000.0 * found.nearest_km[0][near][inside], arc_from_chord_m(nearest[inside]), rtol=1e-5)


def test_land_cells_are_on_land() -> None:
    land = even_grid(1.0, land_only=True)
    area = np.cos(np.radians(land.latitude_deg)).sum() / np.cos(np.radians(even_grid(1.0).latitude_deg)).sum()
    assert 0.27 < area < 0.31  # land is 29 % of the Earth
    there = set(zip(land.latitude_deg, land.longitude_deg, strict=True))
    assert {(33.5, -106.5), (-33.5, -69.5), (-25.5, 134.5), (-80.5, 100.5)} <= there
    assert not {(30.5, -40.5), (-40.5, 90.5), (0.5, -170.5)} & there
    with pytest.raises(DomainError, match="not one cell"):
        even_grid(1.0, (-160.0, -10.0, -150.0, 10.0), land_only=True)


def test_visits_part_where_a_pass_ends() -> None:
    found = visits(np.array([5, 6, 6, 7, 5000, 5001], dtype=np.int32), np.array([0, 0, 1, 0, 0, 1]), 1)
    assert list(zip(found.row, found.start_s, found.end_s, found.images, strict=True)) == [
        (0, 5, 8, 3), (0, 5000, 5001, 1), (1, 6, 7, 1), (1, 5001, 5002, 1),
    ]  # fmt: skip


def test_gaps_are_between_visits_of_any_receiver_and_to_the_ends() -> None:
    horizon = Horizon(datetime(2024, 7, 1, tzinfo=UTC), 86400, 1)
    gathered = Revisits(3, horizon)
    near, far = np.full((1, 3), 5.0, dtype=np.float32), np.full((1, 3), 20.0, dtype=np.float32)
    gathered.add(visits(np.array([3600, 3601, 50_000]), np.zeros(3, dtype=np.int32), 1), near)
    gathered.add(visits(np.array([20_000, 49_990, 50_005]), np.array([0, 0, 1]), 1), far)
    frame = gathered.frame()
    assert frame["visits"].tolist() == [4, 1, 0] and frame["images"].tolist() == [5, 1, 0]
    gaps = np.array([20_000 - 3602, 49_990 - 20_001, 9])
    assert frame.loc[0, "mean_gap_h"] == pytest.approx(gaps.mean() / 3600)
    assert frame.loc[0, "median_gap_h"] == pytest.approx(np.median(gaps) / 3600)
    assert frame.loc[0, "max_gap_h"] == pytest.approx(gaps.max() / 3600)
    assert frame.loc[0, "longest_wait_h"] == pytest.approx((86400 - 50_001) / 3600)
    assert frame["longest_wait_h"].tolist()[1:] == pytest.approx([50_005 / 3600, 24.0])
    assert frame.loc[0, "first_covered"] == pd.Timestamp("2024-07-01T01:00:00Z") and pd.isna(
        frame.loc[2, "first_covered"]
    )
    assert np.isnan(frame.loc[1, "max_gap_h"])
    assert gathered.covered == 2
    assert gathered.covered_share((3.5, 10.0, 25.0)) == {"3.5": [0.0], "10": [1.0], "25": [1.0]}
    assert summary(frame)["covered"] == 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_gap_statistics_agree_with_pandas(seed: int) -> None:
    rng = np.random.default_rng(seed)
    horizon = Horizon(datetime(2024, 7, 1, tzinfo=UTC), 86400, 10)
    gathered, stays = Revisits(6, horizon), []
    for _ in range(3):
        time, row = rng.integers(0, 8640, 40), rng.integers(0, 5, 40)
        order = np.lexsort((row, time))
        pairs = np.unique(np.stack([time[order], row[order]]), axis=1)
        part = visits(pairs[0].astype(np.int32), pairs[1].astype(np.int32), 10)
        gathered.add(part, np.full((1, 6), np.inf, dtype=np.float32))
        stays.append(pd.DataFrame({"row": part.row, "start": part.start_s, "end": part.end_s}))
    frame = gathered.frame()
    for place, rows in pd.concat(stays).sort_values(["row", "start"]).groupby("row"):
        reach = rows["end"].cummax().shift()
        gap = (rows["start"] - reach).dropna()
        gap = gap[gap > 0]
        assert frame.loc[place, "visits"] == len(rows)
        if len(gap):
            assert frame.loc[place, "mean_gap_h"] * 3600 == pytest.approx(gap.mean())
            assert frame.loc[place, "median_gap_h"] * 3600 == pytest.approx(gap.median())
            assert frame.loc[place, "max_gap_h"] * 3600 == pytest.approx(gap.max())
    assert frame.loc[5, "visits"] == 0


def test_visits_cut_by_a_part_of_the_horizon_are_one_again() -> None:
    rng = np.random.default_rng(2)
    time, row = np.sort(rng.integers(0, 20_000, 300)), rng.integers(0, 6, 300)
    pairs = np.unique(np.stack([time, row]), axis=1)
    whole = visits(pairs[0], pairs[1], 1)
    cut = [visits(*pairs[:, (pairs[0] >= a) & (pairs[0] < a + 5000)], 1) for a in range(0, 20_000, 5000)]
    joined = join_visits(cut, 1)
    assert sum(len(part.row) for part in cut) > len(whole.row)
    for name in ("row", "start_s", "end_s", "images"):
        assert np.array_equal(getattr(joined, name), getattr(whole, name)), name
