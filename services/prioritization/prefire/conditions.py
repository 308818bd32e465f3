"""Burning conditions of each lead day, from the weather's own grid to the cells of the danger grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization import indices, weather
from shared.errors import DomainError

Array = npt.NDArray[np.floating[Any]]
Index = npt.NDArray[np.integer[Any]]

WEATHER_MISSING, WEATHER_INCOMPLETE = 4, 8
WHOLE_DAY_H = 24


@dataclass(frozen=True)
class DailyConditions:
    """Weather of the lead days on the weather's grid, each field (lead_day, latitude, longitude).

    Temperature and wind of the hottest hour, 24 h rain, 10-h moisture in per cent; ``hours`` counts the whole hours
    that each rests on, ``forecast_share`` is the part of the moisture that a fuel moisture forecast gave.
    """

    latitude_deg: Array
    longitude_deg: Array
    temperature_c: Array
    wind_speed_m_s: Array
    rain_mm: Array
    moisture_10h_pct: Array
    hours: Array
    forecast_share: float = 0.0

    @property
    def days(self) -> int:
        return len(self.hours)


@dataclass(frozen=True)
class BurningConditions:
    """Weather on cells of the danger grid, each (lead_day, y, x); ``flag`` the bits of this module."""

    temperature_c: Array
    wind_speed_m_s: Array
    rain_mm: Array
    moisture_10h_pct: Array
    flag: npt.NDArray[np.uint8]


def daily_conditions(
    grid: weather.WeatherGrid, forecast: xr.Dataset | None, start: pd.Timestamp, days: int = weather.LEAD_DAYS
) -> DailyConditions:
    """Conditions of ``days`` periods of 24 h from ``start``; 10-h moisture from the forecast, else 1.28 x EMC."""
    daily = weather.daily_burning_conditions(grid, start, days)
    burgan = indices.fuel_moisture_10h_pct(daily.temperature_max_c, daily.relative_humidity_min_pct)
    forecast_pct = _forecast_moisture(forecast, start, grid, days)
    known = np.isfinite(forecast_pct)
    return DailyConditions(
        grid.latitude_deg,
        grid.longitude_deg,
        daily.temperature_max_c,
        daily.wind_speed_m_s,
        daily.rain_mm,
        np.where(known, forecast_pct, burgan),
        daily.hours,
        float(known.mean()),
    )


def _forecast_moisture(forecast: xr.Dataset | None, start: pd.Timestamp, grid: weather.WeatherGrid, days: int) -> Array:
    """The day's lowest forecast 10-h moisture on the weather grid, NaN where there is none."""
    lowest = np.full((days, len(grid.latitude_deg), len(grid.longitude_deg)), np.nan)
    if forecast is None:
        return lowest
    name = "fuel_moisture_10h_pct"
    if name not in forecast.variables:
        raise DomainError(f"The fuel moisture grid lacks '{name}'.", field="fuel_moisture", value=name, accepted=name)
    ordered = forecast.sortby(["time", "latitude", "longitude"]).transpose("time", "latitude", "longitude", ...)
    times = ordered["time"].to_numpy().astype("datetime64[ns]")
    values = ordered[name].to_numpy()
    origin = np.datetime64(start.tz_convert("UTC").tz_localize(None), "ns")
    axes = [ordered[axis].to_numpy().astype(np.float64) for axis in ("latitude", "longitude")]
    for day in range(days):
        begin = origin + np.timedelta64(day, "D")
        hours = values[(times > begin) & (times <= begin + np.timedelta64(1, "D"))]
        if len(hours) >= weather.MIN_HOURS:
            least = np.where(np.isnan(hours), np.inf, hours).min(axis=0)
            least = np.where(np.isinf(least), np.nan, least)
            lowest[day] = weather.resample(least, *axes, grid.latitude_deg, grid.longitude_deg)
    if len(values) and not np.isfinite(lowest).any():
        raise DomainError(
            "The fuel moisture grid has no value in the place and days of the weather.",
            field="fuel_moisture",
            accepted="a forecast of the weather's own grid and hours",
        )
    return lowest


def on_cells(daily: DailyConditions, longitude_deg: Array, latitude_deg: Array, kind: Any) -> BurningConditions:
    """Bilinear conditions at places that broadcast to (y, x), in the number type ``kind``; NaN off the weather grid."""
    blend = Blend(daily.latitude_deg, daily.longitude_deg, latitude_deg, longitude_deg, kind)
    fields = (daily.temperature_c, daily.wind_speed_m_s, daily.rain_mm, daily.moisture_10h_pct)
    temperature, wind, rain, moisture = (blend(values) for values in fields)
    missing = np.isnan(temperature) | np.isnan(wind) | np.isnan(moisture)
    incomplete = blend.nearest(daily.hours) < WHOLE_DAY_H
    flag = np.where(missing, WEATHER_MISSING, np.where(incomplete, WEATHER_INCOMPLETE, 0)).astype(np.uint8)
    return BurningConditions(temperature, wind, rain, moisture, flag)


class Blend:
    """Bilinear interpolation from a latitude-longitude grid to fixed places; the weights are found once.

    A value next to an unknown one is the nearest's; beyond half a cell outside the grid there is none.
    """

    def __init__(self, latitude: Array, longitude: Array, to_latitude: Array, to_longitude: Array, kind: Any) -> None:
        self._columns, self._kind = len(longitude), kind
        row, column = _position(latitude, to_latitude), _position(longitude, to_longitude)
        self._outside = _outside(row, len(latitude)) | _outside(column, len(longitude))
        self._nearest = _rounded(row, len(latitude)) * len(longitude) + _rounded(column, len(longitude))
        low_row, self._up = _split(row, len(latitude), kind)
        low_column, self._across = _split(column, len(longitude), kind)
        self._base = low_row * len(longitude) + low_column
        self._steps = (int(len(latitude) > 1) * len(longitude), int(len(longitude) > 1))

    def __call__(self, values: Array) -> Array:
        """Values (..., y, x) of the grid at the places (..., rows, columns)."""
        up, across = self._steps
        flat = values.reshape(*values.shape[:-2], -1).astype(self._kind)
        out = np.empty((*flat.shape[:-1], *self._base.shape), dtype=self._kind)
        for index in np.ndindex(flat.shape[:-1]):
            level = flat[index]
            low = level.take(self._base)
            low += (level.take(self._base + across) - low) * self._across
            high = level.take(self._base + up)
            high += (level.take(self._base + (up + across)) - high) * self._across
            high -= low
            low += high * self._up
            if np.isnan(level).any():
                low = np.where(np.isnan(low), level.take(self._nearest), low)
            out[index] = np.where(self._outside, np.nan, low) if self._outside.any() else low
        return out

    def nearest(self, values: Array) -> Array:
        """The grid's nearest values, without blending."""
        flat = values.reshape(*values.shape[:-2], -1)
        found: Array = flat.take(self._nearest, axis=-1)
        return found


def _position(axis: Array, wanted: Array) -> Array:
    """Fractional index on an ascending axis, beyond its ends too."""
    if len(axis) == 1:
        return np.where(np.abs(wanted - axis[0]) <= 0.5, 0.0, -9.0)
    steps = np.diff(axis)
    if np.allclose(steps, steps[0], rtol=1e-6):
        return (wanted - float(axis[0])) / float((axis[-1] - axis[0]) / (len(axis) - 1))
    position = np.interp(wanted, axis, np.arange(len(axis), dtype=np.float64))
    position = np.where(wanted < axis[0], (wanted - axis[0]) / steps[0], position)
    return np.where(wanted > axis[-1], len(axis) - 1 + (wanted - axis[-1]) / steps[-1], position)


def _outside(position: Array, size: int) -> npt.NDArray[np.bool_]:
    return (position < -0.501) | (position > size - 0.499)


def _rounded(position: Array, size: int) -> Index:
    return np.clip(np.rint(position), 0, size - 1).astype(np.int32)


def _split(position: Array, size: int, kind: Any) -> tuple[Index, Array]:
    clipped = np.clip(position, 0, size - 1)
    base = np.minimum(np.floor(clipped), max(size - 2, 0))
    return base.astype(np.int32), (clipped - base).astype(kind)
