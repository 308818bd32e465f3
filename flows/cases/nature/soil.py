"""Daily soil moisture, the surface as a radar sees it, and the SMAP-like product of the weeks before the fires."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr
from pyproj import Transformer

from flows.cases.nature.fields import random_field
from flows.cases.nature.land import Land, clay_fraction, soil_range
from flows.cases.nature.setting import FloatArray, Setting
from flows.cases.nature.weather import Weather

DRYING_DAYS = 8.0
ACTIVE_DEPTH_MM = 60.0
# EASE-Grid 2.0 global, 9 km (Brodzik et al. 2012, doi:10.3390/ijgi1010032; NSIDC EASE2_M09km).
EASE_X_MIN_M, EASE_Y_MAX_M, EASE_CELL_M = -17367530.45, 7314540.83, 9008.055210146
SMAP_NOISE = 0.03


def surface_dataset(
    setting: Setting, land: Land, weather: Weather, burn_time_s: FloatArray, reference_time: str
) -> xr.Dataset:
    """The surface grid (``surface.nc`` of the case contract).

    ``burn_time_s`` is the burn grid: seconds since ``reference_time``, NaN unburned, shape (latitude_burn,
    longitude_burn) on the axes of ``setting.burn_step_deg``.
    """
    longitude, latitude = setting.axes(setting.soil_step_deg)
    across, up = setting.mesh(setting.soil_step_deg)
    moisture, hours = daily_soil_moisture(setting, land, weather, across, up)
    static = _static_surface(setting, land, across, up)
    burn_longitude, burn_latitude = setting.axes(setting.burn_step_deg)
    dataset = xr.Dataset(
        {name: (("latitude", "longitude"), field.astype(np.float32)) for name, field in static.items()},
        coords={
            "time": ("time", setting.times(hours)),
            "latitude": latitude,
            "longitude": longitude,
            "latitude_burn": burn_latitude,
            "longitude_burn": burn_longitude,
        },
        attrs={"reference_time": reference_time, "source": "simulated"},
    )
    dataset["soil_moisture"] = (("time", "latitude", "longitude"), moisture.astype(np.float32))
    dataset["burn_time"] = (("latitude_burn", "longitude_burn"), burn_time_s.astype(np.float32))
    dataset["burn_time"].attrs = {"units": "s", "reference_time": reference_time, "long_name": "fire arrival"}
    dataset["time"].encoding = {"units": f"seconds since {setting.start:%Y-%m-%d %H:%M:%S}", "dtype": "int64"}
    return dataset


def daily_soil_moisture(
    setting: Setting, land: Land, weather: Weather, across: FloatArray, up: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Soil moisture m³/m³ (day, *position) and the days' hours: a bucket filled by rain that dries exponentially."""
    dry, wet = soil_range(land, across, up)
    patches = random_field(setting.generator("soil"), 12.0).at(across, up)
    moisture = dry + (wet - dry) * np.clip(0.28 + 0.1 * patches, 0.03, 0.9)
    hours = np.arange(0.0, np.ceil(setting.end_h / 24.0) * 24.0 + 24.5, 24.0)
    days = []
    for hour in hours:
        days.append(moisture)
        rain = weather.storms.rain_mm(across, up, hour, hour + 24.0)
        residual = dry + (wet - dry) * np.clip(0.06 + 0.03 * patches, 0.0, 0.3)
        moisture = residual + (moisture - residual) * np.exp(-1.0 / DRYING_DAYS) + rain / ACTIVE_DEPTH_MM
        moisture = np.clip(moisture, 0.02, wet)
    return np.stack(days), hours


def _static_surface(setting: Setting, land: Land, across: FloatArray, up: FloatArray) -> dict[str, FloatArray]:
    ndvi = land.mean_ndvi(across, up)
    rough = random_field(setting.generator("roughness"), 6.0).at(across, up)
    return {
        "vod": np.clip(0.05 + 0.9 * (ndvi - 0.08), 0.02, 0.8),
        "roughness_cm": np.clip(1.3 + 0.35 * rough, 0.5, 3.0),
        "clay_fraction": clay_fraction(land, across, up),
        "water_fraction": land.water_fraction(across, up),
        "elevation_m": land.elevation_m(across, up),
    }


def ease_cells(setting: Setting, every: int = 1) -> pd.DataFrame:
    """EASE-Grid 2.0 9 km cells whose centre lies in the region: row, column, longitude_deg, latitude_deg.

    ``every``: only those whose row and column it divides.
    """
    forward = Transformer.from_crs(4326, 6933, always_xy=True)
    west, south, east, north = setting.region
    x, y = forward.transform(np.array([west, east]), np.array([south, north]))
    first_column, last_column = np.floor((x - EASE_X_MIN_M) / EASE_CELL_M).astype(int)
    last_row, first_row = np.floor((EASE_Y_MAX_M - y) / EASE_CELL_M).astype(int)
    columns, rows = np.arange(first_column, last_column + 1), np.arange(first_row, last_row + 1)
    columns, rows = columns[columns % every == 0], rows[rows % every == 0]
    column, row = (part.ravel() for part in np.meshgrid(columns, rows))
    longitude, latitude = Transformer.from_crs(6933, 4326, always_xy=True).transform(
        EASE_X_MIN_M + (column + 0.5) * EASE_CELL_M, EASE_Y_MAX_M - (row + 0.5) * EASE_CELL_M
    )
    cells = pd.DataFrame({"row": row, "column": column, "longitude_deg": longitude, "latitude_deg": latitude})
    inside = cells.longitude_deg.between(west, east) & cells.latitude_deg.between(south, north)
    return cells[inside].reset_index(drop=True)


def smap_table(setting: Setting, land: Land, weather: Weather, every: int = 1) -> pd.DataFrame:
    """SMAP-like soil moisture of the days before the first cut-off: time, row, column, soil_moisture.

    At 6 h local solar time, every second or third day a cell, with an error of 0.03 m³/m³ a look and none later
    than a day before the first cut-off (its latency). ``every``: of every so manieth row and column only.
    """
    cells = ease_cells(setting, every)
    across, up = cells.longitude_deg.to_numpy(), cells.latitude_deg.to_numpy()
    moisture, hours = daily_soil_moisture(setting, land, weather, across, up)
    rng = setting.generator("smap")
    local_six_h = (6.0 - setting.centre[0] / 15.0 - setting.start.hour) % 24.0
    tables = []
    for day, hour in enumerate(hours[:-1]):
        seen = (day + np.floor((across - setting.region[0]) / 1.1).astype(int)) % 5 % 2 == 0  # on days 0, 2, 4 of five
        noisy = np.clip(moisture[day] + SMAP_NOISE * rng.normal(size=len(cells)), 0.02, 0.6)
        if hour + local_six_h <= setting.cutoff_h - 24.0:
            look = cells.loc[seen, ["row", "column"]].assign(
                time=pd.Timestamp(setting.time(hour + local_six_h)), soil_moisture=np.round(noisy[seen], 4)
            )
            tables.append(look)
    table = pd.concat(tables, ignore_index=True)
    return table.astype({"row": "int32", "column": "int32"})[["time", "row", "column", "soil_moisture"]]
