"""Eclipses: when a satellite is in the umbra or penumbra of an oblate Earth, with the Sun a disc of finite size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.access.ellipsoid import SEMI_MAJOR_M, SEMI_MINOR_M
from services.access.events.contacts import sample_times
from services.access.events.crossings import positive_intervals
from services.access.orbits.ephemeris import Ephemeris
from services.access.orbits.orientation import Orientation, gmst82_rad, orientation_at

Array = NDArray[np.float64]

SUN_RADIUS_M = 6.957e8  # IAU 2015 resolution B3, nominal solar radius
ASTRONOMICAL_UNIT_M = 1.495978707e11


@dataclass(frozen=True)
class Eclipse:
    """A stay in full (``umbra``) or partial (``penumbra``) shadow; seconds after the ephemeris' start."""

    satellite: str
    kind: Literal["umbra", "penumbra"]
    start_s: float
    end_s: float


def sun_position_itrf(t_s: Array, orientation: Orientation) -> Array:
    """Apparent Sun (n, 3) in Earth-fixed metres at seconds after the orientation's start.

    Meeus, Astronomical Algorithms (1998), chapter 25, lower accuracy (0.01 degrees): apparent longitude of date with
    nutation and aberration, turned by apparent sidereal time. Polar motion (under 0.6 arcsec) is left out.
    """
    t = orientation.days_tt(t_s) / 36525.0
    mean_longitude = 280.46646 + 36000.76983 * t + 0.0003032 * t**2
    anomaly = np.radians(357.52911 + 35999.05029 * t - 0.0001537 * t**2)
    centre = (
        (1.914602 - 0.004817 * t - 0.000014 * t**2) * np.sin(anomaly)
        + (0.019993 - 0.000101 * t) * np.sin(2 * anomaly)
        + 0.000289 * np.sin(3 * anomaly)
    )
    eccentricity = 0.016708634 - 0.000042037 * t - 0.0000001267 * t**2
    distance_au = 1.000001018 * (1 - eccentricity**2) / (1 + eccentricity * np.cos(anomaly + np.radians(centre)))
    node = np.radians(125.04 - 1934.136 * t)
    longitude = np.radians(mean_longitude + centre - 0.00569 - 0.00478 * np.sin(node))
    obliquity = np.radians(23.439291 - 0.0130042 * t + 0.00256 * np.cos(node))
    sidereal = gmst82_rad(orientation.days_ut1(t_s)) - np.radians(0.00478 * np.sin(node)) * np.cos(obliquity)
    y_of_date = np.cos(obliquity) * np.sin(longitude)
    direction = np.stack(
        [
            np.cos(sidereal) * np.cos(longitude) + np.sin(sidereal) * y_of_date,
            np.cos(sidereal) * y_of_date - np.sin(sidereal) * np.cos(longitude),
            np.sin(obliquity) * np.sin(longitude),
        ],
        axis=-1,
    )
    return np.asarray(direction * (distance_au * ASTRONOMICAL_UNIT_M)[..., np.newaxis])


def shadow_depths_rad(position_m: Array, sun_m: Array) -> tuple[Array, Array]:
    """Penumbra and umbra depth (n,), positive inside: by how much the Earth's disc reaches over the Sun's two limbs.

    All in Earth-fixed metres (n, 3). Stretching the polar axis by a/b turns the ellipsoid into a sphere and keeps lines
    straight, so the disc that the satellite sees of the oblate Earth is exact for the Sun's centre; the Sun's own
    radius is not stretched (its shape errs by 1/298 of 0.27 degrees at most).
    """
    stretch = np.array([1.0, 1.0, SEMI_MAJOR_M / SEMI_MINOR_M])
    satellite, towards_sun = position_m * stretch, (sun_m - position_m) * stretch
    radius_m = np.linalg.norm(satellite, axis=-1)
    sun_distance_m = np.linalg.norm(towards_sun, axis=-1)
    cosine = -np.sum(satellite * towards_sun, axis=-1) / (radius_m * sun_distance_m)
    separation = np.arccos(np.clip(cosine, -1.0, 1.0))
    earth = np.arcsin(np.minimum(SEMI_MAJOR_M / radius_m, 1.0))
    sun = np.arcsin(SUN_RADIUS_M / sun_distance_m)
    return earth + sun - separation, earth - sun - separation


def find_eclipses(ephemeris: Ephemeris, end_s: float) -> list[Eclipse]:
    """Umbra and penumbra stays within [0, end_s], in order of time, edges within 1e-6 s on the given ephemeris.

    Penumbra rows are the partial phases only (before and after an umbra, or alone), so rows do not overlap.
    """
    t_s = sample_times(ephemeris, end_s)
    orientation = orientation_at(ephemeris.start, end_s)

    def depth(which: int, times: Array) -> Array:
        position, _ = ephemeris.states(times)
        return shadow_depths_rad(position, sun_position_itrf(times, orientation))[which]

    shadow = positive_intervals(lambda times: depth(0, times), t_s)
    umbra = positive_intervals(lambda times: depth(1, times), t_s)
    rows = [Eclipse(ephemeris.name, "umbra", start, end) for start, end in umbra]
    for start, end in shadow:
        edges = [start, *(edge for stay in umbra if start <= stay[0] <= end for edge in stay), end]
        rows += [
            Eclipse(ephemeris.name, "penumbra", a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a
        ]
    return sorted(rows, key=lambda row: row.start_s)
