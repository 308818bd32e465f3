"""The compiled core of access prediction: the shortest reflected path on WGS84, followed through time, with its gain.

All compiled functions that call each other stand in this one file: Numba renews its cache when the file of a function
changes, and not when another file does that it calls into.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.access.ellipsoid import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, SEMI_MINOR_M

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SOLVED, OCCULTED, GRAZING = 0, 1, 2
MAX_ITERATIONS = 40
MAX_STEP_M = 300_000.0
LAST_STEP_M = 1e-3  # convergence is quadratic: the step after one of 1 mm is below rounding
ANGLE_LIMIT_DEG = 1e-6
NOMINAL_CHANNELS = 4  # CYGNSS records four delay-Doppler maps at a time
COLUMNS = 10

_A2 = SEMI_MAJOR_M**2
_B2 = SEMI_MINOR_M**2


@njit(cache=True, nogil=True)
def solve_all(receiver: Array, transmitter: Array, table: Array) -> None:
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


@njit(cache=True, nogil=True)
def beam_gain_dbi(forward: float, starboard: float, nadir: float, parameters: Array) -> float:
    """The better beam's gain (dBi) along a unit vector given in body components.

    The lobe nearer the direction is the one on its side, so only that one is evaluated.
    """
    peak, floor, off_nadir, across_width, along_width = parameters
    cosine, sine = np.cos(off_nadir), np.sin(off_nadir)
    side = abs(starboard)
    along_axis = cosine * nadir + sine * side
    across = cosine * side - sine * nadir
    off_axis = np.sqrt(across * across + forward * forward)
    scale = np.arctan2(off_axis, along_axis) / max(off_axis, 1e-300)
    gain = peak - 12.0 * ((across * scale / across_width) ** 2 + (forward * scale / along_width) ** 2)
    return max(gain, floor)


@njit(cache=True, nogil=True)
def follow_all(
    receiver: Array,
    axes: Array,
    cubics: Array,
    nodes_per_step: float,
    wanted: Flags,
    least_cosine: float,
    max_incidence: float,
    beams: Array,
) -> tuple[Array, int, int]:
    """Rows: time, transmitter, x, y, z, incidence, mismatch, gain, range to receiver, range to transmitter.

    The last is negative where the row is one of the four nominal channels. Each pair starts from its point of the step
    before, moved on as in that step, which leaves two iterations; a fresh start is tried where that fails.
    """
    transmitters, intervals = cubics.shape[0], cubics.shape[1]
    table = np.empty((4096, COLUMNS))
    used, grazing = 0, 0
    recent = np.zeros((transmitters, 6))
    depth = np.zeros(transmitters, dtype=np.int64)
    for step in range(len(receiver)):
        if not wanted[step]:
            for j in range(transmitters):
                depth[j] = 0
            continue
        rx, ry, rz = receiver[step, 0], receiver[step, 1], receiver[step, 2]
        r_length = np.sqrt(rx * rx + ry * ry + rz * rz)
        node = min(int(step * nodes_per_step), intervals - 1)
        share = step * nodes_per_step - node
        if used + transmitters > len(table):
            larger = np.empty((2 * len(table) + transmitters, COLUMNS))
            for row in range(used):  # plain loops: slice assignments triple the compiler's time
                for column in range(COLUMNS):
                    larger[row, column] = table[row, column]
            table = larger
        first = used
        for j in range(transmitters):
            c = cubics[j, node]
            tx = c[0, 0] + share * (c[1, 0] + share * (c[2, 0] + share * c[3, 0]))
            ty = c[0, 1] + share * (c[1, 1] + share * (c[2, 1] + share * c[3, 1]))
            tz = c[0, 2] + share * (c[1, 2] + share * (c[2, 2] + share * c[3, 2]))
            dot = rx * tx + ry * ty + rz * tz
            if dot < least_cosine * r_length * np.sqrt(tx * tx + ty * ty + tz * tz):
                depth[j] = 0
                continue
            point = _follow(recent[j], depth[j], rx, ry, rz, tx, ty, tz)
            if not point[7]:
                depth[j] = 0
                grazing += not occulted(rx, ry, rz, tx, ty, tz)
                continue
            recent[j, 3], recent[j, 4], recent[j, 5] = recent[j, 0], recent[j, 1], recent[j, 2]
            recent[j, 0], recent[j, 1], recent[j, 2] = point[0], point[1], point[2]
            depth[j] = min(depth[j] + 1, 2)
            if point[3] > max_incidence:
                continue
            dx, dy, dz = (point[0] - rx) / point[5], (point[1] - ry) / point[5], (point[2] - rz) / point[5]
            a = axes[step]
            gain = beam_gain_dbi(
                a[0, 0] * dx + a[0, 1] * dy + a[0, 2] * dz,
                a[1, 0] * dx + a[1, 1] * dy + a[1, 2] * dz,
                a[2, 0] * dx + a[2, 1] * dy + a[2, 2] * dz,
                beams,
            )
            out = table[used]
            out[0], out[1], out[2], out[3], out[4] = step, j, point[0], point[1], point[2]
            out[5], out[6], out[7], out[8], out[9] = point[3], point[4], gain, point[5], point[6]
            used += 1
        _mark_nominal(table, first, used)
    return table, used, grazing


@njit(cache=True, nogil=True)
def _follow(
    recent: Array, depth: int, rx: float, ry: float, rz: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float, float, float, float, float, bool]:
    x, y, z = 2.0 * recent[0] - recent[3], 2.0 * recent[1] - recent[4], 2.0 * recent[2] - recent[5]
    if depth == 1:
        x, y, z = recent[0], recent[1], recent[2]
    for attempt in range(2):
        if depth == 0 or attempt == 1:
            x, y, z = first_guess(rx, ry, rz, tx, ty, tz)
        point = solve(x, y, z, rx, ry, rz, tx, ty, tz)
        if point[7] or depth == 0:
            break
    return point


@njit(cache=True, nogil=True)
def _mark_nominal(table: Array, first: int, end: int) -> None:
    """Negate the last column of the four rows of highest gain in [first, end); of equals the earlier transmitter."""
    for _ in range(min(NOMINAL_CHANNELS, end - first)):
        best = -1
        for k in range(first, end):
            if table[k, 9] > 0.0 and (best < 0 or table[k, 7] > table[best, 7]):
                best = k
        table[best, 9] = -table[best, 9]
