"""Access prediction: from elements, stations and targets to opportunities, contacts, eclipses and specular points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.access.coverage.search import Coverage, TargetCells, covered_targets, target_cells
from services.access.ellipsoid import to_cartesian
from services.access.events.contacts import Contact, Station, find_contacts, part_by_duration
from services.access.events.eclipses import Eclipse, find_eclipses
from services.access.orbits.ephemeris import RECEIVER_NODE_S, TRANSMITTER_NODE_S, Ephemeris, resample
from services.access.orbits.formats import Orbit
from services.access.orbits.preparation import Prepared, choose_constellations, name_transmitters, prepare
from services.access.specular.antenna import CYGNSS_BEAMS, BeamPair
from services.access.specular.tracks import Cap, SpecularTrack, specular_track
from shared.errors import DomainError

Array = NDArray[np.float64]
Area = tuple[float, float, float, float]

THREADS = 2  # satellites are worked on side by side; results do not depend on it


@dataclass(frozen=True)
class Horizon:
    """The time predicted: whole seconds from ``start`` (UTC), an image at every ``step_s``."""

    start: datetime
    duration_s: int = 86400
    step_s: int = 1

    def __post_init__(self) -> None:
        if self.start.tzinfo is None or self.start.microsecond:
            raise DomainError(
                f"start {self.start.isoformat()} is not a whole second with a time zone.",
                field="start",
                value=self.start.isoformat(),
                accepted="e.g. 2022-05-14T00:00:00Z",
            )
        if self.step_s < 1 or self.duration_s < self.step_s or self.duration_s % self.step_s:
            raise DomainError(
                f"step_s {self.step_s} does not divide duration_s {self.duration_s}.",
                field="step_s",
                value=self.step_s,
                accepted="whole seconds, at least 1, that divide duration_s",
            )
        object.__setattr__(self, "start", self.start.astimezone(UTC))

    @property
    def count(self) -> int:
        """Images: the steps in [start, end)."""
        return self.duration_s // self.step_s


@dataclass(frozen=True)
class AccessOptions:
    """What counts as access: radius about a specular point, incidence limit, beams, oldest elements, and the area that
    specular points are kept in (lon_min, lat_min, lon_max, lat_max; lon_min > lon_max crosses the dateline). Letters of
    the constellations used (None: all), and the shortest contact that counts."""

    target_radius_km: float = 10.0
    max_incidence_deg: float = 65.0
    beams: BeamPair = CYGNSS_BEAMS
    max_element_age_days: float = 30.0
    with_specular_points: bool = False
    area: Area | None = None
    constellations: tuple[str, ...] | None = None
    min_contact_s: float = 0.0

    def __post_init__(self) -> None:
        if self.area is None:
            return
        west, south, east, north = self.area
        if not (-180 <= west <= 180 and -180 <= east <= 180 and -90 <= south < north <= 90 and west != east):
            raise DomainError(
                f"area {self.area} is not a box.",
                field="area",
                value=self.area,
                accepted="lon_min, lat_min, lon_max, lat_max in degrees; lon_min > lon_max crosses the dateline",
            )


@dataclass(frozen=True)
class SatelliteAccess:
    """All that is found for one receiver."""

    track: SpecularTrack
    coverage: Coverage
    contacts: list[Contact]
    eclipses: list[Eclipse]
    short_contacts: list[Contact] = field(default_factory=list)


@dataclass(frozen=True)
class Access:
    """A prediction: one entry a receiver in order of name, and what was left out or is worth knowing.

    ``interpolation_m``: bound of the interpolation error of orbits given as tables, by name.
    """

    horizon: Horizon
    options: AccessOptions
    receivers: list[Orbit]
    transmitters: list[Orbit]
    satellites: list[SatelliteAccess]
    dropped: dict[str, str] = field(default_factory=dict)
    interpolation_m: dict[str, float] = field(default_factory=dict)


def predict(
    receivers: Sequence[Orbit],
    transmitters: Sequence[Orbit],
    stations: Sequence[Station],
    targets_deg: tuple[Array, Array],
    horizon: Horizon,
    options: AccessOptions,
    progress: Callable[[float, str], None] = lambda percent, message: None,
) -> Access:
    """Predict access of receivers to point targets ``(latitude, longitude)`` and to stations over a horizon.

    Satellites whose elements are too old, whose ranging code is unknown or for which SGP4 fails are left out, with the
    reason in ``dropped``; DomainError where that leaves no receiver or no transmitter, for no targets, and for input
    that is no place or no orbit.
    """
    cells = target_cells(*targets_deg, options.target_radius_km)
    rx = _prepare(receivers, horizon, options, RECEIVER_NODE_S, "receivers")
    middle = horizon.start + timedelta(seconds=horizon.duration_s / 2)
    named, unnamed = name_transmitters(transmitters, middle)
    chosen = choose_constellations(named, options.constellations)
    tx = _prepare(chosen, horizon, options, TRANSMITTER_NODE_S, "transmitters")
    orbits_rx, orbits_tx = rx.ephemerides, tx.ephemerides
    progress(10, f"{len(orbits_rx)} receivers and {len(orbits_tx)} transmitters propagated")
    caps = _caps(cells, options)
    work = partial(
        _satellite, transmitters=orbits_tx, stations=stations, cells=cells, caps=caps, horizon=horizon, options=options
    )
    satellites: list[SatelliteAccess] = []
    with ThreadPoolExecutor(THREADS) as pool:
        for done in pool.map(work, orbits_rx):
            satellites.append(done)
            progress(
                10 + 70 * len(satellites) / len(orbits_rx), f"specular points and events of {done.track.satellite}"
            )
    dropped = rx.dropped | unnamed | tx.dropped
    return Access(horizon, options, rx.used, tx.used, satellites, dropped, rx.interpolation_m | tx.interpolation_m)


def _prepare(orbits: Sequence[Orbit], horizon: Horizon, options: AccessOptions, node_s: float, name: str) -> Prepared:
    return prepare(orbits, horizon.start, horizon.duration_s, node_s, options.max_element_age_days, name)


def _satellite(
    orbit: Ephemeris,
    *,
    transmitters: Sequence[Ephemeris],
    stations: Sequence[Station],
    cells: TargetCells,
    caps: Sequence[Cap],
    horizon: Horizon,
    options: AccessOptions,
) -> SatelliteAccess:
    steps = resample(orbit, float(horizon.step_s), horizon.count)
    track = specular_track(steps, transmitters, horizon.count, options.max_incidence_deg, options.beams, caps)
    contacts, short = part_by_duration(find_contacts(orbit, stations, float(horizon.duration_s)), options.min_contact_s)
    eclipses = find_eclipses(orbit, float(horizon.duration_s))
    return SatelliteAccess(track, covered_targets(track, cells), contacts, eclipses, short)


def _caps(cells: TargetCells, options: AccessOptions) -> list[Cap]:
    """The parts of the globe where points matter; none where all of it does."""
    of_targets = Cap.around(cells.position_m, options.target_radius_km * 1000.0)
    if not options.with_specular_points:
        return [of_targets]
    if options.area is None:
        return []
    west, south, east, north = options.area
    longitude, latitude = np.meshgrid(
        np.linspace(west, east + 360.0 * (east < west), 73), np.linspace(south, north, 37)
    )
    corners = to_cartesian(latitude.ravel(), longitude.ravel())
    return [of_targets, Cap.around(corners, margin_m=400_000.0)]  # samples of the box lie up to 5 degrees apart


def step_times(horizon: Horizon, index: NDArray[np.int32]) -> pd.DatetimeIndex:
    """Times (UTC, ms) of step numbers."""
    start_ms = np.datetime64(horizon.start.replace(tzinfo=None), "ms")
    milliseconds = index.astype(np.int64) * (horizon.step_s * 1000)
    return pd.DatetimeIndex(start_ms + milliseconds.astype("timedelta64[ms]")).tz_localize("UTC")
