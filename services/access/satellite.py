"""All that is found for one receiver: a pure function of its orbit and of what all receivers share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.places import Places
from services.access.coverage.revisit import Visits, visits
from services.access.coverage.robustness import AlongTrackError, Geometry, Selection, covered_when_shifted
from services.access.coverage.search import Coverage, covered
from services.access.ellipsoid import to_geodetic
from services.access.events.contacts import Contact, Station, find_contacts, part_by_duration
from services.access.events.eclipses import Eclipse, find_eclipses
from services.access.horizon import Horizon
from services.access.orbits.ephemeris import Ephemeris, resample
from services.access.specular.antenna import AntennaSystem, shipped_antennas
from services.access.specular.footprint import Footprints, footprints
from services.access.specular.roll import Roll
from services.access.specular.tracks import Cap, PairCounts, SpecularTrack, specular_track
from shared.errors import DomainError

Array = NDArray[np.float64]
Area = tuple[float, float, float, float]

GROUND_TRACK_STEP_S = 60.0
CHUNK = 200_000  # points whose footprints and shifts are worked out at a time


@dataclass(frozen=True)
class AccessOptions:
    """What counts as access.

    ``target_radius_km`` about a specular point, or with ``by_footprint`` its footprint; an incidence limit; the
    antennas; ``raw-if``: every point in the beams, ``nominal``: as many as there are channels, by gain; the height of
    the surface over WGS84; ``along_track_error_km`` in place of what the elements' age gives; the oldest elements; the
    area that specular points are kept in (lon_min, lat_min, lon_max, lat_max; lon_min > lon_max crosses the dateline);
    letters of the constellations used (None: all), and the shortest contact that counts.
    """

    target_radius_km: float = 10.0
    max_incidence_deg: float = 65.0
    antennas: AntennaSystem = field(default_factory=shipped_antennas)
    max_element_age_days: float = 30.0
    with_specular_points: bool = False
    area: Area | None = None
    constellations: tuple[str, ...] | None = None
    min_contact_s: float = 0.0
    mode: Literal["raw-if", "nominal"] = "raw-if"
    by_footprint: bool = False
    surface_height_m: float = 0.0
    along_track_error_km: float | None = None

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

    @property
    def radius_km(self) -> float | None:
        """The radius that covers; None where the footprint does."""
        return None if self.by_footprint else self.target_radius_km


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
class Seen:
    """What a receiver's images cover: a row per image and place (input row), in order of time, then place.

    Of the point of highest gain that covers it: transmitter's index, incidence, distance, gain. ``ahead``, ``behind``:
    still covered at that along-track error (km); None where it was not asked for or no error is known. ``count`` rows
    and ``images`` there are, even where the rows were let go.
    """

    count: int
    images: int
    visits: Visits

    time_index: NDArray[np.int32]
    row: NDArray[np.int32]
    transmitter: NDArray[np.int16]
    incidence_deg: Array
    distance_km: Array
    rx_gain_dbi: Array
    nearest_km: NDArray[np.float32]
    ahead: NDArray[np.bool_] | None = None
    behind: NDArray[np.bool_] | None = None
    error_km: Array | None = None


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
    steps = resample(orbit, float(horizon.step_s), horizon.count)
    track = specular_track(
        steps, scene.transmitters, horizon.count, options.max_incidence_deg, options.antennas, scene.caps,
        roll=roll, surface_height_m=options.surface_height_m,
    )  # fmt: skip
    used = track.where(track.nominal if options.mode == "nominal" else track.in_beam)
    zones = _zones(used, steps, scene) if options.by_footprint and (scene.targets or scene.cells) else None
    return replace(
        found,
        targets=_targets_seen(used, track, zones, steps, error, roll, scene),
        cells=_cells_seen(used, zones, scene),
        track=_in_area(track, options.area) if options.with_specular_points else None,
        counts=track.counts,
        worst_angle_deg=float(track.mismatch_deg.max(initial=0.0)),
    )


def _cover(used: SpecularTrack, places: Places, zones: Footprints | None, horizon: Horizon) -> Coverage:
    return covered(
        used.time_index, used.position_m, used.rx_gain_dbi, places,
        footprints=zones, step_s=horizon.step_s, days=horizon.days,
    )  # fmt: skip


def _cells_seen(used: SpecularTrack, zones: Footprints | None, scene: Scene) -> Seen | None:
    if scene.cells is None:
        return None
    seen = _seen(used, _cover(used, scene.cells, zones, scene.horizon), scene.horizon)
    if scene.with_cell_rows:
        return seen
    empty = {name: value[:0] for name, value in vars(seen).items() if isinstance(value, np.ndarray)}
    return replace(seen, **(empty | {"nearest_km": seen.nearest_km}))


def _seen(used: SpecularTrack, coverage: Coverage, horizon: Horizon) -> Seen:
    point = coverage.point
    return Seen(
        len(coverage.row),
        int((np.diff(coverage.time_index, prepend=-1) != 0).sum()),
        visits(coverage.time_index, coverage.row, horizon.step_s),
        coverage.time_index,
        coverage.row,
        used.transmitter[point].astype(np.int16),
        used.incidence_deg[point],
        coverage.distance_km,
        used.rx_gain_dbi[point],
        coverage.nearest_km,
    )


def _targets_seen(
    used: SpecularTrack,
    track: SpecularTrack,
    zones: Footprints | None,
    steps: Ephemeris,
    error: AlongTrackError | None,
    roll: Roll | None,
    scene: Scene,
) -> Seen | None:
    if scene.targets is None:
        return None
    coverage = _cover(used, scene.targets, zones, scene.horizon)
    seen = _seen(used, coverage, scene.horizon)
    if error is None:
        return seen
    ahead, behind = np.zeros(len(seen.row), dtype=np.bool_), np.zeros(len(seen.row), dtype=np.bool_)
    with_image = np.zeros(scene.horizon.count, dtype=np.bool_)
    with_image[coverage.time_index] = True
    imaged = track.where(with_image[track.time_index])
    for first, last in _chunks(imaged.time_index):
        part = imaged.where(slice(first, last))
        rows = slice(*np.searchsorted(coverage.time_index, (part.time_index[0], part.time_index[-1] + 1)))
        ahead[rows], behind[rows] = _shifted(part, coverage, rows, steps, error, roll, scene)
    return replace(seen, ahead=ahead, behind=behind, error_km=error.at(seen.time_index * float(scene.horizon.step_s)))


def _shifted(
    part: SpecularTrack,
    coverage: Coverage,
    rows: slice,
    steps: Ephemeris,
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


def _zones(used: SpecularTrack, steps: Ephemeris, scene: Scene) -> Footprints:
    shapes = [np.empty((0, 5))]
    for first in range(0, len(used), CHUNK):
        part = used.where(slice(first, first + CHUNK))
        geometry = _geometry(part, steps, scene, None)
        zone = footprints(part.position_m, geometry.receiver, geometry.transmitter, scene.options.surface_height_m)
        shapes.append(zone.shape)
    return Footprints(np.concatenate(shapes))


def _geometry(part: SpecularTrack, steps: Ephemeris, scene: Scene, roll: Roll | None) -> Geometry:
    t_s = part.time_index * float(scene.horizon.step_s)
    position, velocity = np.empty((len(part), 3)), np.empty((len(part), 3))
    for index in np.unique(part.transmitter):
        mine = part.transmitter == index
        position[mine], velocity[mine] = scene.transmitters[index].states(t_s[mine])
    receiver = steps.position_m[part.time_index], steps.velocity_m_s[part.time_index]
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
