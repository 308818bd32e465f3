"""The map grid of one fire: a UTM zone chosen by its evidence, cell centres in metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from shared.errors import DomainError

MAX_CELLS = 4_000_000
Floats = NDArray[np.float64]


def utm_epsg(longitude_deg: Floats, latitude_deg: Floats) -> int:
    """EPSG code of the WGS 84 / UTM zone at the circular mean of positions (n,), degrees.

    The circular mean keeps a fire across the antimeridian in one zone. Raises DomainError for positions that are not
    finite or lie outside UTM's latitudes, 80 S to 84 N.
    """
    longitude_deg, latitude_deg = np.asarray(longitude_deg, float), np.asarray(latitude_deg, float)
    if longitude_deg.size == 0 or not (np.isfinite(longitude_deg).all() and np.isfinite(latitude_deg).all()):
        raise DomainError(
            "positions must be finite and at least one", field="geometry", value="NaN or empty", accepted="degrees"
        )
    latitude = float(latitude_deg.mean())
    if not -80.0 <= latitude <= 84.0:
        raise DomainError(
            "a UTM grid needs a fire between 80 S and 84 N",
            field="geometry",
            value=latitude,
            accepted="-80..84 degrees",
        )
    angles = np.radians(longitude_deg)
    centre = np.degrees(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))
    zone = int((centre + 180.0) // 6.0) % 60 + 1
    return (32600 if latitude >= 0 else 32700) + zone


@dataclass(frozen=True)
class FireGrid:
    """Cell centres `x_m` (columns, ascending) and `y_m` (rows, ascending) in the UTM zone `epsg`."""

    epsg: int
    x_m: Floats
    y_m: Floats
    cell_m: float

    @cached_property
    def crs(self) -> CRS:
        return CRS.from_epsg(self.epsg)

    @property
    def shape(self) -> tuple[int, int]:
        return self.y_m.size, self.x_m.size

    @property
    def origin_km(self) -> tuple[float, float]:
        """Centre of the grid (x, y), km: the origin of the local coordinates that inference works in."""
        return float(self.x_m.mean()) / 1e3, float(self.y_m.mean()) / 1e3

    def local_km(self, longitude_deg: Floats, latitude_deg: Floats) -> tuple[Floats, Floats]:
        """Positions in degrees (n,) as local (x, y) in km from the grid centre."""
        x, y = project(self.epsg, longitude_deg, latitude_deg)
        return x / 1e3 - self.origin_km[0], y / 1e3 - self.origin_km[1]

    def cell_centres_km(self) -> tuple[Floats, Floats]:
        """Local (x, y) of every cell centre, two (rows, columns) arrays in km."""
        x, y = np.meshgrid(self.x_m / 1e3 - self.origin_km[0], self.y_m / 1e3 - self.origin_km[1])
        return x, y

    def degrees(self, x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
        """Longitude and latitude in degrees of UTM positions in metres."""
        lon, lat = Transformer.from_crs(self.epsg, 4326, always_xy=True).transform(x_m, y_m)
        return np.asarray(lon), np.asarray(lat)


def project(epsg: int, longitude_deg: Floats, latitude_deg: Floats) -> tuple[Floats, Floats]:
    """UTM metres (x, y) of positions in degrees, continuous across the antimeridian."""
    x, y = Transformer.from_crs(4326, epsg, always_xy=True).transform(
        np.asarray(longitude_deg), np.asarray(latitude_deg)
    )
    return np.asarray(x, float), np.asarray(y, float)


def make_grid(longitude_deg: Floats, latitude_deg: Floats, cell_m: float, margin_km: float) -> FireGrid:
    """Grid of cells of `cell_m` around positions (n,) with a margin; edges lie on multiples of the cell.

    Raises DomainError when the grid would exceed four million cells.
    """
    epsg = utm_epsg(longitude_deg, latitude_deg)
    x, y = project(epsg, longitude_deg, latitude_deg)
    axes = []
    for values in (x, y):
        low = np.floor((values.min() - margin_km * 1e3) / cell_m)
        high = np.ceil((values.max() + margin_km * 1e3) / cell_m)
        axes.append((np.arange(low, high) + 0.5) * cell_m)
    if axes[0].size * axes[1].size > MAX_CELLS:
        raise DomainError(
            f"a grid of {axes[1].size} x {axes[0].size} cells is too large for one fire",
            field="cell_m",
            value=cell_m,
            accepted=f"cells so large that the grid has at most {MAX_CELLS} of them",
        )
    return FireGrid(epsg, axes[0], axes[1], float(cell_m))
