"""Specular points on the WGS84 ellipsoid: where the path transmitter - surface - receiver is shortest.

The transmitter stands where it is at the receiver's time: the 70 to 90 ms of flight (250 m of its way, some 10 m at the
specular point) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.access.ellipsoid import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, SEMI_MINOR_M
from shared.errors import DomainError

Array = NDArray[np.float64]

SOLVED, OCCULTED, GRAZING = 0, 1, 2
MAX_ITERATIONS = 40
MAX_STEP_M = 300_000.0
LAST_STEP_M = 1e-3  # convergence is quadratic: the step after one of 1 mm is below rounding
ANGLE_LIMIT_DEG = 1e-6

_A2 = SEMI_MAJOR_M**2
_B2 = SEMI_MINOR_M**2


@dataclass(frozen=True)
class SpecularPoints:
    """Specular points of n pairs, Earth-fixed; NaN where ``status`` is not SOLVED.

    ``incidence_deg`` from the ellipsoid's normal to the transmitter, ``mismatch_deg`` the difference to the angle of
    reflection; ranges in metres. ``status``: SOLVED, OCCULTED (the Earth stands between), GRAZING (not
    certified: in practice only where the straight line passes within some 1 km of the surface, incidence over 89.9).
    """

    position_m: Array
    incidence_deg: Array
    mismatch_deg: Array
    rx_range_m: Array
    tx_range_m: Array
    status: NDArray[np.int8]


def specular_points(receiver_m: Array, transmitter_m: Array) -> SpecularPoints:
    """Specular points of pairs of Earth-fixed positions (n, 3) in metres, surface height 0 on WGS84.

    Newton's method on the length of the path over the ellipsoid, in the tangent plane, second derivatives with the
    ellipsoid's curvature. A point is SOLVED only if both satellites stand above its horizon and the angles of incidence
    and reflection agree within 1e-6 degrees. Raises DomainError for a position on or under the surface.
    """
    receiver, transmitter = (
        np.ascontiguousarray(x, dtype=np.float64).reshape(-1, 3) for x in (receiver_m, transmitter_m)
    )
    for name, position in (("receiver", receiver), ("transmitter", transmitter)):
        inside = ~((position**2 / (_A2, _A2, _B2)).sum(axis=1) > 1.0)
        if inside.any():
            row = int(np.flatnonzero(inside)[0])
            raise DomainError(
                f"The {name} of row {row} is not above the ellipsoid: {position[row].tolist()} m.",
                field=name,
                value=position[row].tolist(),
                accepted="Earth-fixed positions in metres outside WGS84",
            )
    table = np.full((len(receiver), 8), np.nan)
    _solve_all(receiver, transmitter, table)
    return SpecularPoints(
        table[:, 0:3],
        np.degrees(table[:, 3]),
        np.degrees(table[:, 4]),
        table[:, 5],
        table[:, 6],
        table[:, 7].astype(np.int8),
    )


@njit(cache=True, nogil=True)
def _solve_all(receiver: Array, transmitter: Array, table: Array) -> None:
    for row in range(len(receiver)):
        r, t = receiver[row], transmitter[row]
        if occulted(r[0], r[1], r[2], t[0], t[1], t[2]):
            table[row, 7] = OCCULTED
            continue
        x, y, z = first_guess(r[0], r[1], r[2], t[0], t[1], t[2])
        point = solve(x, y, z, r[0], r[1], r[2], t[0], t[1], t[2])
        table[row, 7] = SOLVED if point[7] else GRAZING
        if point[7]:
            table[row, 0], table[row, 1], table[row, 2], table[row, 3] = point[0], point[1], point[2], point[3]
            table[row, 4], table[row, 5], table[row, 6] = point[4], point[5], point[6]


@njit(cache=True, nogil=True)
def occulted(rx: float, ry: float, rz: float, tx: float, ty: float, tz: float) -> bool:
    """Whether the ellipsoid stands between two points: nearest approach in axes that make it a unit sphere."""
    a, b = SEMI_MAJOR_M, SEMI_MINOR_M
    x, y, z = rx / a, ry / a, rz / b
    dx, dy, dz = tx / a - x, ty / a - y, tz / b - z
    share = -(x * dx + y * dy + z * dz) / (dx * dx + dy * dy + dz * dz)
    share = min(max(share, 0.0), 1.0)
    x, y, z = x + share * dx, y + share * dy, z + share * dz
    return x * x + y * y + z * z < 1.0


@njit(cache=True, nogil=True)
def first_guess(rx: float, ry: float, rz: float, tx: float, ty: float, tz: float) -> tuple[float, float, float]:
    """A surface point under the straight line, at the share of it that the two heights give for a plane."""
    height_r = np.sqrt(rx * rx + ry * ry + rz * rz) - SEMI_MAJOR_M + 30_000.0
    height_t = np.sqrt(tx * tx + ty * ty + tz * tz) - SEMI_MAJOR_M + 30_000.0
    share = height_r / (height_r + height_t)
    x, y, z = rx + share * (tx - rx), ry + share * (ty - ry), rz + share * (tz - rz)
    scale = 1.0 / np.sqrt((x * x + y * y) / _A2 + z * z / _B2)
    return x * scale, y * scale, z * scale


@njit(cache=True, nogil=True)
def solve(
    x: float, y: float, z: float, rx: float, ry: float, rz: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float, float, float, float, float, bool]:
    """From a start on the surface: the point (m), incidence, mismatch (rad), ranges to R and T (m), certified.

    With u the unit vectors from the point to R and T, the path's gradient in the plane is -(u_r + u_t), and its second
    derivative the sum of (I - u u^T)/range plus (cos i_r + cos i_t) times the curvature: positive definite wherever the
    point sees both, so Newton's step descends; steps are cut at 300 km for far starts.
    """
    step = 1e9
    for _ in range(MAX_ITERATIONS):
        nx, ny, nz = _normal(x, y, z)
        ux, uy, uz, rr = _unit(rx - x, ry - y, rz - z)
        vx, vy, vz, rt = _unit(tx - x, ty - y, tz - z)
        across = np.sqrt(nx * nx + ny * ny)
        ex, ey = (-ny / across, nx / across) if across > 1e-12 else (0.0, 1.0)
        kx, ky, kz = -nz * ey, nz * ex, nx * ey - ny * ex  # north = n x e
        ue, un = ux * ex + uy * ey, ux * kx + uy * ky + uz * kz
        ve, vn = vx * ex + vy * ey, vx * kx + vy * ky + vz * kz
        w2 = 1.0 - ECCENTRICITY_SQUARED * nz * nz
        curvature_e = np.sqrt(w2) / SEMI_MAJOR_M
        curvature_n = curvature_e * w2 / (1.0 - ECCENTRICITY_SQUARED)
        lift = max((ux + vx) * nx + (uy + vy) * ny + (uz + vz) * nz, 1e-3)
        hee = (1.0 - ue * ue) / rr + (1.0 - ve * ve) / rt + lift * curvature_e
        hnn = (1.0 - un * un) / rr + (1.0 - vn * vn) / rt + lift * curvature_n
        hen = -(ue * un / rr + ve * vn / rt)
        ge, gn = ue + ve, un + vn
        determinant = hee * hnn - hen * hen
        de, dn = (hnn * ge - hen * gn) / determinant, (hee * gn - hen * ge) / determinant
        step = np.sqrt(de * de + dn * dn)
        if step > MAX_STEP_M:
            de, dn = de * MAX_STEP_M / step, dn * MAX_STEP_M / step
        x, y, z = x + de * ex + dn * kx, y + de * ey + dn * ky, z + dn * kz
        scale = 1.0 / np.sqrt((x * x + y * y) / _A2 + z * z / _B2)
        x, y, z = x * scale, y * scale, z * scale
        if step < LAST_STEP_M:
            break
    nx, ny, nz = _normal(x, y, z)
    ux, uy, uz, rr = _unit(rx - x, ry - y, rz - z)
    vx, vy, vz, rt = _unit(tx - x, ty - y, tz - z)
    incidence = _angle(nx, ny, nz, vx, vy, vz)
    mismatch = abs(incidence - _angle(nx, ny, nz, ux, uy, uz))
    seen = ux * nx + uy * ny + uz * nz > 0.0 and vx * nx + vy * ny + vz * nz > 0.0
    certified = seen and step < LAST_STEP_M and mismatch < np.radians(ANGLE_LIMIT_DEG)
    return x, y, z, incidence, mismatch, rr, rt, certified


@njit(cache=True, nogil=True)
def _normal(x: float, y: float, z: float) -> tuple[float, float, float]:
    nx, ny, nz, _ = _unit(x / _A2, y / _A2, z / _B2)
    return nx, ny, nz


@njit(cache=True, nogil=True)
def _unit(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length, length


@njit(cache=True, nogil=True)
def _angle(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Angle of two unit vectors; from sine and cosine, since the arc cosine loses half its digits near zero."""
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), ax * bx + ay * by + az * bz)
