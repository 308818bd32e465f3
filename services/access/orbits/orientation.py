"""Earth orientation: UT1 and polar motion from the IERS tables shipped offline, and the frames that SGP4 and GMAT use.

Angles from UT1 = UTC + (UT1-UTC), interpolated linearly between days. Tidal terms inside a day (< 0.1 ms, 5 cm on the
ground) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EARTH_ROTATION_RAD_S = 7.292115146706979e-5  # Vallado, Fundamentals of Astrodynamics (2013), eq. 3-75
ARCSEC_RAD = np.pi / 648000.0
MJD_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)
TT_MINUS_UTC_S = 69.184  # since 2017; 1 s of error turns the Sun by 1e-5 degrees


@dataclass(frozen=True)
class Orientation:
    """Earth orientation over a horizon: x, y of the pole (rad), UT1-UTC (s), and whether the table covered it."""

    start: datetime
    pole_x_rad: float
    pole_y_rad: float
    ut1_utc_s: float
    in_table: bool

    def days_ut1(self, t_s: Array) -> Array:
        """Days of UT1 since J2000.0 (JD 2451545.0) at seconds after the start."""
        return self._days(t_s, self.ut1_utc_s)

    def days_tt(self, t_s: Array) -> Array:
        """Days of TT since J2000.0 at seconds after the start."""
        return self._days(t_s, TT_MINUS_UTC_S)

    def _days(self, t_s: Array, offset_s: float) -> Array:
        whole = (self.start - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
        return np.asarray(whole + (np.asarray(t_s) + offset_s) / 86400.0)


def orientation_at(start: datetime, duration_s: float = 0.0) -> Orientation:
    """Orientation at the middle of a horizon, held constant over it (a day moves UT1 by about 1 ms, 0.5 m).

    ``start`` is UTC. From finals2000A.all of astropy-iers-data (IERS Bulletin A with predictions of a year); beyond its
    ends the nearest entry holds and ``in_table`` is False.
    """
    mjd, values = _finals2000a()
    middle = (start - MJD_EPOCH) / timedelta(days=1) + duration_s / 172800.0
    inside = bool(mjd[0] <= middle <= mjd[-1])
    index = int(np.clip(np.searchsorted(mjd, middle, side="right") - 1, 0, len(mjd) - 2))
    share = float(np.clip(middle - mjd[index], 0.0, 1.0))
    before, after = values[index], values[index + 1].copy()
    after[2] -= round(after[2] - before[2])  # a leap second between the two days is no rotation
    x, y, ut1_utc = before + share * (after - before)
    return Orientation(start, float(x) * ARCSEC_RAD, float(y) * ARCSEC_RAD, float(ut1_utc), inside)


@cache
def _finals2000a() -> tuple[Array, Array]:
    import astropy_iers_data

    lines = Path(astropy_iers_data.IERS_A_FILE).read_text(encoding="ascii").splitlines()
    rows = [
        (float(line[7:15]), float(line[18:27]), float(line[37:46]), float(line[58:68]))
        for line in lines
        if line[58:68].strip()
    ]
    table = np.array(rows)
    return table[:, 0], table[:, 1:]


def gmst82_rad(days_ut1: Array) -> Array:
    """Greenwich mean sidereal time, IAU 1982 (Aoki et al. 1982), from days of UT1 since J2000.0."""
    t = days_ut1 / 36525.0
    seconds = 67310.54841 + (876600.0 * 3600.0 + 8640184.812866) * t + 0.093104 * t**2 - 6.2e-6 * t**3
    return np.asarray((seconds % 86400.0) * (2.0 * np.pi / 86400.0))


def teme_to_itrf(position: Array, velocity: Array, t_s: Array, orientation: Orientation) -> tuple[Array, Array]:
    """Positions (..., n, 3) and velocities from SGP4's TEME of date to ITRF, any length unit.

    GMST82 about the pole, then polar motion: Vallado, Crawford, Hujsak & Kelso, AIAA 2006-6753, appendix C.
    """
    return _spin(position, velocity, gmst82_rad(orientation.days_ut1(t_s)), orientation)


def j2000_to_itrf(position: Array, velocity: Array, t_s: Array, orientation: Orientation) -> tuple[Array, Array]:
    """Positions (n, 3) and velocities from the mean equator and equinox of J2000 (GMAT's EarthMJ2000Eq) to ITRF.

    Precession IAU 1976, the eight largest nutation terms of IAU 1980 (the rest stay under 0.2 arcsec, 7 m at a LEO).
    """
    t = orientation.days_tt(t_s) / 36525.0
    dpsi, deps = _nutation(t)
    mean_obliquity = (84381.448 - 46.8150 * t - 0.00059 * t**2) * ARCSEC_RAD
    zeta = (2306.2181 * t + 0.30188 * t**2) * ARCSEC_RAD
    z = (2306.2181 * t + 1.09468 * t**2) * ARCSEC_RAD
    theta = (2004.3109 * t - 0.42665 * t**2) * ARCSEC_RAD
    turned = []
    for vector in (position, velocity):
        mean = rotate_z(rotate_y(rotate_z(vector, -zeta), theta), -z)
        turned.append(rotate_x(rotate_z(rotate_x(mean, mean_obliquity), -dpsi), -mean_obliquity - deps))
    sidereal = gmst82_rad(orientation.days_ut1(t_s)) + dpsi * np.cos(mean_obliquity)
    return _spin(turned[0], turned[1], sidereal, orientation)


def _nutation(t: Array) -> tuple[Array, Array]:
    """Nutation in longitude and obliquity (rad): Meeus, Astronomical Algorithms (1998), table 22.A, largest terms."""
    d, m, mp, f, om = (
        np.radians(a + b * t)
        for a, b in (
            (297.85036, 445267.111480),
            (357.52772, 35999.050340),
            (134.96298, 477198.867398),
            (93.27191, 483202.017538),
            (125.04452, -1934.136261),
        )
    )
    terms = (
        (om, -17.1996, 9.2025),
        (2 * (f + om - d), -1.3187, 0.5736),
        (2 * (f + om), -0.2274, 0.0977),
        (2 * om, 0.2062, -0.0895),
        (m, 0.1426, 0.0054),
        (mp, 0.0712, -0.0007),
        (2 * (f + om - d) + m, -0.0517, 0.0224),
        (2 * f + om, -0.0386, 0.0200),
    )
    dpsi = sum(in_longitude * np.sin(argument) for argument, in_longitude, _ in terms)
    deps = sum(in_obliquity * np.cos(argument) for argument, _, in_obliquity in terms)
    return np.asarray(dpsi * ARCSEC_RAD), np.asarray(deps * ARCSEC_RAD)


def _spin(position: Array, velocity: Array, angle_rad: Array, orientation: Orientation) -> tuple[Array, Array]:
    fixed = rotate_z(position, angle_rad)
    moving = rotate_z(velocity, angle_rad)
    moving[..., 0] += EARTH_ROTATION_RAD_S * fixed[..., 1]
    moving[..., 1] -= EARTH_ROTATION_RAD_S * fixed[..., 0]
    x, y = orientation.pole_x_rad, orientation.pole_y_rad
    pole = np.array([[1.0, 0.0, x], [0.0, 1.0, -y], [-x, y, 1.0]])
    return fixed @ pole.T, moving @ pole.T


def rotate_x(vector: Array, angle_rad: Array) -> Array:
    """Vectors (..., n, 3) seen from axes turned about x by (n,) angles."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.stack([x, c * y + s * z, c * z - s * y], axis=-1)


def rotate_y(vector: Array, angle_rad: Array) -> Array:
    """Vectors (..., n, 3) seen from axes turned about y by (n,) angles."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.stack([c * x - s * z, y, s * x + c * z], axis=-1)


def rotate_z(vector: Array, angle_rad: Array) -> Array:
    """Vectors (..., n, 3) seen from axes turned about z by (n,) angles."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)
