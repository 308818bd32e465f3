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
from services.access.events.contacts import Contact, Station, find_contacts
from services.access.events.eclipses import Eclipse, find_eclipses
from services.access.orbits.elements import ElementSet, name_transmitters, within_age
from services.access.orbits.ephemeris import RECEIVER_NODE_S, TRANSMITTER_NODE_S, Ephemeris, propagate, resample
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
    specular points are kept in (lon_min, lat_min, lon_max, lat_max; lon_min > lon_max crosses the dateline)."""

    target_radius_km: float = 10.0
    max_incidence_deg: float = 65.0
    beams: BeamPair = CYGNSS_BEAMS
    max_element_age_days: float = 30.0
    with_specular_points: bool = False
    area: Area | None = None

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


@dataclass(frozen=True)
class Access:
    """A prediction: one entry a receiver in order of name, and what was left out or is worth knowing."""

    horizon: Horizon
    options: AccessOptions
    receivers: list[ElementSet]
    transmitters: list[ElementSet]
    satellites: list[SatelliteAccess]
    dropped: dict[str, str] = field(default_factory=dict)


def predict(
    receivers: Sequence[ElementSet],
    transmitters: Sequence[ElementSet],
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
    used_rx, orbits_rx, dropped_rx = _orbits(receivers, horizon, options, RECEIVER_NODE_S, "receivers")
    middle = horizon.start + timedelta(seconds=horizon.duration_s / 2)
    named, unnamed = name_transmitters(transmitters, middle)
    used_tx, orbits_tx, dropped_tx = _orbits(named, horizon, options, TRANSMITTER_NODE_S, "transmitters")
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
    return Access(horizon, options, used_rx, used_tx, satellites, dropped_rx | unnamed | dropped_tx)


def _orbits(
    elements: Sequence[ElementSet], horizon: Horizon, options: AccessOptions, node_s: float, name: str
) -> tuple[list[ElementSet], list[Ephemeris], dict[str, str]]:
    fresh, old = within_age(elements, horizon.start, options.max_element_age_days, name)
    ordered = sorted(fresh, key=lambda element: element.name)
    orbits, failed = propagate(ordered, horizon.start, horizon.duration_s, node_s)
    if not orbits:
        reasons = "; ".join(f"{satellite}: {why}" for satellite, why in failed.items())
        raise DomainError(
            f"{name}: no satellite can be propagated over the horizon ({reasons}).",
            field=name,
            accepted="elements of satellites that are in orbit over the whole horizon",
        )
    return [element for element in ordered if element.name not in failed], orbits, old | failed


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
    return SatelliteAccess(
        track,
        covered_targets(track, cells),
        find_contacts(orbit, stations, float(horizon.duration_s)),
        find_eclipses(orbit, float(horizon.duration_s)),
    )


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
