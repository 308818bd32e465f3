"""Rasters and the manifest that wrfxweb shows: per domain, time and variable a picture with its corners.

Structure as wrfxpy writes it: {domain: {time: {variable: {raster, coords, colorbar, kml, tiff}}}}, times ISO 8601 with
Z and underscore-free; pictures are in web Mercator, so that the four corners place them without distortion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image
from rasterio.crs import CRS
from rasterio.transform import Affine, array_bounds
from rasterio.warp import Resampling, calculate_default_transform, reproject

from services.arrival.exports.geotiff import transform_of
from services.arrival.exports.isochrones import levels
from services.arrival.exports.product import iso
from services.arrival.inference import ArrivalMap

WEB_RADIUS_M = 6_378_137.0
MOST_TIMES = 8
FIRE_AREA, ARRIVAL = "FIRE_AREA", "TIGN_G"
# From the earliest arrival (dark) to the latest (light); index 0 is transparent.
FIRST_RGB, LAST_RGB = np.array([90, 0, 30.0]), np.array([255, 225, 120.0])
STEPS = 200
Floats = NDArray[np.float64]
Write = Any


def mercator(values: NDArray[np.float32], arrival: ArrivalMap) -> tuple[NDArray[np.float32], list[list[float]]]:
    """A north-up float band on the web Mercator grid (NaN outside), and its corners [longitude, latitude], degrees:
    upper left, upper right, lower right, lower left."""
    source, height, width = transform_of(arrival.grid), *values.shape
    crs = CRS.from_epsg(arrival.grid.epsg)
    bounds = array_bounds(height, width, source)
    # Web Mercator turned to the fire's own meridian: the same picture, and none is torn at the antimeridian.
    meridian = round(float(arrival.grid.degrees(arrival.grid.x_m.mean(), arrival.grid.y_m.mean())[0]))
    web = CRS.from_proj4(f"+proj=merc +a={WEB_RADIUS_M} +b={WEB_RADIUS_M} +lon_0={meridian} +units=m +no_defs")
    place, columns, rows = calculate_default_transform(crs, web, width, height, *bounds)
    out = np.full((rows, columns), np.nan, np.float32)
    reproject(
        values,
        out,
        src_transform=source,
        src_crs=crs,
        dst_transform=place,
        dst_crs=web,
        src_nodata=np.nan,
        dst_nodata=np.nan,
        resampling=Resampling.nearest,
    )
    return out, _corners(place, rows, columns, meridian)


def _corners(place: Affine, rows: int, columns: int, meridian_deg: float) -> list[list[float]]:
    x, y = np.array([place * corner for corner in ((0, 0), (columns, 0), (columns, rows), (0, rows))]).T
    lon = meridian_deg + np.degrees(x / WEB_RADIUS_M)
    lat = np.degrees(2 * np.arctan(np.exp(y / WEB_RADIUS_M)) - np.pi / 2)
    return [[round(float(a), 7), round(float(b), 7)] for a, b in zip(lon, lat, strict=True)]


def palette() -> list[int]:
    """256 colours: the first transparent, then the ramp of arrival."""
    share = np.linspace(0, 1, STEPS)[:, None]
    ramp = np.rint(FIRST_RGB + (LAST_RGB - FIRST_RGB) * share).astype(int)
    return [0, 0, 0, *ramp.ravel().tolist(), *([255] * 3 * (255 - STEPS))]


def write_raster(path: Path, values: NDArray[np.float32], low: float, high: float) -> None:
    """A palette PNG of values low..high; NaN is transparent."""
    share = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0)
    index = np.where(np.isfinite(values), 1 + np.rint(np.nan_to_num(share) * (STEPS - 1)), 0).astype(np.uint8)
    picture = Image.fromarray(index, mode="P")
    picture.putpalette(palette())
    picture.save(path, format="PNG", transparency=0, optimize=False)


def write_colorbar(path: Path, low: pd.Timestamp, high: pd.Timestamp) -> None:
    """The ramp with its first, middle and last time (UTC)."""
    from PIL import ImageDraw

    picture = Image.new("RGB", (190, 240), (255, 255, 255))
    share = np.linspace(1, 0, 200)[:, None, None]
    ramp = np.rint(FIRST_RGB + (LAST_RGB - FIRST_RGB) * share).astype(np.uint8)
    picture.paste(Image.fromarray(np.repeat(ramp, 26, axis=1)), (12, 30))
    draw = ImageDraw.Draw(picture)
    draw.text((12, 8), "arrival (UTC)", fill=(0, 0, 0))
    for height, time in ((30, high), (130, low + (high - low) / 2), (230, low)):
        draw.text((46, height - 6), time.strftime("%Y-%m-%d %H:%M"), fill=(0, 0, 0))
    picture.save(path, format="PNG", optimize=False)


def domain_entries(
    arrival: ArrivalMap, reference: pd.Timestamp, stem: str, new_file: Write, linked: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Pictures of one fire and their manifest entries by time; empty where nothing burned.

    `new_file(name)` gives the path to write a picture to; `linked` are the names of `kml` and `tiff` files, which go
    with the last time. FIRE_AREA is what had burned by a time, TIGN_G the arrival of all of it.
    """
    wanted = levels(arrival.arrival_h, reference, most=MOST_TIMES)
    if wanted.size == 0:
        return {}
    hours, coords = mercator(np.ascontiguousarray(arrival.arrival_h[::-1].astype(np.float32)), arrival)
    low, high = float(np.nanmin(hours)), float(wanted[-1])
    bar = f"wrfxweb_{stem}_colorbar.png"
    write_colorbar(new_file(bar), *(reference + pd.Timedelta(hours=h) for h in (low, high)))
    entries: dict[str, dict[str, Any]] = {}
    for level in wanted:
        time = iso(reference + pd.Timedelta(hours=float(level)))
        raster = f"wrfxweb_{stem}_{time.replace(':', '').replace('-', '')}.png"
        write_raster(new_file(raster), np.where(hours <= level + 1e-4, hours, np.nan), low, high)
        entries[time] = {FIRE_AREA: {"raster": raster, "coords": coords, "colorbar": bar}}
    entries[time][ARRIVAL] = {"raster": raster, "coords": coords, "colorbar": bar, **linked}
    return entries


def manifest(domains: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The manifest of several domains, numbered from 1 in their order."""
    return {str(number): dict(entries) for number, entries in enumerate(domains, start=1)}
