"""Specular tracks of one receiver: every point within the incidence limit, its gain, and the four nominal channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.access.antenna import BeamPair, beam_gain_dbi, body_axes
from services.access.ellipsoid import SEMI_MINOR_M
from services.access.ephemeris import Ephemeris
from services.access.specular import first_guess, occulted, solve

Array = NDArray[np.float64]

NOMINAL_CHANNELS = 4  # CYGNSS records four delay-Doppler maps at a time
NORMAL_MARGIN_RAD = np.radians(
    1.0
)  # normal and radius differ by 0.19 degrees, which moves a point by twice that at most
COLUMNS = 10


@dataclass(frozen=True)
class Cap:
    """A part of the globe: all within ``radius_rad`` of a unit vector, seen from the Earth's centre."""

    centre: Array
    radius_rad: float

    @classmethod
    def around(cls, position_m: Array, margin_m: float = 0.0) -> Cap:
        """The cap about the mean direction of positions (n, 3), widened by ``margin_m`` over the ground."""
        unit = position_m / np.linalg.norm(position_m, axis=1, keepdims=True)
        mean = unit.mean(axis=0)
        length = float(np.linalg.norm(mean))
        if length < 1e-6:
            return cls(np.array([0.0, 0.0, 1.0]), np.pi)
        centre = mean / length
        reach = float(np.arccos(np.clip(unit @ centre, -1.0, 1.0)).max())
        return cls(centre, min(reach + margin_m / SEMI_MINOR_M, np.pi))


@dataclass(frozen=True)
class SpecularTrack:
    """Specular points of one receiver, ordered by time, then transmitter: all arrays of length n.

    ``time_index`` counts steps from the start, ``transmitter`` the given list. Earth-fixed metres. ``nominal``: among
    the four of highest gain of that instant. ``grazing``: pairs and steps in view that could not be certified.
    """

    satellite: str
    time_index: NDArray[np.int32]
    transmitter: NDArray[np.int32]
    position_m: Array
    incidence_deg: Array
    mismatch_deg: Array
    rx_gain_dbi: Array
    rx_range_m: Array
    tx_range_m: Array
    nominal: NDArray[np.bool_]
    grazing: int

    def __len__(self) -> int:
        return len(self.time_index)


def specular_track(
    receiver: Ephemeris,
    transmitters: Sequence[Ephemeris],
    count: int,
    max_incidence_deg: float,
    beams: BeamPair,
    caps: Sequence[Cap] = (),
) -> SpecularTrack:
    """The specular points of a receiver with each transmitter, at the first ``count`` times of the receiver's grid.

    Transmitters may lie on a coarser grid (they are interpolated, see ``Ephemeris.states``) from the same start. With
    ``caps``, steps at which no point can fall into any of them are left out; at the others all points are given, so
    that the choice of four channels by gain stays right.
    """
    position, velocity = receiver.position_m[:count], receiver.velocity_m_s[:count]
    radius = np.linalg.norm(position, axis=1)
    farthest = max(float(np.linalg.norm(t.position_m, axis=1).max()) for t in transmitters)
    limit = np.radians(max_incidence_deg)
    near_arc = _arc_to_point(float(radius.max()), limit) + NORMAL_MARGIN_RAD
    wanted = _steps_near(position / radius[:, np.newaxis], caps, near_arc)
    table, used, grazing = _track(
        np.ascontiguousarray(position),
        body_axes(position, velocity),
        np.stack([_cubics(t) for t in transmitters]),
        receiver.step_s / transmitters[0].step_s,
        wanted,
        np.cos(min(near_arc + _arc_to_point(farthest, limit), np.pi)),
        limit,
        beams.parameters(),
    )
    table = table[:used]
    return SpecularTrack(
        receiver.name,
        table[:, 0].astype(np.int32),
        table[:, 1].astype(np.int32),
        table[:, 2:5].copy(),
        np.degrees(table[:, 5]),
        np.degrees(table[:, 6]),
        table[:, 7],
        table[:, 8],
        np.abs(table[:, 9]),
        table[:, 9] < 0.0,
        int(grazing),
    )


def _arc_to_point(radius_m: float, incidence_rad: float) -> float:
    """Angle at the Earth's centre from a satellite to a point seen at that incidence; most with the polar radius."""
    return float(incidence_rad - np.arcsin(SEMI_MINOR_M * np.sin(incidence_rad) / radius_m))


def _steps_near(direction: Array, caps: Sequence[Cap], arc_rad: float) -> NDArray[np.bool_]:
    if not caps:
        return np.ones(len(direction), dtype=np.bool_)
    near = np.zeros(len(direction), dtype=np.bool_)
    for cap in caps:
        near |= direction @ cap.centre >= np.cos(min(cap.radius_rad + arc_rad, np.pi))
    return near


def _cubics(ephemeris: Ephemeris) -> Array:
    """Coefficients (n-1, 4, 3) of the Hermite cubic of each interval, by powers of its share."""
    p0, p1 = ephemeris.position_m[:-1], ephemeris.position_m[1:]
    m0, m1 = ephemeris.step_s * ephemeris.velocity_m_s[:-1], ephemeris.step_s * ephemeris.velocity_m_s[1:]
    rise = p1 - p0
    return np.stack([p0, m0, 3.0 * rise - 2.0 * m0 - m1, m0 + m1 - 2.0 * rise], axis=1)


@njit(cache=True, nogil=True)
def _track(
    receiver: Array,
    axes: Array,
    cubics: Array,
    nodes_per_step: float,
    wanted: Array,
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
