"""Places to be covered, points or cells of a grid, sorted into columns of space for searches by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.access.ellipsoid import chord_from_arc_m, to_cartesian
from shared.errors import DomainError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# what a footprint may reach from its point at 85 degrees of incidence: 9 km of Fresnel zone and a second's motion
FOOTPRINT_REACH_M = 25_000.0
# Sides are straight: of wider cells they would leave the meridians and parallels by more than 0.12 km
WIDEST_PIECE_DEG = 0.5
REPORTED_RADII_KM = (3.5, 10.0, 25.0)


@dataclass(frozen=True)
class Places:
    """Places on the ellipsoid in columns along z, one ``reach_m`` wide: what a search needs.

    ``position_m`` (n, 3) in order of column, then z, each with its input ``row``; ``first`` (columns + 1,) where each
    column starts; ``edges_m`` (n, 6) the half sides of cells to east and north, or (0, 6) where places are points.
    Wide cells are there in pieces that share their ``row``; ``middle_m`` (n, 3) are the middles of their cells then,
    else (0, 3). ``chord_m`` is the radius as a straight line; None where the footprint decides.
    """

    position_m: Array
    edges_m: Array
    middle_m: Array
    row: Integers
    first: Integers
    origin_m: Array
    columns: Integers
    reach_m: float
    radius_km: float
    chord_m: float | None

    def __len__(self) -> int:
        """Places as given, wide cells counted once."""
        return int(self.row.max()) + 1


def places(
    latitude_deg: Array,
    longitude_deg: Array,
    radius_km: float | None,
    *,
    half_sides_deg: tuple[float, float] | None = None,
    surface_height_m: float = 0.0,
    field: str = "targets",
) -> Places:
    """Points (n,) at geodetic positions, or cells of ``half_sides_deg`` (latitude, longitude) about them.

    Covered by whatever point lies within ``radius_km`` of their middle; None: by the footprints that touch them.
    Raises DomainError for no places, or for a coordinate that is not a place, naming the row.
    """
    latitude, longitude = np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64)
    _refuse_what_is_no_place(latitude, longitude, field)
    row, middle = np.arange(len(latitude)), np.empty((0, 3))
    if radius_km is None and half_sides_deg is not None and 2.0 * max(half_sides_deg) > WIDEST_PIECE_DEG:
        middles = to_cartesian(latitude, longitude, surface_height_m)
        latitude, longitude, half_sides_deg, row = _pieces(latitude, longitude, half_sides_deg)
        middle = middles[row]
    position = to_cartesian(latitude, longitude, surface_height_m)
    edges = np.empty((0, 6)) if half_sides_deg is None else _half_sides(latitude, longitude, half_sides_deg)
    chord = None if radius_km is None else chord_from_arc_m(radius_km * 1000.0)
    reach = max(chord_from_arc_m(1000.0 * max(REPORTED_RADII_KM)), chord or 0.0)
    if chord is None:
        half_diagonal = float(np.linalg.norm(edges.reshape(-1, 2, 3), axis=2).sum(axis=1).max(initial=0.0))
        reach = max(reach, FOOTPRINT_REACH_M + half_diagonal)
    origin = position.min(axis=0) - reach
    cell = np.floor((position[:, :2] - origin[:2]) / reach).astype(np.int64)
    columns = cell.max(axis=0) + 2
    column = cell[:, 0] * columns[1] + cell[:, 1]
    order = np.lexsort((position[:, 2], column))
    first = np.searchsorted(column[order], np.arange(columns[0] * columns[1] + 1)).astype(np.int64)
    return Places(
        np.ascontiguousarray(position[order]),
        np.ascontiguousarray(edges[order]) if len(edges) else edges,
        np.ascontiguousarray(middle[order]) if len(middle) else middle,
        row[order].astype(np.int64),
        first,
        origin,
        columns,
        reach,
        radius_km or 0.0,
        chord,
    )


def _pieces(
    latitude: Array, longitude: Array, half_deg: tuple[float, float]
) -> tuple[Array, Array, tuple[float, float], Integers]:
    """Middles and half sides of the pieces of cells, none wider than ``WIDEST_PIECE_DEG``, and the cell of each."""
    count = [int(np.ceil(round(2.0 * half / WIDEST_PIECE_DEG, 9))) for half in half_deg]
    north, east = (half * ((2.0 * np.arange(n) + 1.0) / n - 1.0) for half, n in zip(half_deg, count, strict=True))
    up, right = (offset.ravel() for offset in np.meshgrid(north, east, indexing="ij"))
    row = np.repeat(np.arange(len(latitude)), len(up))
    of_latitude, of_longitude = (latitude[:, np.newaxis] + up).ravel(), (longitude[:, np.newaxis] + right).ravel()
    kept = np.abs(of_latitude) <= 90.0  # a last row may reach beyond the pole
    return of_latitude[kept], of_longitude[kept], (half_deg[0] / count[0], half_deg[1] / count[1]), row[kept]


def _refuse_what_is_no_place(latitude: Array, longitude: Array, field: str) -> None:
    if len(latitude) == 0:
        raise DomainError(f"{field}: the table is empty.", field=field, value=0, accepted="at least one place")
    bad = ~(np.isfinite(longitude) & (np.abs(latitude) <= 90.0))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise DomainError(
            f"{field}: row {row} is at latitude {latitude[row]}, longitude {longitude[row]}.",
            field=field,
            value=(float(latitude[row]), float(longitude[row])),
            accepted="finite degrees, latitude -90..90",
        )


def _half_sides(latitude: Array, longitude: Array, half_deg: tuple[float, float]) -> Array:
    """Half sides (n, 6) of cells as straight lines from the middle to the east and to the north edge's middle."""
    half_latitude, half_longitude = half_deg
    north = to_cartesian(np.minimum(latitude + half_latitude, 90.0), longitude) - to_cartesian(latitude, longitude)
    turned = to_cartesian(latitude, longitude + half_longitude) - to_cartesian(latitude, longitude - half_longitude)
    return np.concatenate([0.5 * turned, north], axis=1)
