"""Ancillary features of looks: soil moisture, height, slope and land cover, from maps or from level-1 itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.ancillary.rasters import interpolate, open_raster, sample
from services.retrieval.ancillary.smap import latest_before

FloatArray = NDArray[np.float64]

ANCILLARY_FEATURES = ("ancillary_soil_moisture", "height_m", "slope_deg", "land_cover")
SLOPE_BASE_M = 500.0  # heights are compared this far to either side: the size of the first Fresnel zone
METRES_PER_DEGREE = 111_195.0


@dataclass(frozen=True)
class Layers:
    """What is known beside the looks; None: not given. Soil moisture as ``read_smap`` gives it, on EASE cells."""

    soil_moisture: pd.DataFrame | None = None
    soil_moisture_km: int = 9
    elevation: Path | None = None
    land_cover: Path | None = None


def with_ancillary(looks: pd.DataFrame, layers: Layers) -> pd.DataFrame:
    """The looks with ANCILLARY_FEATURES: a given layer where it has a value, else what level-1 says, else NaN."""
    found = {name: _known(looks, name) for name in ANCILLARY_FEATURES}
    latitude, longitude = looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy()
    if layers.soil_moisture is not None:
        moisture = latest_before(looks, layers.soil_moisture, resolution_km=layers.soil_moisture_km)
        found["ancillary_soil_moisture"] = _first(moisture, found["ancillary_soil_moisture"])
    if layers.elevation is not None:
        height, slope = terrain(layers.elevation, latitude, longitude)
        found["height_m"] = _first(height, found["height_m"])
        found["slope_deg"] = _first(slope, found["slope_deg"])
    if layers.land_cover is not None:
        with open_raster(layers.land_cover, field="land_cover") as source:
            found["land_cover"] = _first(sample(source, longitude, latitude), found["land_cover"])
    return looks.assign(**found)


def terrain(path: Path, latitude_deg: FloatArray, longitude_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height (m) and slope (deg) of places, (n,), from a raster of heights in metres, whatever its CRS.

    The slope is that of the plane through heights 500 m (a pixel, where pixels are larger) north, south, east and west.
    """
    with open_raster(path, field="elevation") as source:
        shrink = np.cos(np.deg2rad(latitude_deg))
        base = max(SLOPE_BASE_M, _pixel_m(source))
        step = base / METRES_PER_DEGREE
        height = interpolate(source, longitude_deg, latitude_deg)
        north = interpolate(source, longitude_deg, latitude_deg + step)
        south = interpolate(source, longitude_deg, latitude_deg - step)
        east = interpolate(source, longitude_deg + step / shrink, latitude_deg)
        west = interpolate(source, longitude_deg - step / shrink, latitude_deg)
    rise = np.hypot((north - south) / (2.0 * base), (east - west) / (2.0 * base))
    return height, np.rad2deg(np.arctan(rise))


def _pixel_m(source) -> float:
    """Side of a pixel in metres, from the raster's own unit."""
    side = max(abs(source.transform.a), abs(source.transform.e))
    return side * METRES_PER_DEGREE if source.crs.is_geographic else side * source.crs.linear_units_factor[1]


def _known(looks: pd.DataFrame, name: str) -> FloatArray:
    return looks[name].to_numpy(dtype=np.float64) if name in looks.columns else np.full(len(looks), np.nan)


def _first(preferred: FloatArray, other: FloatArray) -> FloatArray:
    return np.where(np.isfinite(preferred), preferred, other)
