"""Access prediction: from orbits, stations and targets to opportunities, contacts, eclipses and specular points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.grid import CellGrid
from services.access.coverage.places import REPORTED_RADII_KM, Places, places
from services.access.coverage.robustness import AlongTrackError, expected_error
from services.access.ellipsoid import to_cartesian
from services.access.events.contacts import Station
from services.access.horizon import Horizon
from services.access.options import AccessOptions
from services.access.orbits.ephemeris import RECEIVER_NODE_S, TRANSMITTER_NODE_S, Ephemeris
from services.access.orbits.formats import Orbit
from services.access.orbits.preparation import Prepared, choose_constellations, name_transmitters, prepare
from services.access.satellite import SatelliteAccess, Scene, satellite_access
from services.access.specular.roll import Roll
from services.access.specular.tracks import Cap
from shared.fan_out import fan_out_in_turn

__all__ = ["Access", "AccessOptions", "Horizon", "predict", "prepare_access"]

Array = NDArray[np.float64]
Task = tuple[Ephemeris, AlongTrackError | None, Roll | None, Scene]


@dataclass(frozen=True)
class Access:
    """A prediction: one entry a receiver in order of name, and what was left out or is worth knowing.

    ``interpolation_m``: bound of the interpolation error of orbits given as tables, by name.
    """

    horizon: Horizon
    options: AccessOptions
    receivers: list[Orbit]
    transmitters: list[Orbit]
    satellites: list[SatelliteAccess] = field(default_factory=list)
    dropped: dict[str, str] = field(default_factory=dict)
    interpolation_m: dict[str, float] = field(default_factory=dict)
    target_count: int = 0
    grid: CellGrid | None = None


def predict(
    receivers: Sequence[Orbit],
    transmitters: Sequence[Orbit],
    stations: Sequence[Station],
    targets_deg: tuple[Array, Array] | None,
    horizon: Horizon,
    options: AccessOptions,
    progress: Callable[[float, str], None] = lambda percent, message: None,
    *,
    grid: CellGrid | None = None,
    rolls: Mapping[str, Roll] | None = None,
) -> Access:
    """Predict access of receivers to point targets ``(latitude, longitude)``, grid cells and stations over a horizon.

    All held at once; ``prepare_access`` is for results that are not to be. Satellites whose orbits are of no use are
    left out, with the reason in ``dropped``; DomainError where that leaves no receiver or no transmitter, and for input
    that is no place or no orbit.
    """
    access, tasks = prepare_access(
        receivers, transmitters, stations, targets_deg, horizon, options, grid=grid, rolls=rolls
    )
    satellites: list[SatelliteAccess] = []
    for found in fan_out_in_turn(satellite_access, tasks):
        satellites.append(found)
        progress(10 + 70 * len(satellites) / len(tasks), f"specular points and events of {found.satellite}")
    return replace(access, satellites=satellites)


def prepare_access(
    receivers: Sequence[Orbit],
    transmitters: Sequence[Orbit],
    stations: Sequence[Station],
    targets_deg: tuple[Array, Array] | None,
    horizon: Horizon,
    options: AccessOptions,
    *,
    grid: CellGrid | None = None,
    rolls: Mapping[str, Roll] | None = None,
    with_cell_rows: bool = True,
) -> tuple[Access, list[Task]]:
    """A prediction without its satellites, and the arguments of ``satellite_access`` for each receiver."""
    targets = None
    if targets_deg is not None:
        targets = places(*targets_deg, options.radius_km, surface_height_m=options.surface_height_m)
    cells = None if grid is None else grid.places(options.radius_km, options.surface_height_m)
    rx = _prepare(receivers, horizon, options, RECEIVER_NODE_S, "receivers")
    middle = horizon.start + timedelta(seconds=horizon.duration_s / 2)
    named, unnamed = name_transmitters(transmitters, middle)
    chosen = choose_constellations(named, options.constellations)
    tx = _prepare(chosen, horizon, options, TRANSMITTER_NODE_S, "transmitters")
    caps = _caps(targets, cells, options)
    scene = Scene(tx.ephemerides, stations, targets, cells, caps, horizon, options, with_cell_rows)
    tasks: list[Task] = [
        (
            ephemeris,
            expected_error(orbit, horizon.start, options.along_track_error_km),
            (rolls or {}).get(orbit.name),
            scene,
        )
        for orbit, ephemeris in zip(rx.used, rx.ephemerides, strict=True)
    ]
    access = Access(
        horizon,
        options,
        rx.used,
        tx.used,
        dropped=rx.dropped | unnamed | tx.dropped,
        interpolation_m=rx.interpolation_m | tx.interpolation_m,
        target_count=0 if targets is None else len(targets),
        grid=grid,
    )
    return access, tasks


def _prepare(orbits: Sequence[Orbit], horizon: Horizon, options: AccessOptions, node_s: float, name: str) -> Prepared:
    return prepare(orbits, horizon.start, horizon.duration_s, node_s, options.max_element_age_days, name)


def _caps(targets: Places | None, cells: Places | None, options: AccessOptions) -> list[Cap] | None:
    """The parts of the globe where points matter: none listed where all of it does, None where none does."""
    reach_m = 1000.0 * max(*REPORTED_RADII_KM, options.radius_km or 0.0)
    caps = [Cap.around(some.position_m, reach_m) for some in (targets, cells) if some is not None]
    if not options.with_specular_points:
        return caps or None
    if options.area is None:
        return []
    west, south, east, north = options.area
    longitude, latitude = np.meshgrid(
        np.linspace(west, east + 360.0 * (east < west), 73), np.linspace(south, north, 37)
    )
    corners = to_cartesian(latitude.ravel(), longitude.ravel())
    return [*caps, Cap.around(corners, margin_m=400_000.0)]  # samples of the box lie up to 5 degrees apart
