"""Specular points: certified angles, coplanar, and the shortest path that an independent minimiser finds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from services.access.ellipsoid import SEMI_MAJOR_M, to_cartesian, to_geodetic, up_vector
from services.access.specular.points import specular_points
from services.access.specular.reflection import GRAZING, OCCULTED, SOLVED
from shared.errors import DomainError

Array = NDArray[np.float64]


def _pairs(count: int, seed: int, low_m: float = 350e3, high_m: float = 700e3) -> tuple[Array, Array]:
    """Random receivers in low orbits and transmitters at GNSS heights, all over the globe."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(2, count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    heights = np.stack([rng.uniform(low_m, high_m, count), rng.uniform(19e6, 24e6, count)])
    receiver, transmitter = directions * (SEMI_MAJOR_M + heights)[..., np.newaxis]
    return receiver, transmitter


def _angle_deg(a: Array, b: Array) -> Array:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)))


def test_every_point_is_certified_in_geometry_of_its_own() -> None:
    receiver, transmitter = _pairs(20000, 1)
    found = specular_points(receiver, transmitter)
    ok = found.status == SOLVED
    assert 0.4 < ok.mean() < 0.7
    point, r, t = found.position_m[ok], receiver[ok], transmitter[ok]
    latitude, longitude, height = to_geodetic(point)
    normal = up_vector(latitude, longitude)
    assert np.abs(height).max() < 1e-6
    incidence, reflection = _angle_deg(normal, t - point), _angle_deg(normal, r - point)
    assert np.abs(incidence - reflection).max() < 1e-6
    assert np.abs(incidence - found.incidence_deg[ok]).max() < 1e-6
    assert incidence.max() < 90.0
    triple = np.einsum("ij,ij->i", normal, np.cross(r - point, t - point))
    sine = triple / np.linalg.norm(r - point, axis=1) / np.linalg.norm(t - point, axis=1)
    assert np.abs(sine).max() < 1e-9  # coplanar: nothing of the normal leaves the plane of incidence
    assert np.allclose(found.rx_range_m[ok], np.linalg.norm(r - point, axis=1))
    assert np.allclose(found.tx_range_m[ok], np.linalg.norm(t - point, axis=1))


def test_the_path_is_the_shortest_an_independent_minimiser_finds() -> None:
    receiver, transmitter = _pairs(400, 2)
    found = specular_points(receiver, transmitter)
    rows = np.flatnonzero(found.status == SOLVED)[:30]
    for row in rows:
        r, t = receiver[row], transmitter[row]

        def path_m(angles: Array, r: Array = r, t: Array = t) -> float:
            point = to_cartesian(angles[0], angles[1])
            return float(np.linalg.norm(point - r) + np.linalg.norm(point - t))

        nadir = to_geodetic(r)
        start = np.array([float(np.clip(nadir[0], -85, 85)), float(nadir[1])])
        best = minimize(path_m, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-9, "maxiter": 4000})
        ours_m = found.rx_range_m[row] + found.tx_range_m[row]
        assert ours_m <= best.fun + 1e-6
        # the path is flat at its minimum: 1e-7 m in length is some metres over the ground
        assert np.linalg.norm(to_cartesian(best.x[0], best.x[1]) - found.position_m[row]) < 20.0


def test_a_sphere_would_be_kilometres_wrong() -> None:
    receiver, transmitter = _pairs(20000, 3, 500e3, 530e3)
    found = specular_points(receiver, transmitter)
    use = (found.status == SOLVED) & (found.incidence_deg < 60.0)
    sphere = np.array([_on_sphere(r, t) for r, t in zip(receiver[use][:400], transmitter[use][:400], strict=True)])
    latitude, longitude, _ = to_geodetic(found.position_m[use][:400])
    up = up_vector(latitude, longitude)
    offset = sphere - found.position_m[use][:400]
    horizontal_km = np.linalg.norm(offset - (offset * up).sum(axis=1, keepdims=True) * up, axis=1) / 1000.0
    assert 0.5 < np.median(horizontal_km) < 5.0
    assert 5.0 < horizontal_km.max() < 40.0


def _on_sphere(r: Array, t: Array) -> Array:
    """The specular point on a sphere of the equatorial radius, by bisection in the plane of R, T and the centre."""
    first = r / np.linalg.norm(r)
    second = t - (t @ first) * first
    second /= np.linalg.norm(second)
    gamma = float(np.arctan2(t @ second, t @ first))

    def zenith(x: Array, point: Array) -> float:
        towards = x - point
        return float(np.arccos(towards @ point / SEMI_MAJOR_M / np.linalg.norm(towards)))

    low, high = 0.0, gamma
    for _ in range(60):
        middle = 0.5 * (low + high)
        point = SEMI_MAJOR_M * (np.cos(middle) * first + np.sin(middle) * second)
        low, high = (middle, high) if zenith(r, point) < zenith(t, point) else (low, middle)
    return point


def test_geometries_known_by_symmetry() -> None:
    over_pole = np.array([[0.0, 0.0, 6.9e6]]), np.array([[0.0, 0.0, 2.66e7]])
    found = specular_points(*over_pole)
    assert found.status[0] == SOLVED and found.incidence_deg[0] < 1e-6
    assert abs(to_geodetic(found.position_m)[0][0] - 90.0) < 1e-6
    mirrored = specular_points(np.array([[6.9e6, 1e6, 0.0]]), np.array([[6.9e6, -1e6, 0.0]]))
    assert np.allclose(mirrored.position_m[0], [SEMI_MAJOR_M, 0.0, 0.0], atol=1e-3)


def test_occulted_and_grazing_are_told_apart() -> None:
    receiver, transmitter = _pairs(60000, 4)
    found = specular_points(receiver, transmitter)
    clearance_m = _clearance_m(receiver, transmitter)
    assert (clearance_m[found.status == OCCULTED] < 1.0).all()
    assert (clearance_m[found.status == SOLVED] > 0.0).all()
    assert (clearance_m[found.status == GRAZING] < 2000.0).all()
    assert (found.status == GRAZING).mean() < 1e-3
    assert np.isnan(found.position_m[found.status != SOLVED]).all()


def _clearance_m(r: Array, t: Array) -> Array:
    """Height of the straight line over the ellipsoid, in axes that make it a sphere; negative if it passes through."""
    scale = SEMI_MAJOR_M / np.array([6378137.0, 6378137.0, 6356752.314245])
    a, b = r * scale, t * scale
    along = b - a
    share = np.clip(-(a * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + share[:, np.newaxis] * along, axis=1) - SEMI_MAJOR_M)


def test_a_position_underground_is_refused_by_row() -> None:
    good = np.array([[7e6, 0.0, 0.0], [7e6, 0.0, 0.0]])
    with pytest.raises(DomainError, match="transmitter of row 1"):
        specular_points(good, np.array([[2e7, 1e6, 0.0], [6.3e6, 0.0, 0.0]]))
    with pytest.raises(DomainError, match="receiver of row 0"):
        specular_points(good * np.nan, good)


@pytest.mark.parametrize("height_m", [-400.0, 2500.0, 8800.0])
def test_points_at_a_height_are_certified_against_the_surface_there(height_m: float) -> None:
    """On the surface parallel to the ellipsoid: its normal is the geodetic one, its height the same everywhere."""
    receiver, transmitter = _pairs(4000, 6)
    found = specular_points(receiver, transmitter, height_m)
    ok = found.status == SOLVED
    point, r, t = found.position_m[ok], receiver[ok], transmitter[ok]
    latitude, longitude, height = to_geodetic(point)
    normal = up_vector(latitude, longitude)
    assert ok.sum() > 1500 and np.abs(height - height_m).max() < 1e-5
    assert np.abs(_angle_deg(normal, t - point) - _angle_deg(normal, r - point)).max() < 1e-6
    triple = np.einsum("ij,ij->i", normal, np.cross(r - point, t - point))
    assert np.abs(triple / found.rx_range_m[ok] / found.tx_range_m[ok]).max() < 1e-9
    for row in np.flatnonzero(ok)[:6]:
        path = found.rx_range_m[row] + found.tx_range_m[row]
        best = minimize(
            lambda a, r=receiver[row], t=transmitter[row]: float(
                np.linalg.norm(to_cartesian(a[0], a[1], height_m) - r)
                + np.linalg.norm(to_cartesian(a[0], a[1], height_m) - t)
            ),
            np.clip([float(x) for x in to_geodetic(receiver[row])[:2]], [-85, -180], [85, 180]),
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-9, "maxiter": 4000},
        )
        assert path <= best.fun + 1e-6


def test_a_higher_surface_moves_points_towards_the_receiver() -> None:
    receiver, transmitter = _pairs(2000, 8, 500e3, 530e3)
    low, high = specular_points(receiver, transmitter), specular_points(receiver, transmitter, 3000.0)
    both = (low.status == SOLVED) & (high.status == SOLVED) & (low.incidence_deg < 60)
    nearer = low.rx_range_m[both] - high.rx_range_m[both]
    slant = 3000.0 / np.cos(np.radians(low.incidence_deg[both]))
    assert (nearer > 0.5 * slant).all() and (nearer < 1.1 * slant).all()


def test_a_start_from_nearby_leads_to_the_same_point() -> None:
    receiver, transmitter = _pairs(3000, 9)
    found = specular_points(receiver, transmitter)
    ok = found.status == SOLVED
    start = found.position_m[ok] + np.random.default_rng(1).normal(scale=20e3, size=(int(ok.sum()), 3))
    again = specular_points(receiver[ok], transmitter[ok], 0.0, start)
    both = again.status == SOLVED
    assert both.mean() > 0.99
    assert np.abs(again.position_m[both] - found.position_m[ok][both])[found.incidence_deg[ok][both] < 80].max() < 1e-5
