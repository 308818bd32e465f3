"""The fuel moisture forecast as a CF grid."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from services.prioritization.fuel_moisture import LAG_H, FuelMoisture
from services.prioritization.weather import WeatherGrid


def to_dataset(result: FuelMoisture, grid: WeatherGrid) -> xr.Dataset:
    """Moisture (per cent) and variance (per cent squared) of each class on (time, latitude, longitude)."""
    shape = (len(grid.time), len(grid.latitude_deg), len(grid.longitude_deg))
    dimensions = ("time", "latitude", "longitude")
    data: dict[str, Any] = {}
    for index, lag in enumerate(LAG_H):
        label = f"{lag:g}-h dead fuel moisture"
        moisture = result.moisture_pct[:, index].reshape(shape).astype(np.float32)
        variance = result.variance[:, index].reshape(shape).astype(np.float32)
        data[f"fuel_moisture_{lag:g}h_pct"] = (dimensions, moisture, {"long_name": label, "units": "percent"})
        data[f"fuel_moisture_{lag:g}h_variance"] = (
            dimensions,
            variance,
            {"long_name": f"variance of {label}", "units": "percent2"},
        )
    data["hours_without_weather"] = (
        ("latitude", "longitude"),
        result.hours_without_weather.reshape(shape[1:]).astype(np.int32),
        {"long_name": "hours carried on without weather; all hours: the cell has no value", "units": "h"},
    )
    coordinates = {
        "time": ("time", grid.time),
        "latitude": ("latitude", grid.latitude_deg, {"units": "degrees_north", "standard_name": "latitude"}),
        "longitude": ("longitude", grid.longitude_deg, {"units": "degrees_east", "standard_name": "longitude"}),
    }
    return xr.Dataset(data, coords=coordinates, attrs={"title": "Dead fuel moisture with its variance"})
