"""Grids of cells to be covered: of even spacing in degrees, on land or everywhere, or cells given by centres."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.places import Places, places
from shared.errors import DomainError

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Array = NDArray[np.float64]
Area = tuple[float, float, float, float]

LAND = Path(__file__).parent / "land.geojson"
MOST_CELLS = 4_000_000


@dataclass(frozen=True)
class CellGrid:
    """Cells (n,) by their centres, degrees, and their half sides (latitude, longitude); None: centres without size.

    ``row`` and ``column`` count from north-west in the full grid of ``shape``, whose north-west corner and spacing
    ``origin_deg`` and ``spacing_deg`` give; all None for cells given by centres of no order.
    """

    latitude_deg: Array
    longitude_deg: Array
    half_sides_deg: tuple[float, float] | None
    spacing_deg: float | None = None
    origin_deg: tuple[float, float] | None = None
    shape: tuple[int, int] | None = None
    row: NDArray[np.int32] | None = None
    column: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.latitude_deg)

    def places(self, radius_km: float | None, surface_height_m: float = 0.0) -> Places:
        """The cells made ready for searches: covered within a radius of their middle, or by a footprint's touch."""
        return places(
            self.latitude_deg,
            self.longitude_deg,
            radius_km,
            half_sides_deg=self.half_sides_deg,
            surface_height_m=surface_height_m,
            field="grid",
        )


def even_grid(spacing_deg: float, area: Area | None = None, land_only: bool = False) -> CellGrid:
    """Cells ``spacing_deg`` wide and high that fill a box (lon_min, lat_min, lon_max, lat_max) or the globe.

    lon_min > lon_max crosses the dateline. The box is filled from its south-west corner; the last row and column may
    reach beyond it. ``land_only``: cells whose centre lies on land (Natural Earth 1:110m, public domain: coasts within
    some 10 km, no lakes, no small islands). DomainError for a box that is none, more than four million cells, or none.
    """
    west, south, east, north = area or (-180.0, -90.0, 180.0, 90.0)
    if not (-90 <= south < north <= 90 and -180 <= west <= 180 and -180 <= east <= 180):
        raise _fault(f"area {area} is not a box", area)
    wide = east - west + (360.0 if east <= west else 0.0)
    rows, columns = (round(np.ceil(round(side / spacing_deg, 9))) for side in (north - south, wide))
    if rows * columns > MOST_CELLS:
        raise _fault(f"spacing {spacing_deg} degrees makes {rows * columns} cells", spacing_deg)
    top = min(south + rows * spacing_deg, 90.0)
    rows -= top - (rows - 0.5) * spacing_deg < -90.0  # a last row whose middle lies beyond the pole
    latitude = top - (np.arange(rows) + 0.5) * spacing_deg
    longitude = (west + (np.arange(columns) + 0.5) * spacing_deg + 180.0) % 360.0 - 180.0
    row, column = (index.ravel() for index in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    kept = _on_land(latitude, longitude).ravel() if land_only else np.ones(rows * columns, dtype=np.bool_)
    if not kept.any():
        raise _fault("not one cell lies on land", area)
    half = spacing_deg / 2.0
    return CellGrid(
        latitude[row[kept]],
        longitude[column[kept]],
        (half, half),
        spacing_deg,
        (top, west),
        (rows, columns),
        row[kept].astype(np.int32),
        column[kept].astype(np.int32),
    )


def cells_at(latitude_deg: Sequence[float] | Array, longitude_deg: Sequence[float] | Array) -> CellGrid:
    """Cells given by their centres only: points as far as footprints go; longitudes 0 to 360 as -180 to 180.

    DomainError naming the row of one that lies nowhere, or for more than four million.
    """
    latitude, longitude = np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64)
    bad = np.flatnonzero(~((np.abs(latitude) <= 90.0) & (longitude >= -180.0) & (longitude <= 360.0)))
    if len(bad) or not 0 < len(latitude) <= MOST_CELLS:
        what = f"row {bad[0]} is at latitude {latitude[bad[0]]}, longitude {longitude[bad[0]]}" if len(bad) else ""
        raise DomainError(
            f"grid_cells: {what or f'the table has {len(latitude)} rows'}.",
            field="grid_cells",
            value=int(bad[0]) if len(bad) else len(latitude),
            accepted=f"1 to {MOST_CELLS} cells at latitudes -90..90 and longitudes -180..360",
        )
    return CellGrid(latitude, np.where(longitude > 180.0, longitude - 360.0, longitude), None)


def _on_land(latitude: Array, longitude: Array) -> NDArray[np.bool_]:
    import shapely

    x, y = np.meshgrid(longitude, latitude)
    return np.asarray(shapely.contains_xy(land(), x, y))


@cache
def land() -> BaseGeometry:
    """Land of the Earth (EPSG:4326), prepared for questions of what lies on it."""
    import shapely

    shape = shapely.from_geojson(json.dumps(json.loads(LAND.read_text(encoding="utf-8"))["geometry"]))
    shapely.prepare(shape)
    return shape


def _fault(what: str, value: object) -> DomainError:
    return DomainError(
        f"grid: {what}.",
        field="grid",
        value=value,
        accepted=f"lon_min, lat_min, lon_max, lat_max in degrees, with a spacing that makes 1 to {MOST_CELLS} cells",
    )
