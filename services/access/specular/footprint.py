"""The footprint of a reflection: the first Fresnel zone on the ground, and how far it moves while an image is taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.access.ellipsoid import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, SEMI_MINOR_M

Array = NDArray[np.float64]

WAVELENGTH_M = 299792458.0 / 1575.42e6  # L1, E1 and B1C
IMAGE_S = 1.0


@dataclass(frozen=True)
class Footprints:
    """Footprints (n,) in the tangent plane: all x with |L^T (x - s m)| <= 1 for an s in [0, 1].

    ``shape`` (n, 5): L11, L21, L22 (1/m; the Fresnel zone's lower Cholesky factor, east and north) and m, the motion
    of the point in one image (m, east and north).
    """

    shape: Array

    def semi_axes_m(self) -> Array:
        """Semi-axes (n, 2) of the Fresnel zone, the larger first, metres."""
        l11, l21, l22 = self.shape[:, 0], self.shape[:, 1], self.shape[:, 2]
        factor = np.zeros((len(l11), 2, 2))
        factor[:, 0, 0], factor[:, 1, 0], factor[:, 1, 1] = l11, l21, l22
        return np.asarray(1.0 / np.linalg.svd(factor, compute_uv=False)[:, ::-1])


def footprints(
    point_m: Array,
    receiver: tuple[Array, Array],
    transmitter: tuple[Array, Array],
    surface_height_m: float = 0.0,
    wavelength_m: float = WAVELENGTH_M,
    image_s: float = IMAGE_S,
) -> Footprints:
    """Footprints of specular points (n, 3) for receiver and transmitter states ((n, 3) m, (n, 3) m/s), Earth-fixed.

    First Fresnel zone: where the path is at most half a wavelength longer than at the point, from the path's second
    derivative H over the curved surface, x^T H x <= wavelength. On a plane that is sqrt(wavelength Rr Rt / (Rr + Rt))
    across, divided by the cosine of incidence along (Beckmann & Spizzichino 1963). The point's velocity is the one that
    keeps the path's gradient zero: H x' = sum over both of the tangential part of (I - u u^T) v / range.
    """
    east, north, curvature = _tangent_frame(point_m, surface_height_m)
    hessian = np.zeros((len(point_m), 2, 2))
    driving = np.zeros((len(point_m), 2))
    lift = np.zeros(len(point_m))
    up = np.cross(east, north)
    for position, velocity in (receiver, transmitter):
        towards = position - point_m
        distance = np.linalg.norm(towards, axis=1)
        unit = towards / distance[:, np.newaxis]
        flat = np.stack([np.sum(unit * east, axis=1), np.sum(unit * north, axis=1)], axis=1)
        hessian += (np.eye(2) - flat[:, :, np.newaxis] * flat[:, np.newaxis, :]) / distance[:, np.newaxis, np.newaxis]
        lift += np.sum(unit * up, axis=1)
        across = velocity - np.sum(velocity * unit, axis=1, keepdims=True) * unit
        moving = np.stack([np.sum(across * east, axis=1), np.sum(across * north, axis=1)], axis=1)
        driving += moving / distance[:, np.newaxis]
    hessian[:, 0, 0] += lift * curvature[0]
    hessian[:, 1, 1] += lift * curvature[1]
    motion = np.linalg.solve(hessian, driving[:, :, np.newaxis])[:, :, 0] * image_s
    factor = np.linalg.cholesky(hessian / wavelength_m) if len(hessian) else hessian
    return Footprints(np.column_stack([factor[:, 0, 0], factor[:, 1, 0], factor[:, 1, 1], motion]))


def _tangent_frame(point_m: Array, height_m: float) -> tuple[Array, Array, tuple[Array, Array]]:
    """East and north (n, 3), and the surface's curvature (1/m) along each."""
    squares = np.array([SEMI_MAJOR_M + height_m, SEMI_MAJOR_M + height_m, SEMI_MINOR_M + height_m]) ** 2
    up = point_m / squares
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    across = np.hypot(up[:, 0], up[:, 1])
    east = np.zeros_like(up)
    at_pole = across < 1e-12
    safe = np.where(at_pole, 1.0, across)
    east[:, 0], east[:, 1] = np.where(at_pole, 0.0, -up[:, 1] / safe), np.where(at_pole, 1.0, up[:, 0] / safe)
    w2 = 1.0 - ECCENTRICITY_SQUARED * up[:, 2] ** 2
    along_east = np.sqrt(w2) / SEMI_MAJOR_M
    along_north = along_east * w2 / (1.0 - ECCENTRICITY_SQUARED)
    curvature = along_east / (1.0 + height_m * along_east), along_north / (1.0 + height_m * along_north)
    return east, np.cross(up, east), curvature
