"""Which point targets lie near a specular point: a cell list on straight-line distances, safe at poles and dateline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.access.ellipsoid import arc_from_chord_m, chord_from_arc_m, to_cartesian
from services.access.specular.tracks import SpecularTrack
from shared.errors import DomainError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class TargetCells:
    """Point targets sorted into cubes of one radius: positions (n, 3) in metres, each with its input ``row``."""

    position_m: Array
    row: Integers
    keys: Integers
    origin_m: Array
    size: Integers
    radius_km: float
    chord_m: float


@dataclass(frozen=True)
class Coverage:
    """A row per step and target: of the points that cover it then, the one of highest gain (then the nearest)."""

    time_index: NDArray[np.int32]
    target_row: Integers
    point: Integers
    distance_km: Array


def target_cells(latitude_deg: Array, longitude_deg: Array, radius_km: float) -> TargetCells:
    """Targets on the ellipsoid at geodetic positions (n,), made ready for searches within ``radius_km``.

    Raises DomainError for no targets, or for a coordinate that is not a place, naming the row.
    """
    latitude, longitude = np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64)
    if len(latitude) == 0:
        raise DomainError("targets: the table is empty.", field="targets", value=0, accepted="at least one target")
    bad = ~(np.isfinite(longitude) & (np.abs(latitude) <= 90.0))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise DomainError(
            f"targets: row {row} is at latitude {latitude[row]}, longitude {longitude[row]}.",
            field="targets",
            value=(float(latitude[row]), float(longitude[row])),
            accepted="finite degrees, latitude -90..90",
        )
    position = to_cartesian(latitude, longitude)
    chord = chord_from_arc_m(radius_km * 1000.0)
    origin = position.min(axis=0) - chord
    cell = np.floor((position - origin) / chord).astype(np.int64)
    size = cell.max(axis=0) + 2
    keys = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    order = np.argsort(keys, kind="stable")
    return TargetCells(
        np.ascontiguousarray(position[order]), order.astype(np.int64), keys[order], origin, size, radius_km, chord
    )


def covered_targets(track: SpecularTrack, cells: TargetCells) -> Coverage:
    """Targets within the radius of a track's specular points, one row per step and target, by step then input row.

    Distances are straight lines turned into arcs of the mean sphere: within 0.3 % of the geodesic.
    """
    found, chord, used = _cover(
        track.time_index,
        np.ascontiguousarray(track.position_m),
        track.rx_gain_dbi,
        cells.position_m,
        cells.row,
        cells.keys,
        cells.origin_m,
        cells.size,
        cells.chord_m,
    )
    found, chord = found[:used], chord[:used]
    order = np.argsort(found[:, 0] * len(cells.row) + found[:, 1], kind="stable")
    step, target, point = found[order].T
    return Coverage(step.astype(np.int32), target, point, arc_from_chord_m(chord[order]) / 1000.0)


@njit(cache=True, nogil=True)
def _cover(
    time_index: NDArray[np.int32],
    points: Array,
    gain: Array,
    targets: Array,
    rows: Integers,
    keys: Integers,
    origin: Array,
    size: Integers,
    chord: float,
) -> tuple[Integers, Array, int]:
    found = np.empty((4096, 3), dtype=np.int64)
    distance = np.empty(4096)
    used = 0
    best = np.empty(len(targets), dtype=np.int64)
    for k in range(len(best)):
        best[k] = -1
    best_square = np.empty(len(targets))
    touched = np.empty(len(targets), dtype=np.int64)
    first = 0
    while first < len(time_index):
        last = first
        count = 0
        while last < len(time_index) and time_index[last] == time_index[first]:
            count = _cover_point(
                last, points[last], gain, targets, rows, keys, origin, size, chord, best, best_square, touched, count
            )
            last += 1
        if used + count > len(found):
            capacity = 2 * len(found) + count
            more, more_distance = np.empty((capacity, 3), dtype=np.int64), np.empty(capacity)
            for k in range(used):
                more[k, 0], more[k, 1], more[k, 2] = found[k, 0], found[k, 1], found[k, 2]
                more_distance[k] = distance[k]
            found, distance = more, more_distance
        for k in range(count):
            row = touched[k]
            found[used, 0], found[used, 1], found[used, 2] = time_index[first], row, best[row]
            distance[used] = np.sqrt(best_square[row])
            best[row] = -1
            used += 1
        first = last
    return found, distance, used


@njit(cache=True, nogil=True)
def _cover_point(
    index: int,
    point: Array,
    gain: Array,
    targets: Array,
    rows: Integers,
    keys: Integers,
    origin: Array,
    size: Integers,
    chord: float,
    best: Integers,
    best_square: Array,
    touched: Integers,
    count: int,
) -> int:
    """Enter one specular point's targets into ``best``; the three cells along z are neighbours in the sorted keys."""
    cx = int(np.floor((point[0] - origin[0]) / chord))
    cy = int(np.floor((point[1] - origin[1]) / chord))
    cz = int(np.floor((point[2] - origin[2]) / chord))
    if cz < -1 or cz > size[2]:
        return count
    low_z, high_z = max(cz - 1, 0), min(cz + 1, size[2] - 1)
    for ix in range(max(cx - 1, 0), min(cx + 2, size[0])):
        for iy in range(max(cy - 1, 0), min(cy + 2, size[1])):
            base = (ix * size[1] + iy) * size[2]
            for k in range(_first_at_least(keys, base + low_z), len(keys)):
                if keys[k] > base + high_z:
                    break
                dx, dy, dz = targets[k, 0] - point[0], targets[k, 1] - point[1], targets[k, 2] - point[2]
                square = dx * dx + dy * dy + dz * dz
                if square > chord * chord:
                    continue
                row = rows[k]
                if best[row] < 0:
                    touched[count] = row
                    count += 1
                elif gain[index] < gain[best[row]] or (gain[index] == gain[best[row]] and square >= best_square[row]):
                    continue
                best[row], best_square[row] = index, square
    return count


@njit(cache=True, nogil=True)
def _first_at_least(keys: Integers, wanted: int) -> int:
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low
