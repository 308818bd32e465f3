"""The compiled core of access prediction: the shortest reflected path over WGS84, followed through time, with its gain.

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
# what became of every pair and instant looked at: the columns of ``follow_all``'s counts
KEPT, COUNT_OCCULTED, BEYOND_LIMIT, UNCERTIFIED = 0, 1, 2, 3
MAX_ITERATIONS = 40
MAX_STEP_M = 300_000.0
# Newton's error after a step of s metres is about s^2 / 500 km
LAST_STEP_M = 1e-3
LAST_FOLLOWED_STEP_M = 0.1
ANGLE_LIMIT_DEG = 1e-6
COLUMNS = 10

_A2 = SEMI_MAJOR_M**2
_B2 = SEMI_MINOR_M**2


@njit(cache=True, nogil=True)
def solve_all(receiver: Array, transmitter: Array, start: Array, height: float, table: Array) -> None:
    """Rows: x, y, z, incidence, mismatch, ranges to R and T, status. ``start`` has a first guess a row, or no row."""
    for row in range(len(receiver)):
        r, t = receiver[row], transmitter[row]
        if occulted(r[0], r[1], r[2], t[0], t[1], t[2], height):
            table[row, 7] = OCCULTED
            continue
        if len(start) > 0:
            x, y, z = start[row, 0], start[row, 1], start[row, 2]
        else:
            x, y, z = first_guess(r[0], r[1], r[2], t[0], t[1], t[2])
        point = solve(x, y, z, r[0], r[1], r[2], t[0], t[1], t[2], height, LAST_STEP_M)
        table[row, 7] = SOLVED if point[7] else GRAZING
        if point[7]:
            table[row, 0], table[row, 1], table[row, 2], table[row, 3] = point[0], point[1], point[2], point[3]
            table[row, 4], table[row, 5], table[row, 6] = point[4], point[5], point[6]


@njit(cache=True, nogil=True)
def occulted(rx: float, ry: float, rz: float, tx: float, ty: float, tz: float, height: float) -> bool:
    """Whether the Earth stands between two points: nearest approach in axes that make it a unit sphere.

    The surface ``height`` metres up is taken for the ellipsoid of axes that much longer (off by 0.2 % of the height).
    """
    a, b = SEMI_MAJOR_M + height, SEMI_MINOR_M + height
    x, y, z = rx / a, ry / a, rz / b
    dx, dy, dz = tx / a - x, ty / a - y, tz / b - z
    share = -(x * dx + y * dy + z * dz) / (dx * dx + dy * dy + dz * dz)
    share = min(max(share, 0.0), 1.0)
    x, y, z = x + share * dx, y + share * dy, z + share * dz
    return x * x + y * y + z * z < 1.0


@njit(cache=True, nogil=True)
def first_guess(rx: float, ry: float, rz: float, tx: float, ty: float, tz: float) -> tuple[float, float, float]:
    """A point under the straight line, at the share of it that the two heights give for a plane."""
    height_r = np.sqrt(rx * rx + ry * ry + rz * rz) - SEMI_MAJOR_M + 30_000.0
    height_t = np.sqrt(tx * tx + ty * ty + tz * tz) - SEMI_MAJOR_M + 30_000.0
    share = height_r / (height_r + height_t)
    return rx + share * (tx - rx), ry + share * (ty - ry), rz + share * (tz - rz)


@njit(cache=True, nogil=True)
def solve(
    x: float,
    y: float,
    z: float,
    rx: float,
    ry: float,
    rz: float,
    tx: float,
    ty: float,
    tz: float,
    height: float,
    last_step: float,
) -> tuple[float, float, float, float, float, float, float, bool]:
    """From a start near the surface: the point (m), incidence, mismatch (rad), ranges to R and T (m), certified.

    The surface lies ``height`` metres over WGS84 along its normal n. With u the unit vectors from the point to R and
    T, the path's gradient in the tangent plane is -(u_r + u_t), and its second derivative the sum of (I - u u^T)/range
    plus (cos i_r + cos i_t) times the curvature: positive definite wherever the point sees both, so Newton's step
    descends; steps are cut at 300 km for far starts.
    """
    scale = 1.0 / np.sqrt((x * x + y * y) / _A2 + z * z / _B2)
    x, y, z = x * scale, y * scale, z * scale  # from here the foot on WGS84; the point is (px, py, pz)
    step = 1e9
    for _ in range(MAX_ITERATIONS):
        nx, ny, nz, _n = _unit(x / _A2, y / _A2, z / _B2)
        px, py, pz = x + height * nx, y + height * ny, z + height * nz
        ux, uy, uz, rr = _unit(rx - px, ry - py, rz - pz)
        vx, vy, vz, rt = _unit(tx - px, ty - py, tz - pz)
        across = np.sqrt(nx * nx + ny * ny)
        ex, ey = (-ny / across, nx / across) if across > 1e-12 else (0.0, 1.0)
        kx, ky, kz = -nz * ey, nz * ex, nx * ey - ny * ex  # north = n x e
        ue, un = ux * ex + uy * ey, ux * kx + uy * ky + uz * kz
        ve, vn = vx * ex + vy * ey, vx * kx + vy * ky + vz * kz
        w2 = 1.0 - ECCENTRICITY_SQUARED * nz * nz
        foot_e = np.sqrt(w2) / SEMI_MAJOR_M
        foot_n = foot_e * w2 / (1.0 - ECCENTRICITY_SQUARED)
        wider_e, wider_n = 1.0 + height * foot_e, 1.0 + height * foot_n
        lift = max((ux + vx) * nx + (uy + vy) * ny + (uz + vz) * nz, 1e-3)
        hee = (1.0 - ue * ue) / rr + (1.0 - ve * ve) / rt + lift * foot_e / wider_e
        hnn = (1.0 - un * un) / rr + (1.0 - vn * vn) / rt + lift * foot_n / wider_n
        hen = -(ue * un / rr + ve * vn / rt)
        ge, gn = ue + ve, un + vn
        determinant = hee * hnn - hen * hen
        de, dn = (hnn * ge - hen * gn) / determinant, (hee * gn - hen * ge) / determinant
        step = np.sqrt(de * de + dn * dn)
        if step > MAX_STEP_M:
            de, dn = de * MAX_STEP_M / step, dn * MAX_STEP_M / step
        de, dn = de / wider_e, dn / wider_n
        x, y, z = x + de * ex + dn * kx, y + de * ey + dn * ky, z + dn * kz
        scale = 1.0 / np.sqrt((x * x + y * y) / _A2 + z * z / _B2)
        x, y, z = x * scale, y * scale, z * scale
        if step < last_step:
            break
    nx, ny, nz, _n = _unit(x / _A2, y / _A2, z / _B2)
    px, py, pz = x + height * nx, y + height * ny, z + height * nz
    ux, uy, uz, rr = _unit(rx - px, ry - py, rz - pz)
    vx, vy, vz, rt = _unit(tx - px, ty - py, tz - pz)
    incidence = _angle(nx, ny, nz, vx, vy, vz)
    mismatch = abs(incidence - _angle(nx, ny, nz, ux, uy, uz))
    seen = ux * nx + uy * ny + uz * nz > 0.0 and vx * nx + vy * ny + vz * nz > 0.0
    certified = seen and step < last_step and mismatch < np.radians(ANGLE_LIMIT_DEG)
    return px, py, pz, incidence, mismatch, rr, rt, certified


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
def gain_dbi(forward: float, starboard: float, nadir: float, table: Array) -> float:
    """Gain (dBi) along a unit vector in body components: bilinear in a table of its forward and starboard cosines.

    ``table`` (n, n) spans -1..1 both ways; the first entry is the gain of what looks up.
    """
    if nadir <= 0.0:
        return table[0, 0]
    last = len(table) - 1
    u, v = (forward + 1.0) * 0.5 * last, (starboard + 1.0) * 0.5 * last
    i, j = min(max(int(u), 0), last - 1), min(max(int(v), 0), last - 1)
    u, v = u - i, v - j
    fore = (1.0 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
    aft = (1.0 - v) * table[i, j] + v * table[i, j + 1]
    return u * fore + (1.0 - u) * aft


@njit(cache=True, nogil=True)
def gain_towards(axes: Array, dx: float, dy: float, dz: float, table: Array) -> float:
    return gain_dbi(
        axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz,
        axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz,
        axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz,
        table,
    )


@njit(cache=True, nogil=True)
def gains_towards(axes: Array, receiver: Array, point: Array, table: Array, gain: Array) -> None:
    """Gains (n,) from receivers towards points (n, 3) with body axes (n, 3, 3)."""
    for k in range(len(point)):
        dx, dy, dz, _d = _unit(point[k, 0] - receiver[k, 0], point[k, 1] - receiver[k, 1], point[k, 2] - receiver[k, 2])
        gain[k] = gain_towards(axes[k], dx, dy, dz, table)


@njit(cache=True, nogil=True)
def follow_all(
    receiver: Array,
    axes: Array,
    cubics: Array,
    nodes_per_step: float,
    first_step: int,
    wanted: Flags,
    least_cosine: float,
    max_incidence: float,
    height: float,
    gains: Array,
    channels: int,
    counts: NDArray[np.int64],
) -> tuple[Array, int]:
    """Rows: time, transmitter, x, y, z, incidence, mismatch, gain, range to receiver, range to transmitter.

    The last is negative where the row is one of the nominal channels. Each pair starts from where its last three points
    lead, which leaves one or two iterations; a fresh start is tried where that fails. ``counts`` (4,) is added to.
    """
    transmitters, intervals = cubics.shape[0], cubics.shape[1]
    table = np.empty((4096, COLUMNS))
    used = 0
    recent = np.zeros((transmitters, 9))
    depth = np.zeros(transmitters, dtype=np.int64)
    for step in range(len(receiver)):
        if not wanted[step]:
            for j in range(transmitters):
                depth[j] = 0
            continue
        rx, ry, rz = receiver[step, 0], receiver[step, 1], receiver[step, 2]
        r_length = np.sqrt(rx * rx + ry * ry + rz * rz)
        node = min(int((first_step + step) * nodes_per_step), intervals - 1)
        share = (first_step + step) * nodes_per_step - node
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
                counts[COUNT_OCCULTED if occulted(rx, ry, rz, tx, ty, tz, height) else BEYOND_LIMIT] += 1
                continue
            point = _follow(recent[j], depth[j], rx, ry, rz, tx, ty, tz, height)
            if not point[7]:
                depth[j] = 0
                counts[COUNT_OCCULTED if occulted(rx, ry, rz, tx, ty, tz, height) else UNCERTIFIED] += 1
                continue
            for k in range(6):
                recent[j, 8 - k] = recent[j, 5 - k]
            recent[j, 0], recent[j, 1], recent[j, 2] = point[0], point[1], point[2]
            depth[j] = min(depth[j] + 1, 3)
            if point[3] > max_incidence:
                counts[BEYOND_LIMIT] += 1
                continue
            rr = point[5]
            out = table[used]
            out[0], out[1], out[2], out[3], out[4] = first_step + step, j, point[0], point[1], point[2]
            out[5], out[6], out[8], out[9] = point[3], point[4], rr, point[6]
            out[7] = gain_towards(axes[step], (point[0] - rx) / rr, (point[1] - ry) / rr, (point[2] - rz) / rr, gains)
            used += 1
        counts[KEPT] += used - first
        _mark_nominal(table, first, used, channels)
    return table, used


@njit(cache=True, nogil=True)
def _follow(
    recent: Array, depth: int, rx: float, ry: float, rz: float, tx: float, ty: float, tz: float, height: float
) -> tuple[float, float, float, float, float, float, float, bool]:
    if depth > 0:
        x, y, z = recent[0], recent[1], recent[2]
        if depth == 2:
            x, y, z = 2.0 * x - recent[3], 2.0 * y - recent[4], 2.0 * z - recent[5]
        elif depth == 3:
            x += 2.0 * x - 3.0 * recent[3] + recent[6]
            y += 2.0 * y - 3.0 * recent[4] + recent[7]
            z += 2.0 * z - 3.0 * recent[5] + recent[8]
        point = solve(x, y, z, rx, ry, rz, tx, ty, tz, height, LAST_FOLLOWED_STEP_M)
        if point[7]:
            return point
    x, y, z = first_guess(rx, ry, rz, tx, ty, tz)
    return solve(x, y, z, rx, ry, rz, tx, ty, tz, height, LAST_STEP_M)


@njit(cache=True, nogil=True)
def _mark_nominal(table: Array, first: int, end: int, channels: int) -> None:
    """Negate the last column of the rows of highest gain in [first, end); of equals the earlier transmitter."""
    for _ in range(min(channels, end - first)):
        best = -1
        for k in range(first, end):
            if table[k, 9] > 0.0 and (best < 0 or table[k, 7] > table[best, 7]):
                best = k
        table[best, 9] = -table[best, 9]
