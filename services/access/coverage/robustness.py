"""Whether targets stay covered when a satellite runs ahead of, or behind, what its elements predict."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.places import Places
from services.access.coverage.search import Coverage, still_covered
from services.access.orbits.elements import ElementSet
from services.access.orbits.formats import Orbit
from services.access.orbits.orientation import EARTH_ROTATION_RAD_S
from services.access.specular.antenna import AntennaSystem, body_axes
from services.access.specular.footprint import Footprints
from services.access.specular.points import specular_points
from services.access.specular.reflection import SOLVED, gains_towards
from services.access.specular.tracks import SpecularTrack, mark_nominal

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

AT_EPOCH_KM = 1.0
PER_DAY_KM = 1.0
DRAG_SHARE = 0.2


def along_track_error_km(age_days: Array, mean_motion_rev_day: float, half_rate_rev_day2: float) -> Array:
    """Expected along-track error (n,) of SGP4 for a low orbit at an age of its elements, kilometres.

    ``1 km + 1 km a day + 20 % of what drag has moved the satellite since the epoch``. The first: SGP4 is good to about
    1 km within days of the epoch (Kelso, AAS 07-127); the second: Levit & Marshall (Adv. Space Res. 47, 2011) find
    errors that grow by about 1 km a day for low satellites with laser-ranged orbits; the third: drag moves it by
    2 pi a (n'/2) t^2 along its track (n'/2 as TLE line 1 and MEAN_MOTION_DOT state it), and the density of the
    thermosphere is forecast to no better than some 20 % (Emmert, Adv. Space Res. 56, 2015).
    """
    age = np.abs(np.asarray(age_days, dtype=np.float64))
    semi_major_km = (398600.4418 / (mean_motion_rev_day * 2.0 * np.pi / 86400.0) ** 2) ** (1.0 / 3.0)
    drag_km = 2.0 * np.pi * semi_major_km * max(half_rate_rev_day2, 0.0) * age**2
    return np.asarray(AT_EPOCH_KM + PER_DAY_KM * age + DRAG_SHARE * drag_km)


@dataclass(frozen=True)
class AlongTrackError:
    """The along-track error of one satellite: a given constant, or the law above from the age at the start on."""

    constant_km: float | None = None
    age_days: float = 0.0
    mean_motion_rev_day: float = 15.0
    half_rate_rev_day2: float = 0.0

    def at(self, t_s: Array) -> Array:
        """Error (n,) in km at seconds after the start."""
        if self.constant_km is not None:
            return np.full(len(t_s), self.constant_km)
        return along_track_error_km(self.age_days + t_s / 86400.0, self.mean_motion_rev_day, self.half_rate_rev_day2)


def expected_error(orbit: Orbit, start: datetime, given_km: float | None) -> AlongTrackError | None:
    """The error of an orbit over a horizon from ``start``: as given, else by its elements' age; ephemerides: None."""
    if given_km is not None:
        return AlongTrackError(given_km)
    if not isinstance(orbit, ElementSet):
        return None
    rev_day = 1440.0 / (2.0 * np.pi)
    # sgp4 keeps line 1's first derivative over two, in radians and minutes
    return AlongTrackError(
        None, orbit.age_days(start), orbit.record.no_kozai * rev_day, orbit.record.ndot * rev_day * 1440.0
    )


@dataclass(frozen=True)
class Geometry:
    """The states (n, 3; m and m/s, Earth-fixed) of receiver and transmitter at each point of a track, and the roll."""

    receiver: tuple[Array, Array]
    transmitter: tuple[Array, Array]
    roll_deg: Array


@dataclass(frozen=True)
class Selection:
    """Which points of an instant count: within the incidence limit, and nominal or in the beams."""

    antennas: AntennaSystem
    max_incidence_deg: float
    nominal_only: bool
    surface_height_m: float


def shifted_points(
    track: SpecularTrack, geometry: Geometry, shift_km: Array, selection: Selection
) -> tuple[Array, Flags]:
    """Points (n, 3) with the receiver ``shift_km`` (n,) further along its orbit at the same instants, and which count.

    The receiver is turned about its orbit's normal; the points are solved anew, the beams move with it, and in nominal
    mode channels are chosen anew among the track's points. Points that a shift brings under the incidence limit are not
    looked for.
    """
    position, velocity = geometry.receiver
    axes = body_axes(position, velocity)
    radius = np.linalg.norm(position, axis=1)
    angle = 1000.0 * shift_km / radius
    cosine, sine = np.cos(angle)[:, np.newaxis], np.sin(angle)[:, np.newaxis]
    moved = cosine * position + sine * radius[:, np.newaxis] * axes[:, 0]
    inertial = velocity + EARTH_ROTATION_RAD_S * np.stack(
        [-position[:, 1], position[:, 0], np.zeros(len(position))], axis=-1
    )
    normal = -axes[:, 1]
    turned = cosine * inertial + sine * np.cross(normal, inertial)
    earth_fixed = turned - EARTH_ROTATION_RAD_S * np.stack([-moved[:, 1], moved[:, 0], np.zeros(len(moved))], axis=-1)
    found = specular_points(moved, geometry.transmitter[0], selection.surface_height_m, track.position_m)
    usable = (found.status == SOLVED) & (found.incidence_deg <= selection.max_incidence_deg)
    gain = np.full(len(moved), selection.antennas.floor_dbi)
    gains_towards(
        body_axes(moved, earth_fixed, geometry.roll_deg), moved, found.position_m, selection.antennas.table, gain
    )
    if not selection.nominal_only:
        return found.position_m, usable & (gain > selection.antennas.floor_dbi)
    return found.position_m, mark_nominal(track.time_index, gain, usable, selection.antennas.channels)


def covered_when_shifted(
    coverage: Coverage,
    track: SpecularTrack,
    geometry: Geometry,
    places: Places,
    error_km: Array,
    selection: Selection,
    footprints: Footprints | None,
) -> tuple[Flags, Flags]:
    """For each row of ``coverage``: its place is still covered in the same image with the satellite ahead, and behind.

    ``track``, ``geometry`` and ``footprints`` hold every point of the images of ``coverage``; ``error_km`` (n,) is the
    error at each point. Footprints keep their shape.
    """
    order = np.empty(len(places), dtype=np.int64)
    order[places.row] = np.arange(len(places))
    first = np.searchsorted(track.time_index, coverage.time_index, side="left").astype(np.int64)
    last = np.searchsorted(track.time_index, coverage.time_index, side="right").astype(np.int64)
    results = []
    for sign in (1.0, -1.0):
        position, usable = shifted_points(track, geometry, sign * error_km, selection)
        results.append(still_covered(places, order, coverage.row, first, last, position, usable, footprints))
    return results[0], results[1]
