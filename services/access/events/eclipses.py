"""Eclipses: when a satellite is in the umbra or penumbra of an oblate Earth, with the Sun a disc of finite size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from services.access.ellipsoid import SEMI_MAJOR_M, SEMI_MINOR_M
from services.access.events.contacts import sample_times
from services.access.events.crossings import positive_intervals
from services.access.orbits.ephemeris import Ephemeris
from services.access.orbits.orientation import J2000_JD, Orientation, gcrs_to_itrf, orientation_at

Array = NDArray[np.float64]

SUN_RADIUS_M = 6.957e8  # IAU 2015 resolution B3, nominal solar radius
ASTRONOMICAL_UNIT_M = 1.495978707e11
LIGHT_TIME_OF_AU_S = 499.004784
SUN_NODE_S = 300.0


@dataclass(frozen=True)
class Eclipse:
    """A stay in full (``umbra``) or partial (``penumbra``) shadow; seconds after the ephemeris' start."""

    satellite: str
    kind: Literal["umbra", "penumbra"]
    start_s: float
    end_s: float


def sun_position_itrf(t_s: Array, orientation: Orientation) -> Array:
    """Apparent Sun (n, 3) in Earth-fixed metres at seconds (n,) after the orientation's start.

    Earth about the Sun by ERFA's epv00 (VSOP2000 abridged, within 0.005 arcsec), at the time when the light left, which
    is the planetary aberration: every observer near the Earth sees the Sun there.
    """
    import erfa

    heliocentric, _ = erfa.epv00(J2000_JD, orientation.days_tt(np.asarray(t_s) - LIGHT_TIME_OF_AU_S))
    sun_m = -heliocentric["p"] * ASTRONOMICAL_UNIT_M
    return gcrs_to_itrf(sun_m, np.zeros_like(sun_m), t_s, orientation)[0]


def sun_curve(orientation: Orientation, end_s: float) -> CubicSpline:
    """The same over [0, end_s] as a spline through nodes of 300 s: within 1e-9 rad."""
    nodes = np.linspace(0.0, end_s, 3 + int(end_s / SUN_NODE_S))
    return CubicSpline(nodes, sun_position_itrf(nodes, orientation))


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
    sun = sun_curve(orientation_at(ephemeris.start, end_s), end_s)

    def depth(which: int, times: Array) -> Array:
        position, _ = ephemeris.states(times)
        return shadow_depths_rad(position, sun(times))[which]

    shadow = positive_intervals(lambda times: depth(0, times), t_s)
    umbra = positive_intervals(lambda times: depth(1, times), t_s)
    rows = [Eclipse(ephemeris.name, "umbra", start, end) for start, end in umbra]
    for start, end in shadow:
        edges = [start, *(edge for stay in umbra if start <= stay[0] <= end for edge in stay), end]
        rows += [
            Eclipse(ephemeris.name, "penumbra", a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a
        ]
    return sorted(rows, key=lambda row: row.start_s)
