"""Coverage by cells against SciPy's KD-tree, over the dateline and the pole, and by the point of highest gain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from services.access.coverage.search import covered_targets, target_cells
from services.access.ellipsoid import chord_from_arc_m, to_cartesian
from services.access.specular.tracks import SpecularTrack
from shared.errors import DomainError


def _track(latitude: np.ndarray, longitude: np.ndarray, step: np.ndarray, gain: np.ndarray) -> SpecularTrack:
    count = len(step)
    zeros = np.zeros(count)
    return SpecularTrack(
        "CYGFM01", step.astype(np.int32), np.arange(count, dtype=np.int32), to_cartesian(latitude, longitude),
        zeros, zeros, gain, zeros, zeros, zeros.astype(bool), 0,
    )  # fmt: skip


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
    step = np.sort(rng.integers(0, 12, 60))
    gain = rng.integers(0, 4, 60).astype(float)  # equal gains happen: then the nearer point counts
    track = _track(latitude[points], longitude[points], step, gain)
    found = covered_targets(track, target_cells(latitude[targets], longitude[targets], radius_km))

    place = to_cartesian(latitude[targets], longitude[targets])
    near = cKDTree(place).query_ball_point(track.position_m, chord_from_arc_m(radius_km * 1000.0))
    expected: dict[tuple[int, int], int] = {}
    for index, rows in enumerate(near):
        for row in rows:
            key = (int(step[index]), int(row))
            apart = np.linalg.norm(track.position_m[index] - place[row])
            other = expected.get(key)
            if other is None or (-gain[index], apart) < (
                -gain[other],
                np.linalg.norm(track.position_m[other] - place[row]),
            ):
                expected[key] = index
    rows = list(zip(found.time_index.tolist(), found.target_row.tolist(), strict=True))
    assert rows == sorted(expected)
    assert found.point.tolist() == [expected[key] for key in rows]
    assert (found.distance_km <= radius_km + 1e-6).all()


def test_neighbours_across_the_dateline_and_around_the_pole() -> None:
    cells = target_cells(np.array([10.0, 89.99, 10.0]), np.array([179.98, 0.0, 178.0]), 10.0)
    track = _track(np.array([10.0, 89.99]), np.array([-179.98, 180.0]), np.array([0, 1]), np.zeros(2))
    found = covered_targets(track, cells)
    assert found.time_index.tolist() == [0, 1]
    assert found.target_row.tolist() == [0, 1]
    assert found.distance_km[0] == pytest.approx(0.04 * 111.32 * np.cos(np.radians(10.0)), rel=0.01)
    assert found.distance_km[1] == pytest.approx(0.02 * 111.69, rel=0.01)


def test_no_targets_and_no_places_are_refused_by_row() -> None:
    with pytest.raises(DomainError, match="targets: the table is empty"):
        target_cells(np.array([]), np.array([]), 10.0)
    with pytest.raises(DomainError, match="row 1"):
        target_cells(np.array([1.0, np.nan]), np.array([1.0, 2.0]), 10.0)
    with pytest.raises(DomainError, match="row 0"):
        target_cells(np.array([91.0]), np.array([0.0]), 10.0)


def test_no_points_cover_nothing() -> None:
    empty = np.array([])
    found = covered_targets(_track(empty, empty, empty, empty), target_cells(np.array([1.0]), np.array([1.0]), 10.0))
    assert len(found.target_row) == 0
