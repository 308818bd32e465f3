"""Earth orientation: UT1 and polar motion from the IERS tables shipped offline, and the frames that orbits come in.

Angles from UT1 = UTC + (UT1-UTC). Tidal terms inside a day (< 0.1 ms, 5 cm on the ground) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.access.orbits.time_scales import TT_MINUS_TAI_S, tai_minus_utc_s

Array = NDArray[np.float64]

EARTH_ROTATION_RAD_S = 7.292115146706979e-5  # Vallado, Fundamentals of Astrodynamics (2013), eq. 3-75
ARCSEC_RAD = np.pi / 648000.0
MJD_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)
J2000_JD = 2451545.0
NODE_S = 1800.0  # precession and nutation are linear to 1e-11 rad over it (their fastest terms take 4.7 days)


@dataclass(frozen=True)
class Orientation:
    """Earth orientation over a horizon: x, y of the pole (rad), UT1-UTC (s) at the start and its change in s a day,
    and whether the table covered it."""

    start: datetime
    pole_x_rad: float
    pole_y_rad: float
    ut1_utc_s: float
    in_table: bool
    ut1_rate_s_day: float = 0.0

    def days_ut1(self, t_s: Array) -> Array:
        """Days of UT1 since J2000.0 (JD 2451545.0) at seconds after the start."""
        t_s = np.asarray(t_s)
        return self._days(t_s, self.ut1_utc_s + self.ut1_rate_s_day / 86400.0 * t_s)

    def days_tt(self, t_s: Array) -> Array:
        """Days of TT since J2000.0 at seconds after the start."""
        return self._days(t_s, np.float64(tai_minus_utc_s(self.start) + TT_MINUS_TAI_S))

    def _days(self, t_s: Array, offset_s: Array | np.float64) -> Array:
        whole = (self.start - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
        return np.asarray(whole + (np.asarray(t_s) + offset_s) / 86400.0)


def orientation_at(start: datetime, duration_s: float = 0.0) -> Orientation:
    """Orientation over a horizon: UT1 linear from its start to its end, the pole as in its middle (6 cm a day).

    ``start`` is UTC. From finals2000A.all of astropy-iers-data (IERS Bulletin A with predictions of a year); beyond its
    ends the nearest entry holds and ``in_table`` is False.
    """
    first = (start - MJD_EPOCH) / timedelta(days=1)
    days = duration_s / 86400.0
    _, _, at_start, inside_start = _entry(first)
    x, y, _, _ = _entry(first + days / 2.0)
    _, _, at_end, inside_end = _entry(first + days)
    rise = at_end - at_start
    rise -= round(rise)  # a leap second on the way is no rotation
    rate = rise / days if days > 0.0 else 0.0
    return Orientation(start, x * ARCSEC_RAD, y * ARCSEC_RAD, at_start, inside_start and inside_end, rate)


def _entry(mjd: float) -> tuple[float, float, float, bool]:
    """x, y (arcsec), UT1-UTC (s) between the days of the table, and whether the table reaches there."""
    days, values = _finals2000a()
    index = int(np.clip(np.searchsorted(days, mjd, side="right") - 1, 0, len(days) - 2))
    share = float(np.clip(mjd - days[index], 0.0, 1.0))
    before, after = values[index], values[index + 1].copy()
    after[2] -= round(after[2] - before[2])  # a leap second between the two days is no rotation
    x, y, ut1_utc = before + share * (after - before)
    return float(x), float(y), float(ut1_utc), bool(days[0] <= mjd <= days[-1])


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


def gcrs_to_itrf(position: Array, velocity: Array, t_s: Array, orientation: Orientation) -> tuple[Array, Array]:
    """Positions (n, 3) and velocities from the geocentric celestial frame (GCRF, the axes of ICRF) to ITRF.

    Bias, precession and nutation IAU 2006/2000A and Greenwich apparent sidereal time by ERFA (the IAU's SOFA), at nodes
    of 30 minutes and linear between them. The pole's offsets against that model (under 1 mas, 3 cm) are left out.
    """
    import erfa

    t_s = np.asarray(t_s, dtype=np.float64)
    first, last = t_s.min(), t_s.max() + 1.0
    nodes = np.linspace(first, last, 2 + int((last - first) / NODE_S))
    turn = erfa.pnm06a(J2000_JD, orientation.days_tt(nodes))
    ut1 = orientation.days_ut1(nodes)
    beyond = np.unwrap(
        erfa.gst06(J2000_JD, ut1, J2000_JD, orientation.days_tt(nodes), turn) - erfa.era00(J2000_JD, ut1)
    )
    angle = erfa.era00(J2000_JD, orientation.days_ut1(t_s)) + np.interp(t_s, nodes, beyond)
    row = np.clip(np.searchsorted(nodes, t_s, side="right") - 1, 0, len(nodes) - 2)
    share = ((t_s - nodes[row]) / (nodes[1] - nodes[0]))[:, np.newaxis, np.newaxis]
    matrix = turn[row] + share * (turn[row + 1] - turn[row])
    of_date = [np.einsum("nij,nj->ni", matrix, vector) for vector in (position, velocity)]
    return _spin(of_date[0], of_date[1], angle, orientation)


def eme2000_to_gcrs(vector: Array) -> Array:
    """Vectors (n, 3) from the mean equator and equinox of J2000 to GCRF: the frame bias, 0.02 arcsec (IAU 2000)."""
    import erfa

    bias = erfa.bp06(J2000_JD, 0.0)[0]
    return np.asarray(vector @ bias)


def _spin(position: Array, velocity: Array, angle_rad: Array, orientation: Orientation) -> tuple[Array, Array]:
    fixed = rotate_z(position, angle_rad)
    moving = rotate_z(velocity, angle_rad)
    moving[..., 0] += EARTH_ROTATION_RAD_S * fixed[..., 1]
    moving[..., 1] -= EARTH_ROTATION_RAD_S * fixed[..., 0]
    x, y = orientation.pole_x_rad, orientation.pole_y_rad
    pole = np.array([[1.0, 0.0, x], [0.0, 1.0, -y], [-x, y, 1.0]])
    return fixed @ pole.T, moving @ pole.T


def rotate_z(vector: Array, angle_rad: Array) -> Array:
    """Vectors (..., n, 3) seen from axes turned about z by (n,) angles."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)
