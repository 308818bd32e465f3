"""Ephemerides: Earth-fixed states on an even time grid, by SGP4 or as given, and states between the grid times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from sgp4.api import SGP4_ERRORS, SatrecArray
from sgp4.conveniences import jday_datetime

from services.access.orbits.elements import DAY_NOT_SAID, ElementSet
from services.access.orbits.orientation import orientation_at, teme_to_itrf
from shared.errors import DomainError

Array = NDArray[np.float64]

RECEIVER_NODE_S = 10.0
TRANSMITTER_NODE_S = 60.0
LOWEST_RADIUS_M = 6.478e6  # 100 km over the equator: no orbit lasts there


@dataclass(frozen=True)
class Ephemeris:
    """States of one satellite in ITRF: metres and metres a second (n, 3), every ``step_s`` from ``start`` (UTC)."""

    name: str
    start: datetime
    step_s: float
    position_m: Array
    velocity_m_s: Array

    @property
    def times_s(self) -> Array:
        """Seconds of the grid after the start (n,)."""
        return np.arange(len(self.position_m)) * self.step_s

    def states(self, t_s: Array) -> tuple[Array, Array]:
        """Positions (m) and velocities (m/s) at seconds after the start (k,), by cubic Hermite interpolation.

        The cubic itself errs by h^4/384 of the fourth derivative (0.3 mm for a low orbit on 10 s, 0.4 mm for GNSS
        on 60 s). SGP4's velocity differs from the derivative of its position by centimetres a second, which adds h/8
        of that: measured 0.03 m for CYGNSS and 0.2 m for GPS.
        Times outside the grid raise DomainError.
        """
        t_s = np.asarray(t_s, dtype=np.float64)
        last = len(self.position_m) - 1
        if t_s.size and (t_s.min() < -1e-6 or t_s.max() > last * self.step_s + 1e-6):
            raise DomainError(
                f"{self.name}: time beyond the ephemeris, which lasts {last * self.step_s:g} s.",
                field="duration_s",
                value=float(t_s.max()),
                accepted=f"0 to {last * self.step_s:g} s after its start",
            )
        index = np.clip((t_s / self.step_s).astype(np.int64), 0, last - 1)
        return _hermite(self, index, (t_s / self.step_s - index)[:, np.newaxis])


def _hermite(ephemeris: Ephemeris, index: NDArray[np.int64], share: Array) -> tuple[Array, Array]:
    h = ephemeris.step_s
    p0, p1 = ephemeris.position_m[index], ephemeris.position_m[index + 1]
    m0, m1 = h * ephemeris.velocity_m_s[index], h * ephemeris.velocity_m_s[index + 1]
    rise = p1 - p0
    # p(s) = p0 + s (m0 + s (b + s a)) keeps the large p0 out of the products
    a, b = m0 + m1 - 2.0 * rise, 3.0 * rise - 2.0 * m0 - m1
    position = p0 + share * (m0 + share * (b + share * a))
    return position, (m0 + share * (2.0 * b + share * 3.0 * a)) / h


def propagate(
    elements: Sequence[ElementSet], start: datetime, duration_s: float, node_s: float
) -> tuple[list[Ephemeris], dict[str, str]]:
    """SGP4 states on the nodes of the horizon (``node_times``) from ``start`` (UTC); and failures: name -> reason.

    A satellite for which SGP4 reports an error anywhere (decayed, eccentricity out of range, ...), that comes below
    100 km, or that the catalogue says has come down before the end, is left out whole.
    Vallado et al., AIAA 2006-6753 through the sgp4 package (WGS72 constants, as the elements are made with).
    """
    if not elements:
        return [], {}
    t_s = node_times(duration_s, node_s)
    day, fraction = jday_datetime(start)
    errors, position_km, velocity_km_s = SatrecArray([element.record for element in elements]).sgp4(
        np.full(len(t_s), day), fraction + t_s / 86400.0
    )
    orientation = orientation_at(start, duration_s)
    position, velocity = teme_to_itrf(position_km * 1000.0, velocity_km_s * 1000.0, t_s, orientation)
    kept: list[Ephemeris] = []
    dropped: dict[str, str] = {}
    end = start + timedelta(seconds=duration_s)
    for row, element in enumerate(elements):
        reason = _failure(errors[row], position[row], t_s)
        if element.decayed is not None and element.decayed < end:
            when = "" if element.decayed == DAY_NOT_SAID else f" on {element.decayed:%Y-%m-%d}"
            reason = f"the catalogue says that it came down{when}"
        if reason:
            dropped[element.name] = f"{reason} ({element.where})"
        else:
            kept.append(Ephemeris(element.name, start, float(t_s[1]), position[row], velocity[row]))
    return kept, dropped


def node_times(duration_s: float, node_s: float) -> Array:
    """Even times (n,) from 0 to exactly ``duration_s``, at most ``node_s`` apart."""
    count = max(int(np.ceil(duration_s / node_s)), 1)
    return np.arange(count + 1) * (duration_s / count)


def _failure(errors: NDArray[np.uint8], position_m: Array, t_s: Array) -> str:
    bad = np.flatnonzero(errors)
    if len(bad):
        code = int(errors[bad[0]])
        return f"SGP4 fails {t_s[bad[0]]:g} s after the start: {SGP4_ERRORS.get(code, code)}"
    low = np.flatnonzero(np.linalg.norm(position_m, axis=1) < LOWEST_RADIUS_M)
    if len(low):
        return f"decayed: below 100 km {t_s[low[0]]:g} s after the start"
    return ""


def resample(ephemeris: Ephemeris, step_s: float, count: int) -> Ephemeris:
    """The same orbit on a finer (or coarser) even grid of ``count`` states from its start."""
    position, velocity = ephemeris.states(np.arange(count) * step_s)
    return Ephemeris(ephemeris.name, ephemeris.start, step_s, position, velocity)
