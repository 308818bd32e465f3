"""EASE-Grid 2.0 against pyproj's EPSG:6933 and NSIDC's grid constants."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from services.retrieval.ease_grid import GRIDS, X_MIN_M, Y_MAX_M, centre, centre_metres, row_column, to_metres
from shared.errors import DomainError

FORWARD = pyproj.Transformer.from_crs(4326, 6933, always_xy=True)


def _positions() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    return rng.uniform(-84.0, 84.0, 2000), rng.uniform(-180.0, 180.0, 2000)


def test_projection_is_epsg_6933() -> None:
    latitude, longitude = _positions()
    x, y = to_metres(latitude, longitude)
    expected_x, expected_y = FORWARD.transform(longitude, latitude)
    assert np.abs(x - expected_x).max() < 1e-3
    assert np.abs(y - expected_y).max() < 1e-3


@pytest.mark.parametrize("resolution", [3, 9, 36])
def test_grids_span_the_globe_and_nest(resolution: int) -> None:
    grid = GRIDS[resolution]
    assert grid.columns * grid.cell_m == pytest.approx(-2 * X_MIN_M, abs=0.5)
    assert grid.rows * grid.cell_m == pytest.approx(2 * Y_MAX_M, abs=0.5)
    assert grid.cell_m == pytest.approx(GRIDS[36].cell_m * resolution / 36, rel=1e-9)


@pytest.mark.parametrize("resolution", [3, 9, 36])
def test_row_and_column_against_pyproj(resolution: int) -> None:
    latitude, longitude = _positions()
    row, column = row_column(latitude, longitude % 360.0, resolution)
    x, y = FORWARD.transform(longitude, latitude)
    cell = GRIDS[resolution].cell_m
    assert np.array_equal(row, np.floor((Y_MAX_M - y) / cell))
    assert np.array_equal(column, np.floor((x - X_MIN_M) / cell))


def test_centres_are_the_inverse() -> None:
    latitude, longitude = _positions()
    row, column = row_column(latitude, longitude, 9)
    middle = centre(row, column, 9)
    assert np.array_equal(np.stack(row_column(*middle, 9)), np.stack([row, column]))
    x, y = centre_metres(row, column, 9)
    expected = FORWARD.transform(middle[1], middle[0])
    assert np.abs(x - expected[0]).max() < 1e-2 and np.abs(y - expected[1]).max() < 1e-2


def test_known_corner_cell() -> None:
    """NSIDC EASE2_M36km: the cell of row 0, column 0 is centred on 83.632 N, 179.813 W."""
    latitude, longitude = centre(np.array([0]), np.array([0]), 36)
    assert latitude[0] == pytest.approx(83.6320, abs=1e-3)
    assert longitude[0] == pytest.approx(-179.8133, abs=1e-3)


def test_poles_lie_beyond_the_grid_and_other_resolutions_are_refused() -> None:
    row, column = row_column(np.array([89.0]), np.array([0.0]), 9)
    assert (row[0], column[0]) == (-1, -1)
    with pytest.raises(DomainError) as error:
        row_column(np.array([0.0]), np.array([0.0]), 25)
    assert error.value.field == "resolution_km"
