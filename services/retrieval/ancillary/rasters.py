"""Values of any raster at places: by the raster's own CRS, tile by tile, so that a map of the globe is never loaded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyproj
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioIOError
from rasterio.io import DatasetReader, MemoryFile
from rasterio.transform import from_bounds
from rasterio.windows import Window

from shared.errors import DomainError

FloatArray = NDArray[np.float64]

TILE = 1024  # pixels a side read at once
HDF4_MAGIC = b"\x0e\x03\x13\x01"
SINUSOIDAL = "+proj=sinu +lon_0=0 +x_0=0 +y_0=0 +R=6371007.181 +units=m +no_defs"  # MODIS land tiles


@contextmanager
def open_raster(path: str | Path, layer: str | None = None, field: str = "raster") -> Iterator[DatasetReader]:
    """An open raster with a CRS: whatever GDAL reads, and MODIS land tiles in HDF4 (``layer`` names the data set).

    DomainError where it cannot be read, or has no CRS.
    """
    with open(path, "rb") as file:
        hdf4 = file.read(4) == HDF4_MAGIC
    name = Path(path).name
    if hdf4:
        with _modis_tile(path, layer, field) as tile:
            yield tile
        return
    try:
        opened = rasterio.open(str(path))
    except (RasterioIOError, ValueError) as error:
        raise DomainError(
            f"'{name}' cannot be read as a raster: {error}", field=field, value=name, accepted="GeoTIFF or the like"
        ) from error
    with opened:
        if opened.crs is None:
            raise DomainError(f"'{name}' has no CRS.", field=field, value=name, accepted="a georeferenced raster")
        yield opened


@contextmanager
def _modis_tile(path: str | Path, layer: str | None, field: str) -> Iterator[DatasetReader]:
    """A data set of a MODIS sinusoidal tile (MCD64A1 and the like, HDF4), its corners from ``StructMetadata.0``."""
    from pyhdf.error import HDF4Error
    from pyhdf.SD import SD, SDC

    name = Path(path).name
    try:
        file = SD(str(path), SDC.READ)
        values = file.select(layer or next(iter(file.datasets())))[:]
        metadata = str(file.attributes().get("StructMetadata.0", ""))
    except (HDF4Error, StopIteration) as error:
        raise DomainError(
            f"'{name}' cannot be read as HDF4: {error}", field=field, value=layer or name, accepted="a MODIS land tile"
        ) from error
    corners = [
        re.search(rf"{corner}=\(\s*([-\d.eE+]+)\s*,\s*([-\d.eE+]+)\s*\)", metadata)
        for corner in ("UpperLeftPointMtrs", "LowerRightMtrs")
    ]
    if values.ndim != 2 or None in corners:
        raise DomainError(f"'{name}' holds no sinusoidal grid.", field=field, value=name, accepted="a MODIS land tile")
    (west, north), (east, south) = ([float(number) for number in found.groups()] for found in corners if found)
    height, width = values.shape
    with MemoryFile() as memory:
        profile = {"driver": "GTiff", "count": 1, "height": height, "width": width, "dtype": values.dtype.name}
        transform = from_bounds(west, south, east, north, width, height)
        with memory.open(crs=SINUSOIDAL, transform=transform, **profile) as draft:
            draft.write(values, 1)
        with memory.open() as opened:
            yield opened


def pixel_positions(
    source: DatasetReader, longitude_deg: FloatArray, latitude_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fractional row and column (0 at the outer edge of the first pixel) of places, any shape; NaN off the CRS."""
    crs = pyproj.CRS.from_wkt(source.crs.to_wkt())
    longitude = (np.asarray(longitude_deg, dtype=np.float64) + 180.0) % 360.0 - 180.0
    x, y = pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(longitude, latitude_deg)
    if crs.is_geographic:  # a map may run 0..360
        x = np.where(np.asarray(x) < min(source.bounds.left, source.bounds.right), np.asarray(x) + 360.0, x)
    inverse = ~source.transform
    column = inverse.a * np.asarray(x) + inverse.b * np.asarray(y) + inverse.c
    row = inverse.d * np.asarray(x) + inverse.e * np.asarray(y) + inverse.f
    finite = np.isfinite(row) & np.isfinite(column)
    return np.where(finite, row, np.nan), np.where(finite, column, np.nan)


def values_at(source: DatasetReader, row: FloatArray, column: FloatArray, band: int = 1) -> FloatArray:
    """Values of the pixels that hold the positions, any shape; NaN off the raster and where it holds no data."""
    flat_row, flat_column = np.floor(np.ravel(row)), np.floor(np.ravel(column))
    inside = (flat_row >= 0) & (flat_row < source.height) & (flat_column >= 0) & (flat_column < source.width)
    found = np.full(flat_row.size, np.nan)
    index = np.flatnonzero(inside)
    rows, columns = flat_row[index].astype(np.int64), flat_column[index].astype(np.int64)
    tiles = (rows // TILE) * (source.width // TILE + 1) + columns // TILE
    order = np.argsort(tiles, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(tiles[order])) + 1):
        if not part.size:
            continue
        top, left = int(rows[part[0]] // TILE * TILE), int(columns[part[0]] // TILE * TILE)
        window = Window(left, top, min(TILE, source.width - left), min(TILE, source.height - top))
        block = source.read(band, window=window, masked=True)
        picked = block[rows[part] - top, columns[part] - left]
        found[index[part]] = np.ma.filled(picked.astype(np.float64), np.nan)
    return found.reshape(np.shape(row))


def sample(source: DatasetReader, longitude_deg: FloatArray, latitude_deg: FloatArray, band: int = 1) -> FloatArray:
    """Value of the pixel under each place (classes, codes, dates), any shape; NaN where there is none."""
    return values_at(source, *pixel_positions(source, longitude_deg, latitude_deg), band)


def interpolate(
    source: DatasetReader, longitude_deg: FloatArray, latitude_deg: FloatArray, band: int = 1
) -> FloatArray:
    """Bilinear value between pixel centres (heights and other fields), any shape; NaN where a neighbour is missing."""
    row, column = pixel_positions(source, longitude_deg, latitude_deg)
    row, column = row - 0.5, column - 0.5
    top, left = np.floor(row), np.floor(column)
    down, right = row - top, column - left
    last_row, last_column = source.height - 1.0, source.width - 1.0
    outside = (row < -0.5) | (row > last_row + 0.5) | (column < -0.5) | (column > last_column + 0.5)
    total = np.zeros(np.shape(row))
    for step_row, weight_row in ((0, 1.0 - down), (1, down)):
        for step_column, weight_column in ((0, 1.0 - right), (1, right)):
            at_row, at_column = np.clip(top + step_row, 0, last_row), np.clip(left + step_column, 0, last_column)
            weight = weight_row * weight_column
            total = total + np.where(weight > 0, weight * values_at(source, at_row, at_column, band), 0.0)
    return np.where(outside | ~np.isfinite(row), np.nan, total)
