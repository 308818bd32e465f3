"""All that is found for one receiver: a pure function of its orbit and of what all receivers share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.places import Places
from services.access.coverage.robustness import AlongTrackError, Geometry, Selection, covered_when_shifted
from services.access.coverage.search import Coverage, covered
from services.access.coverage.seen import Seen, join_seen, seen_from
from services.access.ellipsoid import to_geodetic
from services.access.events.contacts import Contact, Station, find_contacts, part_by_duration
from services.access.events.eclipses import Eclipse, find_eclipses
from services.access.horizon import Horizon
from services.access.options import AccessOptions, Area
from services.access.orbits.ephemeris import Ephemeris
from services.access.specular.footprint import Footprints, footprints
from services.access.specular.roll import Roll
from services.access.specular.tracks import Cap, PairCounts, SpecularTrack, add_counts, join_tracks, specular_track

Array = NDArray[np.float64]
GROUND_TRACK_STEP_S = 60.0
PART_STEPS = 21_600  # steps of the horizon worked on at a time: bounds the memory, whatever the horizon
CHUNK = 200_000  # points whose footprints and shifts are worked out at a time


@dataclass(frozen=True)
class Scene:
    """What all receivers share. ``caps``: the parts of the globe where points matter; None: nowhere."""

    transmitters: Sequence[Ephemeris]
    stations: Sequence[Station]
    targets: Places | None
    cells: Places | None
    caps: Sequence[Cap] | None
    horizon: Horizon
    options: AccessOptions
    with_cell_rows: bool = True


@dataclass(frozen=True)
class SatelliteAccess:
    """All that is found for one receiver; ``track`` in the area asked for, if it was, ``ground_deg`` (n, 2) latitude
    and longitude under the satellite every minute, ``worst_angle_deg`` the largest mismatch of any point found."""

    satellite: str
    targets: Seen | None
    cells: Seen | None
    track: SpecularTrack | None
    contacts: list[Contact]
    short_contacts: list[Contact]
    eclipses: list[Eclipse]
    ground_deg: Array
    counts: PairCounts
    worst_angle_deg: float


@dataclass(frozen=True)
class Stretch:
    """A receiver's states at the steps from ``first`` on."""

    first: int
    states: Ephemeris


def satellite_access(
    orbit: Ephemeris, error: AlongTrackError | None, roll: Roll | None, scene: Scene
) -> SatelliteAccess:
    """Specular points, coverage, contacts and eclipses of one receiver over the horizon."""
    horizon, options = scene.horizon, scene.options
    duration_s = float(horizon.duration_s)
    contacts, short = part_by_duration(find_contacts(orbit, scene.stations, duration_s), options.min_contact_s)
    ground, _ = orbit.states(np.arange(0.0, duration_s + 1e-6, min(GROUND_TRACK_STEP_S, duration_s)))
    latitude, longitude, _ = to_geodetic(ground)
    found = SatelliteAccess(
        orbit.name, None, None, None, contacts, short, find_eclipses(orbit, duration_s),
        np.column_stack([latitude, longitude]), PairCounts(0, 0, 0, 0, horizon.count * len(scene.transmitters)), 0.0,
    )  # fmt: skip
    if scene.caps is None:
        return found
    parts = [_part(orbit, first, error, roll, scene) for first in range(0, horizon.count, PART_STEPS)]
    seen = [[part[which] for part in parts if part[which] is not None] for which in ("targets", "cells")]
    targets, cells = (join_seen(some, horizon.step_s) if some else None for some in seen)
    tracks = [part["track"] for part in parts]
    return replace(
        found,
        targets=targets,
        cells=cells,
        track=join_tracks(tracks) if options.with_specular_points else None,
        counts=add_counts([track.counts for track in tracks]),
        worst_angle_deg=max(part["worst_angle_deg"] for part in parts),
    )


class _Part(TypedDict):
    targets: Seen | None
    cells: Seen | None
    track: SpecularTrack
    worst_angle_deg: float


def _part(orbit: Ephemeris, first: int, error: AlongTrackError | None, roll: Roll | None, scene: Scene) -> _Part:
    """A stretch of the horizon from step ``first``, so that no more points than its own are held at a time."""
    horizon, options = scene.horizon, scene.options
    count = min(PART_STEPS, horizon.count - first)
    position, velocity = orbit.states((first + np.arange(count)) * float(horizon.step_s))
    begin = orbit.start + timedelta(seconds=first * horizon.step_s)
    steps = Stretch(first, Ephemeris(orbit.name, begin, float(horizon.step_s), position, velocity))
    track = specular_track(
        steps.states, scene.transmitters, count, options.max_incidence_deg, options.antennas, scene.caps or (),
        first=first, roll=roll, surface_height_m=options.surface_height_m,
    )  # fmt: skip
    used = track.where(track.nominal if options.mode == "nominal" else track.in_beam)
    zones = _zones(used, steps, scene) if options.by_footprint and (scene.targets or scene.cells) else None
    kept = _in_area(track, options.area) if options.with_specular_points else track.where(slice(0, 0))
    return {
        "targets": _targets_seen(used, track, zones, steps, error, roll, scene),
        "cells": _cells_seen(used, zones, scene),
        "track": kept,
        "worst_angle_deg": float(track.mismatch_deg.max(initial=0.0)),
    }


def _cover(used: SpecularTrack, places: Places, zones: Footprints | None, horizon: Horizon) -> Coverage:
    return covered(
        used.time_index, used.position_m, used.rx_gain_dbi, places,
        footprints=zones, step_s=horizon.step_s, days=horizon.days,
    )  # fmt: skip


def _cells_seen(used: SpecularTrack, zones: Footprints | None, scene: Scene) -> Seen | None:
    if scene.cells is None:
        return None
    seen = seen_from(used, _cover(used, scene.cells, zones, scene.horizon), scene.horizon.step_s)
    return seen if scene.with_cell_rows else seen.without_rows()


def _targets_seen(
    used: SpecularTrack,
    track: SpecularTrack,
    zones: Footprints | None,
    steps: Stretch,
    error: AlongTrackError | None,
    roll: Roll | None,
    scene: Scene,
) -> Seen | None:
    if scene.targets is None:
        return None
    coverage = _cover(used, scene.targets, zones, scene.horizon)
    seen = seen_from(used, coverage, scene.horizon.step_s)
    if error is None:
        return seen
    ahead, behind = np.zeros(len(seen.row), dtype=np.bool_), np.zeros(len(seen.row), dtype=np.bool_)
    with_image = np.zeros(PART_STEPS, dtype=np.bool_)
    with_image[coverage.time_index - steps.first] = True
    imaged = track.where(with_image[track.time_index - steps.first])
    for first, last in _chunks(imaged.time_index):
        part = imaged.where(slice(first, last))
        rows = slice(*np.searchsorted(coverage.time_index, (part.time_index[0], part.time_index[-1] + 1)))
        ahead[rows], behind[rows] = _shifted(part, coverage, rows, steps, error, roll, scene)
    return replace(seen, ahead=ahead, behind=behind, error_km=error.at(seen.time_index * float(scene.horizon.step_s)))


def _shifted(
    part: SpecularTrack,
    coverage: Coverage,
    rows: slice,
    steps: Stretch,
    error: AlongTrackError,
    roll: Roll | None,
    scene: Scene,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    options = scene.options
    t_s = part.time_index * float(scene.horizon.step_s)
    geometry = _geometry(part, steps, scene, roll)
    zones = None
    if options.by_footprint:
        zones = footprints(part.position_m, geometry.receiver, geometry.transmitter, options.surface_height_m)
    selection = Selection(
        options.antennas, options.max_incidence_deg, options.mode == "nominal", options.surface_height_m
    )
    own = replace(coverage, time_index=coverage.time_index[rows], row=coverage.row[rows])
    assert scene.targets is not None
    return covered_when_shifted(own, part, geometry, scene.targets, error.at(t_s), selection, zones)


def _zones(used: SpecularTrack, steps: Stretch, scene: Scene) -> Footprints:
    shapes = [np.empty((0, 5))]
    for first in range(0, len(used), CHUNK):
        part = used.where(slice(first, first + CHUNK))
        geometry = _geometry(part, steps, scene, None)
        zone = footprints(part.position_m, geometry.receiver, geometry.transmitter, scene.options.surface_height_m)
        shapes.append(zone.shape)
    return Footprints(np.concatenate(shapes))


def _geometry(part: SpecularTrack, steps: Stretch, scene: Scene, roll: Roll | None) -> Geometry:
    t_s = part.time_index * float(scene.horizon.step_s)
    position, velocity = np.empty((len(part), 3)), np.empty((len(part), 3))
    for index in np.unique(part.transmitter):
        mine = part.transmitter == index
        position[mine], velocity[mine] = scene.transmitters[index].states(t_s[mine])
    own = part.time_index - steps.first
    receiver = steps.states.position_m[own], steps.states.velocity_m_s[own]
    return Geometry(receiver, (position, velocity), np.zeros(len(part)) if roll is None else roll.at(t_s))


def _chunks(time_index: NDArray[np.int32]) -> list[tuple[int, int]]:
    """Spans of about CHUNK rows that do not part an instant."""
    starts = np.arange(0, len(time_index), CHUNK)
    edges = [*np.searchsorted(time_index, time_index[starts], side="left").tolist(), len(time_index)]
    return [(first, last) for first, last in itertools.pairwise(edges) if last > first]


def _in_area(track: SpecularTrack, area: Area | None) -> SpecularTrack:
    if area is None:
        return track
    west, south, east, north = area
    latitude, longitude, _ = to_geodetic(track.position_m)
    after, before = longitude >= west, longitude <= east
    across = after & before if west < east else after | before
    return track.where((latitude >= south) & (latitude <= north) & across)
