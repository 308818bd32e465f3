"""Real NDVI at the nodes of a case's grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from scipy.interpolate import RegularGridInterpolator

from flows.cases.nature.setting import FloatArray


def ndvi_at(monthly: Path, extremes: Path, month: int, across: FloatArray, up: FloatArray) -> dict[str, FloatArray]:
    """NDVI of a month (1 to 12) and the year's extremes at positions in degrees, bilinear: ndvi, ndvi_min, ndvi_max."""
    value = _sampled(monthly, month, across, up)
    low, high = _sampled(extremes, 1, across, up), _sampled(extremes, 2, across, up)
    return {"ndvi": np.clip(value, low, high), "ndvi_min": low, "ndvi_max": high}


def _sampled(path: Path, band: int, across: FloatArray, up: FloatArray) -> FloatArray:
    with rasterio.open(path) as raster:
        values = raster.read(band).astype(np.float64) / 10_000.0
        step, left, top = raster.transform.a, raster.transform.c, raster.transform.f
    longitude = left + step * (np.arange(values.shape[1]) + 0.5)
    latitude = top - step * (np.arange(values.shape[0]) + 0.5)
    inside = RegularGridInterpolator((latitude[::-1], longitude), values[::-1])
    return np.asarray(inside((up, across)))
