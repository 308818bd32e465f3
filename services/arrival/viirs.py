"""VIIRS 375 m active-fire granules (VNP14IMG, VJ114IMG) as rows of the detections contract."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from shared.errors import DomainError

LAND = 5
# The product has three classes; a threshold of 70 is meant to drop the low one and keep nominal detections, which are
# most of those at night.
CONFIDENCE = {7: 20.0, 8: 75.0, 9: 95.0}
ALTITUDE_KM, EARTH_KM, NADIR_M = 829.0, 6371.0, 375.0
# Scan angle (degrees) at the edges of the three aggregation zones of the imagery bands, and samples from nadir there.
ZONE_ANGLES, ZONE_SAMPLES = (0.0, 31.72, 44.86, 56.28), (0, 1184, 1920, 3200)
SATELLITES = {"NPP": "SUOMI NPP", "J1": "NOAA 20", "JPSS-1": "NOAA 20", "JPSS-2": "NOAA 21"}
MAX_MISFIT_DEG = 0.004
Floats = NDArray[np.float64]


def footprint_m(sample: NDArray[np.integer]) -> tuple[Floats, Floats]:
    """(along, across) size in m of imagery pixels by sample (0..6399), on a spherical Earth; 375 m at nadir to 0.8
    km.
    """
    off = np.minimum(np.abs(np.asarray(sample, float) + 0.5 - 3200.0), 3199.5)
    angle = np.radians(np.interp(off, ZONE_SAMPLES, ZONE_ANGLES))
    zone = np.clip(np.searchsorted(ZONE_SAMPLES, off, side="right") - 1, 0, 2)
    step = np.radians(np.diff(ZONE_ANGLES) / np.diff(ZONE_SAMPLES))[zone]
    ratio = (EARTH_KM + ALTITUDE_KM) / EARTH_KM
    local = np.arcsin(ratio * np.sin(angle))
    across = EARTH_KM * 1e3 * (ratio * np.cos(angle) / np.cos(local) - 1.0) * step
    slant = EARTH_KM * (ratio * np.cos(angle) - np.cos(local))
    return NADIR_M * slant / ALTITUDE_KM, across


def _fit_positions(line: Floats, sample: Floats, position: Floats, at_line: Floats, at_sample: Floats) -> Floats:
    """Positions (n, 2) at pixels from those at fire pixels: a plane in line and sample, robust against single
    misfits.
    """
    design = np.column_stack([np.ones_like(line), line - line.mean(), sample - sample.mean()])
    keep = np.ones(line.size, bool)
    for _ in range(3):
        plane, *_ = np.linalg.lstsq(design[keep], position[keep], rcond=None)
        misfit = np.hypot(*(design @ plane - position).T)
        keep = misfit <= max(3 * float(np.median(misfit)), 1e-6)
    if float(np.median(misfit)) > MAX_MISFIT_DEG:
        return np.zeros((0, 2))  # an area so wide that the swath is no plane in it
    return np.column_stack([np.ones_like(at_line), at_line - line.mean(), at_sample - sample.mean()]) @ plane


def read_viirs(path: str | Path, area: tuple[float, float, float, float], margin_pixels: int = 40) -> gpd.GeoDataFrame:
    """Fire pixels within `area` (lon_min, lat_min, lon_max, lat_max; degrees), and clear land around them as no-fire
    looks.

    The product gives positions at fire pixels only, so those of land pixels come from a fit to the fire pixels in
    the area (at least six on a plane, to half a pixel, else no no-fire rows). Cloud, water, glint and unprocessed
    pixels yield nothing: nobody looked there. The time is the middle of the granule, `delivered_at` six hours later.
    Raises DomainError for a file that is no such granule.
    """
    try:
        with netCDF4.Dataset(str(path)) as granule:
            mask = np.asarray(granule["fire mask"][:])
            names = ("FP_line", "FP_sample", "FP_longitude", "FP_latitude", "FP_confidence", "FP_power")
            columns = [np.asarray(granule[name][:], float) for name in names]
            times = pd.to_datetime([granule.StartTime, granule.EndTime], utc=True)
            satellite = str(granule.Satellite)
    except (OSError, IndexError, AttributeError) as error:
        message = f"'{Path(path).name}' is no VIIRS active-fire granule: {error}"
        raise DomainError(
            message, field="path", value=Path(path).name, accepted="VNP14IMG or VJ114IMG netCDF"
        ) from error
    line, sample, lon, lat, confidence, power = columns
    inside = (lon >= area[0]) & (lon <= area[2]) & (lat >= area[1]) & (lat <= area[3])
    rows = [_rows(lon[inside], lat[inside], sample[inside].astype(int), True)]
    rows[0]["confidence"] = [CONFIDENCE.get(int(value), np.nan) for value in confidence[inside]]
    rows[0]["frp_mw"] = power[inside]
    if inside.sum() >= 6:
        rows.append(
            _land_around(mask, line[inside], sample[inside], np.column_stack([lon, lat])[inside], area, margin_pixels)
        )
    frame = pd.concat(rows, ignore_index=True)
    middle = (times[0] + (times[1] - times[0]) / 2).floor("ms")
    frame = frame.assign(
        time=middle,
        delivered_at=middle + pd.Timedelta(hours=6),
        satellite=SATELLITES.get(satellite, satellite),
        instrument="VIIRS",
    )
    geometry = gpd.points_from_xy(frame.pop("longitude"), frame.pop("latitude"))
    return gpd.GeoDataFrame(frame, geometry=geometry, crs="EPSG:4326")


def _rows(lon: Floats, lat: Floats, sample: NDArray[np.integer], fire: bool) -> pd.DataFrame:
    along, across = footprint_m(sample)
    empty = np.full(lon.size, np.nan)
    return pd.DataFrame(
        {
            "longitude": lon,
            "latitude": lat,
            "along_m": along,
            "across_m": across,
            "fire": fire,
            "confidence": empty,
            "frp_mw": empty,
        }
    )


def _land_around(
    mask: NDArray[np.integer],
    line: Floats,
    sample: Floats,
    position: Floats,
    area: tuple[float, float, float, float],
    margin: int,
) -> pd.DataFrame:
    top, bottom = max(int(line.min()) - margin, 0), min(int(line.max()) + margin + 1, mask.shape[0])
    left, right = max(int(sample.min()) - margin, 0), min(int(sample.max()) + margin + 1, mask.shape[1])
    at_line, at_sample = np.nonzero(mask[top:bottom, left:right] == LAND)
    at_line, at_sample = at_line + top, at_sample + left
    fitted = _fit_positions(line, sample, position, at_line.astype(float), at_sample.astype(float))
    if len(fitted) == 0:
        return _rows(np.zeros(0), np.zeros(0), np.zeros(0, int), False)
    lon, lat = fitted.T
    inside = (lon >= area[0]) & (lon <= area[2]) & (lat >= area[1]) & (lat <= area[3])
    return _rows(lon[inside], lat[inside], at_sample[inside], False)
