"""The grid of a fire: zones in both hemispheres, the antimeridian, limits."""

import numpy as np
import pytest

from services.arrival.grid import make_grid, utm_epsg
from shared.errors import DomainError


@pytest.mark.parametrize(
    ("lon", "lat", "epsg"),
    [(-107.9, 33.3, 32613), (-118.0, 34.2, 32611), (146.5, -37.0, 32755), (15.0, -9.0, 32733), (179.9, 66.0, 32660)],
)
def test_zone_matches_the_published_zones(lon: float, lat: float, epsg: int) -> None:
    assert utm_epsg(np.array([lon]), np.array([lat])) == epsg


def test_a_fire_across_the_antimeridian_stays_together() -> None:
    lon, lat = np.array([179.95, -179.95, 179.99]), np.array([66.0, 66.0, 66.0])
    grid = make_grid(lon, lat, 500.0, 5.0)
    x, y = grid.local_km(lon, lat)
    # 0.1 degrees of longitude at 66 N (the grid is turned against the parallel there)
    assert np.hypot(np.ptp(x), np.ptp(y)) == pytest.approx(0.1 * 111.32 * np.cos(np.radians(66)), rel=0.01)
    assert max(grid.shape) < 60


def test_local_coordinates_are_kilometres_from_the_centre_and_come_back() -> None:
    lon, lat = np.array([-107.9, -107.7]), np.array([33.3, 33.4])
    grid = make_grid(lon, lat, 250.0, 3.0)
    x, y = grid.local_km(lon, lat)
    back = grid.degrees((x + grid.origin_km[0]) * 1e3, (y + grid.origin_km[1]) * 1e3)
    np.testing.assert_allclose(back[0], lon, atol=1e-8)
    np.testing.assert_allclose(back[1], lat, atol=1e-8)
    rows, columns = grid.shape
    assert (np.abs(x) < columns * 0.125).all() and (np.abs(y) < rows * 0.125).all()


@pytest.mark.parametrize(("lon", "lat"), [(np.nan, 10.0), (10.0, 86.0), (10.0, -85.0)])
def test_positions_without_a_utm_zone_are_refused(lon: float, lat: float) -> None:
    with pytest.raises(DomainError) as error:
        utm_epsg(np.array([lon]), np.array([lat]))
    assert error.value.field == "geometry"


def test_a_grid_of_too_many_cells_is_refused_with_the_field_to_change() -> None:
    with pytest.raises(DomainError) as error:
        make_grid(np.array([10.0, 14.0]), np.array([40.0, 44.0]), 30.0, 10.0)
    assert error.value.field == "cell_m"
