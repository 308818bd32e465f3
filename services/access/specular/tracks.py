"""Specular tracks of one receiver: every point within the incidence limit, its gain, and the nominal channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.access.ellipsoid import SEMI_MINOR_M
from services.access.orbits.ephemeris import Ephemeris
from services.access.specular.antenna import AntennaSystem, body_axes
from services.access.specular.reflection import follow_all
from services.access.specular.roll import Roll

Array = NDArray[np.float64]

# normal and radius differ by 0.19 degrees, which moves a point by twice that at most
NORMAL_MARGIN_RAD = np.radians(1.0)


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
class PairCounts:
    """What became of the pairs of receiver and transmitter at the instants looked at; ``skipped`` were not.

    ``kept`` within the incidence limit and certified, ``occulted`` by the Earth, ``beyond_limit`` of incidence,
    ``uncertified``: in view and near the limb, where no point could be certified (grazing). They add up to all pairs.
    """

    kept: int
    occulted: int
    beyond_limit: int
    uncertified: int
    skipped: int


@dataclass(frozen=True)
class SpecularTrack:
    """Specular points of one receiver, ordered by time, then transmitter: all arrays of length n.

    ``time_index`` counts steps from the start, ``transmitter`` the given list. Earth-fixed metres. ``nominal``: among
    those of highest gain of that instant, as many as there are channels. ``in_beam``: gain above the antennas' floor.
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
    in_beam: NDArray[np.bool_]
    counts: PairCounts

    def __len__(self) -> int:
        return len(self.time_index)

    def where(self, rows: NDArray[np.bool_] | slice) -> SpecularTrack:
        """The track of these rows only; the counts stay."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)


def specular_track(
    receiver: Ephemeris,
    transmitters: Sequence[Ephemeris],
    count: int,
    max_incidence_deg: float,
    antennas: AntennaSystem,
    caps: Sequence[Cap] = (),
    *,
    first: int = 0,
    roll: Roll | None = None,
    surface_height_m: float = 0.0,
) -> SpecularTrack:
    """The specular points of a receiver with each transmitter, at the first ``count`` times of the receiver's grid.

    That grid begins ``first`` of its steps after the transmitters', from where steps are counted. Transmitters may lie
    on a coarser grid (they are interpolated, see ``Ephemeris.states``). With
    ``caps``, steps at which no point can fall into any of them are left out; at the others all points are given, so
    that the choice of channels by gain stays right.
    """
    position, velocity = receiver.position_m[:count], receiver.velocity_m_s[:count]
    radius = np.linalg.norm(position, axis=1)
    farthest = max(float(np.linalg.norm(t.position_m, axis=1).max()) for t in transmitters)
    limit = np.radians(max_incidence_deg)
    near_arc = _arc_to_point(float(radius.max()), limit) + NORMAL_MARGIN_RAD
    wanted = _steps_near(position / radius[:, np.newaxis], caps, near_arc)
    counts = np.zeros(4, dtype=np.int64)
    turned = None if roll is None else roll.at(first * receiver.step_s + receiver.times_s[:count])
    table, used = follow_all(
        np.ascontiguousarray(position),
        body_axes(position, velocity, turned),
        np.stack([_cubics(t) for t in transmitters]),
        receiver.step_s / transmitters[0].step_s,
        first,
        wanted,
        np.cos(min(near_arc + _arc_to_point(farthest, limit), np.pi)),
        limit,
        surface_height_m,
        antennas.table,
        antennas.channels,
        counts,
    )
    table = table[:used]
    return SpecularTrack(
        receiver.name,
        table[:, 0].astype(np.int32),
        table[:, 1].astype(np.int32),
        table[:, 2:5].copy(),
        np.degrees(table[:, 5]),
        np.degrees(table[:, 6]),
        table[:, 7].copy(),
        table[:, 8].copy(),
        np.abs(table[:, 9]),
        table[:, 9] < 0.0,
        table[:, 7] > antennas.floor_dbi,
        PairCounts(*map(int, counts), skipped=int((~wanted).sum()) * len(transmitters)),
    )


def add_counts(counts: Sequence[PairCounts]) -> PairCounts:
    """Counts of several stretches or receivers together."""
    return PairCounts(**{name: sum(getattr(count, name) for count in counts) for name in vars(counts[0])})


def join_tracks(tracks: Sequence[SpecularTrack]) -> SpecularTrack:
    """One receiver's stretches, in order of time, as one track."""
    joined = {
        name: np.concatenate([getattr(track, name) for track in tracks])
        for name, value in vars(tracks[0]).items()
        if isinstance(value, np.ndarray)
    }
    return replace(tracks[0], counts=add_counts([track.counts for track in tracks]), **joined)


def mark_nominal(
    time_index: NDArray[np.int32], gain_dbi: Array, usable: NDArray[np.bool_], channels: int
) -> NDArray[np.bool_]:
    """Which of points (n,) in order of time are among the ``channels`` usable ones of highest gain of their instant."""
    ranked = np.lexsort((-np.where(usable, gain_dbi, -np.inf), time_index))
    starts = np.searchsorted(time_index, time_index, side="left")
    rank = np.empty(len(ranked), dtype=np.int64)
    rank[ranked] = np.arange(len(ranked)) - starts[ranked]
    return np.asarray(usable & (rank < channels))


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
