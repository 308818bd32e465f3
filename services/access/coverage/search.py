"""Which places lie near a specular point or in its footprint: straight-line distances, safe at poles and dateline.

The compiled functions here call each other and none of another file, which Numba's cache would not notice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from services.access.coverage.places import Places
from services.access.ellipsoid import SEMI_MAJOR_M, SEMI_MINOR_M, arc_from_chord_m
from services.access.specular.footprint import Footprints

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_A2, _B2 = SEMI_MAJOR_M**2, SEMI_MINOR_M**2
DAY_S = 86400


@dataclass(frozen=True)
class Coverage:
    """A row per step and place: of the points that cover it then, the one of highest gain (then the nearest).

    Ordered by step, then place. ``nearest_km`` (days, places): how near any point came, infinite beyond the reach.
    """

    time_index: NDArray[np.int32]
    row: NDArray[np.int32]
    point: Integers
    distance_km: Array
    nearest_km: NDArray[np.float32]


def covered(
    time_index: NDArray[np.int32],
    position_m: Array,
    gain_dbi: Array,
    places: Places,
    *,
    footprints: Footprints | None = None,
    step_s: int = 1,
    days: int = 1,
) -> Coverage:
    """Places covered by specular points (n,) in order of time; by their footprints where ``places`` has no radius.

    Distances are straight lines turned into arcs of the mean sphere: within 0.3 % of the geodesic.
    """
    nearest = np.full((days, len(places)), np.inf)
    found, chord, used = _cover(
        time_index,
        np.ascontiguousarray(position_m),
        gain_dbi,
        np.empty((0, 5)) if footprints is None else footprints.shape,
        places.position_m,
        places.edges_m,
        places.middle_m,
        places.row,
        places.first,
        places.origin_m,
        places.columns,
        places.reach_m,
        -1.0 if places.chord_m is None else places.chord_m,
        step_s,
        nearest,
    )
    order = np.argsort(found[:used, 0].astype(np.int64) * len(places) + found[:used, 1], kind="stable")
    step, row, point = found[order].T
    nearest_km = (arc_from_chord_m(np.sqrt(nearest)) / 1000.0).astype(np.float32)
    nearest_km[~np.isfinite(nearest)] = np.inf
    return Coverage(
        step.copy(), row.copy(), point.astype(np.int64), arc_from_chord_m(chord[order]) / 1000.0, nearest_km
    )


def still_covered(
    places: Places,
    order: Integers,
    row: NDArray[np.int32],
    first: Integers,
    last: Integers,
    position_m: Array,
    usable: NDArray[np.bool_],
    footprints: Footprints | None,
) -> NDArray[np.bool_]:
    """Whether any usable point of ``position_m[first[k]:last[k]]`` covers the place of input row ``row[k]``.

    ``order`` (n,) gives each input row its index in ``places``.
    """
    result = np.zeros(len(row), dtype=np.bool_)
    _still_covered(
        order[row],
        first,
        last,
        np.ascontiguousarray(position_m),
        usable,
        np.empty((0, 5)) if footprints is None else footprints.shape,
        places.position_m,
        places.edges_m,
        -1.0 if places.chord_m is None else places.chord_m,
        result,
    )
    return result


@njit(cache=True, nogil=True)
def _cover(
    time_index: NDArray[np.int32],
    points: Array,
    gain: Array,
    shapes: Array,
    targets: Array,
    edges: Array,
    middles: Array,
    rows: Integers,
    column_first: Integers,
    origin: Array,
    columns: Integers,
    reach: float,
    chord: float,
    step_s: int,
    nearest: Array,
) -> tuple[NDArray[np.int32], Array, int]:
    found = np.empty((4096, 3), dtype=np.int32)
    distance = np.empty(4096)
    first, used = 0, 0
    best = np.full(len(targets), -1, dtype=np.int64)
    best_square = np.empty(len(targets))
    touched = np.empty(len(targets), dtype=np.int64)
    east, north = np.empty(3), np.empty(3)
    while first < len(time_index):
        last, count = first, 0
        near = nearest[min(int(time_index[first]) * step_s // DAY_S, len(nearest) - 1)]
        while last < len(time_index) and time_index[last] == time_index[first]:
            point = points[last]
            shape = shapes[last] if len(shapes) > 0 else point
            if chord < 0.0:
                _tangent(point, east, north)
            cx, cy = int(np.floor((point[0] - origin[0]) / reach)), int(np.floor((point[1] - origin[1]) / reach))
            for ix in range(max(cx - 1, 0), min(cx + 2, columns[0])):
                for iy in range(max(cy - 1, 0), min(cy + 2, columns[1])):
                    column = ix * columns[1] + iy
                    end = column_first[column + 1]
                    for k in range(_first_over(targets, column_first[column], end, point[2] - reach), end):
                        dx, dy, dz = targets[k, 0] - point[0], targets[k, 1] - point[1], targets[k, 2] - point[2]
                        if dz > reach:
                            break
                        square = dx * dx + dy * dy + dz * dz
                        if square > reach * reach:
                            continue
                        row = rows[k]
                        covers = _covers(chord, square, dx, dy, dz, shape, east, north, edges, k)
                        if len(middles) > 0:
                            dx, dy, dz = middles[k, 0] - point[0], middles[k, 1] - point[1], middles[k, 2] - point[2]
                            square = dx * dx + dy * dy + dz * dz
                        near[row] = min(near[row], square)
                        if not covers:
                            continue
                        other = best[row]
                        if other < 0:
                            touched[count] = row
                            count += 1
                        elif gain[last] < gain[other] or (gain[last] == gain[other] and square >= best_square[row]):
                            continue
                        best[row], best_square[row] = last, square
            last += 1
        if used + count > len(found):
            capacity = 2 * len(found) + count
            more, more_distance = np.empty((capacity, 3), dtype=np.int32), np.empty(capacity)
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
def _first_over(targets: Array, low: int, high: int, least_z: float) -> int:
    while low < high:
        middle = (low + high) // 2
        if targets[middle, 2] < least_z:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def _still_covered(
    target: Integers,
    first: Integers,
    last: Integers,
    points: Array,
    usable: NDArray[np.bool_],
    shapes: Array,
    targets: Array,
    edges: Array,
    chord: float,
    result: NDArray[np.bool_],
) -> None:
    east, north = np.empty(3), np.empty(3)
    for row in range(len(target)):
        k = target[row]
        for p in range(first[row], last[row]):
            if not usable[p]:
                continue
            dx, dy, dz = targets[k, 0] - points[p, 0], targets[k, 1] - points[p, 1], targets[k, 2] - points[p, 2]
            square = dx * dx + dy * dy + dz * dz
            if chord < 0.0:
                if square > 1e10:
                    continue
                _tangent(points[p], east, north)
            shape = shapes[p] if len(shapes) > 0 else points[p]
            if _covers(chord, square, dx, dy, dz, shape, east, north, edges, k):
                result[row] = True
                break


@njit(cache=True, nogil=True)
def _tangent(point: Array, east: Array, north: Array) -> None:
    x, y, z = point[0] / _A2, point[1] / _A2, point[2] / _B2
    length, across = np.sqrt(x * x + y * y + z * z), np.sqrt(x * x + y * y)
    x, y, z = x / length, y / length, z / length
    east[0], east[1], east[2] = 0.0, 1.0, 0.0
    if across > 1e-12 * length:
        east[0], east[1] = -y * length / across, x * length / across
    north[0], north[1], north[2] = -z * east[1], z * east[0], x * east[1] - y * east[0]


@njit(cache=True, nogil=True)
def _covers(
    chord: float,
    square: float,
    dx: float,
    dy: float,
    dz: float,
    shape: Array,
    east: Array,
    north: Array,
    edges: Array,
    k: int,
) -> bool:
    """Within the radius, or touched by the footprint: in axes that make the Fresnel zone a unit circle."""
    if chord >= 0.0:
        return square <= chord * chord
    cx, cy = _to_circle(
        shape, dx * east[0] + dy * east[1] + dz * east[2], dx * north[0] + dy * north[1] + dz * north[2]
    )
    mx, my = _to_circle(shape, shape[3], shape[4])
    if len(edges) == 0:
        return _from_segment(cx, cy, 0.0, 0.0, mx, my) <= 1.0
    g = edges[k]
    px, py = _to_circle(
        shape, g[0] * east[0] + g[1] * east[1] + g[2] * east[2], g[0] * north[0] + g[1] * north[1] + g[2] * north[2]
    )
    qx, qy = _to_circle(
        shape, g[3] * east[0] + g[4] * east[1] + g[5] * east[2], g[3] * north[0] + g[4] * north[1] + g[5] * north[2]
    )
    area = px * qy - py * qx  # where the point lies in the cell's own axes, its sides at -1 and 1
    if abs(-cx * qy + cy * qx) <= abs(area) and abs(-px * cy + py * cx) <= abs(area):
        return True
    for corner in range(4):
        a, b = 1.0 if corner % 3 == 0 else -1.0, 1.0 if corner < 2 else -1.0
        ax, ay = cx + a * px + b * qx, cy + a * py + b * qy
        bx, by = cx - b * px + a * qx, cy - b * py + a * qy
        if _segments_within_one(ax, ay, bx, by, mx, my):
            return True
    return False


@njit(cache=True, nogil=True)
def _to_circle(shape: Array, e: float, n: float) -> tuple[float, float]:
    return shape[0] * e + shape[1] * n, shape[2] * n


@njit(cache=True, nogil=True)
def _from_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Square of the distance of a point from a segment."""
    ux, uy = bx - ax, by - ay
    share = ((x - ax) * ux + (y - ay) * uy) / max(ux * ux + uy * uy, 1e-300)
    share = min(max(share, 0.0), 1.0)
    return (x - ax - share * ux) ** 2 + (y - ay - share * uy) ** 2


@njit(cache=True, nogil=True)
def _segments_within_one(ax: float, ay: float, bx: float, by: float, mx: float, my: float) -> bool:
    """Whether a segment comes within one of that from the origin to m."""
    side_a, side_b = mx * ay - my * ax, mx * by - my * bx
    side_0, side_m = (bx - ax) * -ay - (by - ay) * -ax, (bx - ax) * (my - ay) - (by - ay) * (mx - ax)
    if side_a * side_b < 0.0 and side_0 * side_m < 0.0:
        return True
    return (
        _from_segment(ax, ay, 0.0, 0.0, mx, my) <= 1.0
        or _from_segment(bx, by, 0.0, 0.0, mx, my) <= 1.0
        or _from_segment(0.0, 0.0, ax, ay, bx, by) <= 1.0
        or _from_segment(mx, my, ax, ay, bx, by) <= 1.0
    )
