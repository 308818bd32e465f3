"""The grids of pre-fire danger: the USGS 1 km grid against PROJ, its windows, and fuels that do not fit."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Transformer

from services.prioritization.prefire import danger_grid, danger_run, fuels
from shared.errors import DomainError

USGS = Transformer.from_crs("EPSG:4326", "+proj=laea +lat_0=45 +lon_0=-100 +a=6370997 +b=6370997", always_xy=True)


def test_cells_lie_where_the_library_puts_them():
    grid = danger_grid.UsgsGrid()
    assert grid.shape == (2889, 4587)
    rows = slice(700, 703)
    longitude, latitude = grid.places(rows)
    x, y = USGS.transform(longitude, latitude)
    np.testing.assert_allclose(x, np.broadcast_to(grid.x_m, x.shape), atol=1e-5)
    np.testing.assert_allclose(y, np.broadcast_to(grid.y_m[rows][:, None], y.shape), atol=1e-5)
    places = (np.array([-124.2, -67.0, -100.0, -81.0]), np.array([48.3, 44.8, 45.0, 25.2]))
    np.testing.assert_allclose(danger_grid.project(*places), USGS.transform(*places), atol=1e-5)


def test_corner_and_size_are_the_published_ones():
    transform = danger_grid.UsgsGrid().transform
    assert (transform.c, transform.f, transform.a, transform.e) == (-2050500, 752500, 1000, -1000)
    assert transform * (4587, 2889) == (2536500, -2136500)


def test_a_window_has_the_cells_of_the_whole():
    window = danger_grid.usgs_window(np.array([[-109.0, -106.0]]), np.array([[32.0], [35.0]]))
    whole = danger_grid.UsgsGrid()
    rows = slice(window.first_row, window.first_row + window.rows)
    columns = slice(window.first_column, window.first_column + window.columns)
    np.testing.assert_array_equal(window.places(slice(None)), whole.places(rows, columns))
    assert danger_grid.aligned_usgs_window(window.x_m, window.y_m, "EPSG:2163") == window


@pytest.mark.parametrize(
    ("shift_m", "crs", "named"),
    [(300.0, "EPSG:2163", "align"), (0.0, "EPSG:5070", "projection"), (0.0, "", "projection")],
)
def test_grids_that_do_not_align_are_refused(shift_m, crs, named):
    window = danger_grid.UsgsGrid(100, 200, 5, 6)
    with pytest.raises(DomainError, match=named) as caught:
        danger_grid.aligned_usgs_window(window.x_m + shift_m, window.y_m, crs)
    assert caught.value.field == "fuels"


def test_uneven_axes_and_places_off_the_grid_are_refused():
    with pytest.raises(DomainError) as caught:
        danger_grid.geographic_grid(np.array([33.0, 33.1, 33.5]), np.array([-108.0, -107.9]))
    assert caught.value.field == "latitude"
    with pytest.raises(DomainError) as caught:
        danger_grid.usgs_window(np.array([[146.0]]), np.array([[-37.0]]))
    assert caught.value.field == "grid"


@pytest.mark.parametrize("grid", [danger_grid.UsgsGrid(1800, 1200, 60, 70), None])
def test_windows_hold_every_cell_in_reach(grid):
    grid = grid or danger_grid.GeographicGrid(np.arange(33, 36, 0.05), np.arange(-109, -106, 0.05))
    longitude, latitude = np.broadcast_arrays(*grid.places(slice(None)))
    x, y = float(longitude[20, 30]), float(latitude[20, 30])
    near = 111195 * np.hypot((longitude - x) * np.cos(np.radians(y)), latitude - y) <= 12000
    rows, columns = grid.window(x, y, 12000)
    inside = np.zeros(grid.shape, dtype=bool)
    inside[rows, columns] = True
    assert near.sum() > 10 and not (near & ~inside).any()


def test_sampled_fuels_take_the_cell_that_holds_the_centre(make):
    given = fuels.fuels_from_dataset(make["fuels"](0.1))
    sampled = danger_run.on_grid(given, "usgs-1km-window")
    longitude, latitude = sampled.grid.places(slice(None))
    part = sampled.rows(slice(None))
    row, column = 150, 120
    y = int(np.abs(given.grid.latitude_deg - latitude[row, column]).argmin())
    x = int(np.abs(given.grid.longitude_deg - longitude[row, column]).argmin())
    assert part.greenness[row, column] == np.float32(given.greenness[y, x])
    outside = (longitude < -109) | (longitude > -106) | (latitude < 32) | (latitude > 35)
    assert (part.mask_code[outside] == 249).all() and (part.mask_code[~outside] != 249).all()
    assert danger_run.on_grid(given, "usgs-1km").grid == danger_grid.UsgsGrid()
    assert danger_run.on_grid(given, "fuels") is given
