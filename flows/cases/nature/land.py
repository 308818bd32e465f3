"""Terrain, fuels and static surface of a nature run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from flows.cases.nature.fields import KM_PER_DEG, RandomField, random_field, rough_field, smooth_step
from flows.cases.nature.setting import FloatArray, Setting

WATER, BARREN = 254, 252  # USGS codes of the WFPI family
RELIEF_LENGTHS_KM = (60.0, 20.0, 7.0, 2.5)
RELIEF_M = (330.0, 170.0, 75.0, 28.0)


@dataclass(frozen=True)
class Land:
    """The ground of a nature run; every method takes positions in degrees and is consistent across grids."""

    relief: tuple[RandomField, ...]
    greenness: RandomField
    fuel: RandomField
    lakes: RandomField
    texture: RandomField

    def elevation_m(self, longitude: ArrayLike, latitude: ArrayLike) -> FloatArray:
        """Height above the ellipsoid, m."""
        total = np.full(np.broadcast_shapes(np.shape(longitude), np.shape(latitude)), 1900.0)
        for field, scale in zip(self.relief, RELIEF_M, strict=True):
            total += scale * field.at(longitude, latitude)
        return np.maximum(total, 400.0)

    def water_fraction(self, longitude: ArrayLike, latitude: ArrayLike) -> FloatArray:
        """Share of open water, 0..1: a few small lakes."""
        return smooth_step(self.lakes.at(longitude, latitude), 2.5, 2.9)

    def mean_ndvi(self, longitude: ArrayLike, latitude: ArrayLike) -> FloatArray:
        """Mean NDVI: greener where higher, with patches of some 30 km."""
        forest = smooth_step(self.elevation_m(longitude, latitude), 1300.0, 2500.0)
        return np.clip(0.22 + 0.28 * forest + 0.07 * self.greenness.at(longitude, latitude), 0.08, 0.85)

    def fuel_factor(self, longitude: ArrayLike, latitude: ArrayLike) -> FloatArray:
        """Multiplier of the rate of spread: 0 on water, 0.12 to 2 elsewhere."""
        factor = np.clip(0.7 * np.exp(0.6 * self.fuel.at(longitude, latitude)), 0.12, 2.0)
        return np.where(self.water_fraction(longitude, latitude) > 0.5, 0.0, factor)


def make_land(setting: Setting) -> Land:
    """The ground from the setting's seed."""
    rng = setting.generator("land")
    return Land(
        relief=rough_field(rng, RELIEF_LENGTHS_KM),
        greenness=random_field(rng, 30.0),
        fuel=random_field(rng, 2.5, modes=64),
        lakes=random_field(rng, 6.0),
        texture=random_field(rng, 25.0),
    )


def slope_deg(elevation_m: FloatArray, longitude: FloatArray, latitude: FloatArray) -> FloatArray:
    """Slope of a grid (latitude, longitude) of heights, degrees."""
    north_m = latitude * KM_PER_DEG * 1e3
    east_m = longitude * KM_PER_DEG * 1e3 * np.cos(np.radians(latitude.mean()))
    along, across = np.gradient(elevation_m, north_m, east_m)
    return np.degrees(np.arctan(np.hypot(along, across)))


def fuels_dataset(
    setting: Setting, land: Land, ndvi: dict[str, FloatArray] | None = None, wetness: FloatArray | None = None
) -> xr.Dataset:
    """The fuels grid of the case (``fuels.nc`` of the case contract), state at the first cut-off.

    ``ndvi`` replaces the simulated ``ndvi``, ``ndvi_min`` and ``ndvi_max``; ``wetness`` is the recent rain in mm on the
    same grid, which lowers the drought codes.
    """
    longitude, latitude = setting.axes(setting.fuels_step_deg)
    across, up = setting.mesh(setting.fuels_step_deg)
    values = _vegetation(setting, land, across, up, ndvi)
    values["elevation_m"] = land.elevation_m(across, up)
    values["slope_deg"] = slope_deg(values["elevation_m"], longitude, latitude)
    values |= _drought(setting, across, up, np.zeros(across.shape) if wetness is None else wetness)
    dry, wet = soil_range(land, across, up)
    values |= {"soil_moisture_q05": dry, "soil_moisture_q95": wet}
    dims = ("latitude", "longitude")
    dataset = xr.Dataset(
        {name: (dims, field.astype(np.float32)) for name, field in values.items()},
        coords={"latitude": latitude, "longitude": longitude},
        attrs={"state_time": setting.first_cutoff.strftime("%Y-%m-%dT%H:%M:%SZ")},
    )
    water = land.water_fraction(across, up) > 0.5
    barren = values["ndvi_max"] < 0.12
    dataset["mask_code"] = (dims, np.where(water, WATER, np.where(barren, BARREN, 0)).astype(np.uint8))
    return dataset


def soil_range(land: Land, longitude: FloatArray, latitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The 5 and 95 % quantiles of soil moisture, m³/m³, from the clay content."""
    clay = clay_fraction(land, longitude, latitude)
    return 0.03 + 0.12 * clay, 0.22 + 0.35 * clay


def clay_fraction(land: Land, longitude: FloatArray, latitude: FloatArray) -> FloatArray:
    """Clay content of the soil, 0..1."""
    return np.clip(0.2 + 0.06 * land.texture.at(longitude, latitude), 0.05, 0.45)


def _vegetation(
    setting: Setting, land: Land, across: FloatArray, up: FloatArray, ndvi: dict[str, FloatArray] | None
) -> dict[str, FloatArray]:
    if ndvi is None:
        mean = land.mean_ndvi(across, up)
        dryness = random_field(setting.generator("greenness"), 40.0).at(across, up)
        low, high = np.clip(mean - 0.14, 0.03, None), np.clip(mean + 0.16, None, 0.92)
        now = np.clip(low + (high - low) * np.clip(0.35 + 0.15 * dryness, 0.05, 0.95), low, high)
        ndvi = {"ndvi": now, "ndvi_min": low, "ndvi_max": high}
    dense = smooth_step(ndvi["ndvi_max"], 0.2, 0.7)
    return dict(ndvi) | {
        "live_load": 0.15 + 0.9 * dense,  # kg/m², shrub to conifer with understorey
        "dead_load": 0.35 + 1.6 * dense,
        "extinction_pct": 15.0 + 10.0 * dense,
    }


def _drought(setting: Setting, across: FloatArray, up: FloatArray, wetness: FloatArray) -> dict[str, FloatArray]:
    rng = setting.generator("drought")
    dry, fine = random_field(rng, 60.0).at(across, up), random_field(rng, 20.0).at(across, up)
    relief = np.clip(1.0 - wetness / 120.0, 0.3, 1.0)
    return {
        "kbdi": np.clip((115.0 + 22.0 * dry) * relief, 5.0, 200.0),
        "dmc": np.clip((85.0 + 20.0 * dry + 6.0 * fine) * relief, 6.0, 300.0),
        "dc": np.clip((480.0 + 90.0 * dry) * np.sqrt(relief), 15.0, 900.0),
        "ffmc": np.clip(90.5 + 1.8 * fine, 60.0, 97.0),
        "annual_rain_mm": np.clip(430.0 - 70.0 * dry, 150.0, 900.0),
    }
