"""EASE-Grid 2.0, cylindrical equal-area, global (EPSG:6933): rows and columns of positions and back.

Constants: Brodzik et al. 2012 and 2014, ISPRS Int. J. Geo-Inf. 1(1), 32-45; NSIDC grid tables (M36, M09, M03).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from rasterio.transform import Affine

from shared.errors import DomainError

FloatArray = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0
ECCENTRICITY = 0.081819190843  # WGS 84
STANDARD_PARALLEL_DEG = 30.0
X_MIN_M, Y_MAX_M = -17367530.44516138, 7314540.83

_E2 = ECCENTRICITY**2
_K0 = np.cos(np.deg2rad(STANDARD_PARALLEL_DEG)) / np.sqrt(1.0 - _E2 * np.sin(np.deg2rad(STANDARD_PARALLEL_DEG)) ** 2)

EASE_CRS = {
    "grid_mapping_name": "lambert_cylindrical_equal_area",
    "standard_parallel": 30.0,
    "longitude_of_central_meridian": 0.0,
    "false_easting": 0.0,
    "false_northing": 0.0,
    "semi_major_axis": 6378137.0,
    "inverse_flattening": 298.257223563,
    "epsg_code": "EPSG:6933",
}


@dataclass(frozen=True)
class EaseGrid:
    """One resolution: cell size (m), number of columns and rows; row 0 is the northernmost."""

    name: str
    cell_m: float
    columns: int
    rows: int


GRIDS = {
    36: EaseGrid("EASE2_M36km", 36032.220840584, 964, 406),
    9: EaseGrid("EASE2_M09km", 9008.055210146, 3856, 1624),
    3: EaseGrid("EASE2_M03km", 3002.6850700487, 11568, 4872),
}


def ease_grid(resolution_km: int) -> EaseGrid:
    """The grid of 3, 9 or 36 km."""
    if resolution_km not in GRIDS:
        raise DomainError("No such EASE-Grid 2.0.", field="resolution_km", value=resolution_km, accepted="3, 9 or 36")
    return GRIDS[resolution_km]


def _authalic(latitude_deg: FloatArray) -> FloatArray:
    """q of Snyder (1987), eq. 3-12."""
    sine = np.sin(np.deg2rad(latitude_deg))
    return (1.0 - _E2) * (
        sine / (1.0 - _E2 * sine**2)
        - np.log((1.0 - ECCENTRICITY * sine) / (1.0 + ECCENTRICITY * sine)) / (2.0 * ECCENTRICITY)
    )


def to_metres(latitude_deg: FloatArray, longitude_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Projected x, y (m, EPSG:6933) of positions (deg, any longitude convention), any shape (Snyder 1987, eq.
    10-15).
    """
    longitude = (np.asarray(longitude_deg, dtype=np.float64) + 180.0) % 360.0 - 180.0
    x = SEMI_MAJOR_M * _K0 * np.deg2rad(longitude)
    return x, SEMI_MAJOR_M * _authalic(np.asarray(latitude_deg, dtype=np.float64)) / (2.0 * _K0)


def row_column(
    latitude_deg: FloatArray, longitude_deg: FloatArray, resolution_km: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row and column of the cell that holds each position; -1, -1 beyond the grid (|latitude| over 85.04 deg)."""
    grid = ease_grid(resolution_km)
    x, y = to_metres(latitude_deg, longitude_deg)
    row = np.floor((Y_MAX_M - y) / grid.cell_m)
    column = np.floor((x - X_MIN_M) / grid.cell_m)
    inside = (row >= 0) & (row < grid.rows) & (column >= 0) & (column < grid.columns)
    return np.where(inside, row, -1).astype(np.int32), np.where(inside, column, -1).astype(np.int32)


def centre(row: NDArray, column: NDArray, resolution_km: int) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude (deg) of cell centres."""
    grid = ease_grid(resolution_km)
    x = X_MIN_M + (np.asarray(column, dtype=np.float64) + 0.5) * grid.cell_m
    y = Y_MAX_M - (np.asarray(row, dtype=np.float64) + 0.5) * grid.cell_m
    return _latitude(y), np.rad2deg(x / (SEMI_MAJOR_M * _K0))


def _latitude(y: FloatArray) -> FloatArray:
    """Geodetic latitude of y: authalic latitude, then Newton steps on q (converges to 1e-12 deg in 6)."""
    target = 2.0 * np.asarray(y) * _K0 / SEMI_MAJOR_M
    latitude = np.arcsin(np.clip(target / _authalic(np.array(90.0)), -1.0, 1.0))
    for _ in range(6):
        sine = np.sin(latitude)
        slope = 2.0 * (1.0 - _E2) * np.cos(latitude) / (1.0 - _E2 * sine**2) ** 2
        latitude = latitude + (target - _authalic(np.rad2deg(latitude))) / np.maximum(slope, 1e-12)
    return np.rad2deg(latitude)


def centre_metres(row: NDArray, column: NDArray, resolution_km: int) -> tuple[FloatArray, FloatArray]:
    """Projected x, y (m) of cell centres."""
    grid = ease_grid(resolution_km)
    return X_MIN_M + (np.asarray(column) + 0.5) * grid.cell_m, Y_MAX_M - (np.asarray(row) + 0.5) * grid.cell_m


def cell_coordinates(rows: NDArray, columns: NDArray, resolution_km: int) -> dict[str, Any]:
    """CF coordinates of a block of cells: ``y``, ``x`` (m, EPSG:6933) and ``latitude``, ``longitude`` (degrees)."""
    x, _ = centre_metres(np.zeros_like(columns), columns, resolution_km)
    _, y = centre_metres(rows, np.zeros_like(rows), resolution_km)
    latitude, longitude = centre(*np.meshgrid(rows, columns, indexing="ij"), resolution_km)
    flat = ("y", "x")
    return {
        "y": ("y", y, {"standard_name": "projection_y_coordinate", "units": "m"}),
        "x": ("x", x, {"standard_name": "projection_x_coordinate", "units": "m"}),
        "latitude": (flat, latitude, {"standard_name": "latitude", "units": "degrees_north"}),
        "longitude": (flat, longitude, {"standard_name": "longitude", "units": "degrees_east"}),
    }


def corner_transform(grid: xr.Dataset, resolution_km: int) -> Affine:
    """Affine map from (column, row) of a cell's corner to EPSG:6933, for a grid whose first row is the northernmost."""
    cell_m = ease_grid(resolution_km).cell_m
    west = float(grid["x"].to_numpy()[0]) - cell_m / 2.0
    north = float(grid["y"].to_numpy()[0]) + cell_m / 2.0
    return Affine(cell_m, 0.0, west, 0.0, -cell_m, north)
