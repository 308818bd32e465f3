"""Orbits given as states over time: where they hold, and states between the given ones."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from services.access.orbits.ephemeris import Ephemeris, node_times
from shared.errors import DomainError

Array = NDArray[np.float64]

DEGREE = 9  # of the splines; the error is judged against two degrees less
LARGEST_INTERPOLATION_ERROR_M = 100.0
LOWEST_RADIUS_M, HIGHEST_RADIUS_M = 6.40e6, 1.0e9
SLACK_S = 1e-3


@dataclass(frozen=True)
class Segment:
    """An unbroken run of positions in ITRF (n, 3) m at increasing ``times_s`` (n,), to be used from ``first_s`` to
    ``last_s``; seconds count from the orbit's ``reference``. ``where``: its lines in the file."""

    times_s: Array
    position_m: Array
    first_s: float
    last_s: float
    where: str


@dataclass(frozen=True)
class TabulatedOrbit:
    """One satellite's orbit as a table, in segments in order of time; nothing is interpolated from one to the next.

    Without a segment it is of no use, and ``first`` and ``last`` have no meaning.

    ``epoch``: the time (UTC) until which the table rests on observations or when it was made; None where not said.
    ``position_error_km``: of the table as its source states it, None where not known.
    """

    name: str
    source: Literal["oem", "sp3"]
    epoch: datetime | None
    reference: datetime
    segments: tuple[Segment, ...]
    where: str
    position_error_km: float | None = None
    catalogue_number: int | None = None

    def age_days(self, when: datetime) -> float | None:
        """Days from ``epoch`` to ``when``; negative where it lies after it, None without an epoch."""
        return None if self.epoch is None else (when - self.epoch) / timedelta(days=1)

    @property
    def first(self) -> datetime:
        """UTC of the first usable time."""
        return self.reference + timedelta(seconds=self.segments[0].first_s)

    @property
    def last(self) -> datetime:
        """UTC of the last usable time."""
        return self.reference + timedelta(seconds=self.segments[-1].last_s)


def interpolate(
    orbits: Sequence[TabulatedOrbit], start: datetime, duration_s: float, node_s: float
) -> tuple[list[Ephemeris], dict[str, str], dict[str, float]]:
    """States on the nodes of ``propagate``; the orbits left out: name -> reason with the lines; and the error bounds.

    An orbit is left out where the horizon reaches beyond it or into a gap, or where its states lie too far apart. The
    bound (m) is the largest difference of the spline of degree 9 from that of degree 7 midway between given states.
    """
    kept: list[Ephemeris] = []
    dropped: dict[str, str] = {}
    bounds: dict[str, float] = {}
    t_s = node_times(duration_s, node_s)
    for orbit in orbits:
        at_s = t_s + (start - orbit.reference) / timedelta(seconds=1)
        reason = _uncovered(orbit, float(at_s[0]), float(at_s[-1]))
        if reason is None:
            position, velocity, bound = _states(orbit, at_s)
            if bound <= LARGEST_INTERPOLATION_ERROR_M:
                kept.append(Ephemeris(orbit.name, start, float(t_s[1]), position, velocity))
                bounds[orbit.name] = bound
                continue
            reason = f"its states ({orbit.where}) lie too far apart: interpolation errs by up to {bound:.0f} m"
        dropped[orbit.name] = reason
    return kept, dropped, bounds


def _uncovered(orbit: TabulatedOrbit, first_s: float, last_s: float) -> str | None:
    """Why the orbit does not hold from ``first_s`` to ``last_s``; None where it does."""
    segments = orbit.segments
    if not segments:
        return f"the file ({orbit.where}) gives it too few positions in a row"
    if first_s < segments[0].first_s - SLACK_S or last_s > segments[-1].last_s + SLACK_S:
        return (
            f"the horizon {_utc(orbit, first_s)} to {_utc(orbit, last_s)} reaches beyond the ephemeris in "
            f"{orbit.where}, which holds from {orbit.first:%Y-%m-%dT%H:%M:%SZ} to {orbit.last:%Y-%m-%dT%H:%M:%SZ}"
        )
    for before, after in itertools.pairwise(segments):
        if after.first_s - before.last_s > SLACK_S and first_s < after.first_s and last_s > before.last_s:
            return (
                f"a gap from {_utc(orbit, before.last_s)} ({before.where}) to {_utc(orbit, after.first_s)} "
                f"({after.where}) lies in the horizon"
            )
    return None


def _utc(orbit: TabulatedOrbit, t_s: float) -> str:
    return f"{orbit.reference + timedelta(seconds=t_s):%Y-%m-%dT%H:%M:%SZ}"


def _states(orbit: TabulatedOrbit, at_s: Array) -> tuple[Array, Array, float]:
    """Positions and velocities (n, 3) at seconds after the reference, and the bound of the interpolation error (m)."""
    position, velocity = np.empty((len(at_s), 3)), np.empty((len(at_s), 3))
    bound = 0.0
    starts = np.array([segment.first_s for segment in orbit.segments])
    owner = np.clip(np.searchsorted(starts, at_s + SLACK_S, side="right") - 1, 0, len(starts) - 1)
    for index, segment in enumerate(orbit.segments):
        mine = owner == index
        if not mine.any():
            continue
        curve, error_m = _spline(segment, float(at_s[mine][0]), float(at_s[mine][-1]))
        position[mine], velocity[mine] = curve(at_s[mine]), curve(at_s[mine], 1)
        bound = max(bound, error_m)
    return position, velocity, bound


def _spline(segment: Segment, first_s: float, last_s: float) -> tuple[Any, float]:
    """The spline through the states about ``first_s`` to ``last_s``, and how far one of a lower degree differs."""
    from scipy.interpolate import make_interp_spline

    times = segment.times_s
    low = max(int(np.searchsorted(times, first_s)) - 2 * DEGREE, 0)
    high = min(int(np.searchsorted(times, last_s)) + 2 * DEGREE, len(times))
    t, positions = times[low:high], segment.position_m[low:high]
    degree = min(DEGREE, (len(t) - 2) // 2 * 2 + 1)
    curve = make_interp_spline(t, positions, degree)
    lower = make_interp_spline(t, positions, max(degree - 2, 1))
    middle = 0.5 * (t[1:] + t[:-1])
    middle = middle[(middle >= first_s - (t[1] - t[0])) & (middle <= last_s + (t[-1] - t[-2]))]
    differences = np.linalg.norm(curve(middle) - lower(middle), axis=1)
    return curve, float(differences.max(initial=0.0))


def refuse_impossible_radius(position_m: Array, lines: Sequence[int], name: str) -> None:
    """DomainError naming the line of the first position (n, 3) that lies inside the Earth or beyond the Moon."""
    radius = np.linalg.norm(position_m, axis=1)
    bad = np.flatnonzero(~((radius > LOWEST_RADIUS_M) & (radius < HIGHEST_RADIUS_M)))
    if len(bad):
        row = int(bad[0])
        raise DomainError(
            f"{name}: line {lines[row]}: a position {radius[row] / 1000.0:.1f} km from the Earth's centre.",
            field=name,
            value=(position_m[row] / 1000.0).tolist(),
            accepted="positions of satellites, in kilometres from the Earth's centre",
        )


def seconds_since(reference: np.datetime64, times: NDArray[np.datetime64]) -> Array:
    """Seconds (n,) from a reference to times of datetime64[us]."""
    return np.asarray((times - reference) / np.timedelta64(1, "us") / 1e6, dtype=np.float64)


def as_datetime(time: np.datetime64) -> datetime:
    """A UTC datetime64 as a datetime with its time zone."""
    return datetime.fromisoformat(str(time.astype("datetime64[us]"))).replace(tzinfo=UTC)
