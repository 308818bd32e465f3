"""What weather does to a front: wind and fuel moisture as factors of Rothermel's model, hour by hour.

Rothermel (1972), INT-115: rate = base x moisture damping x (1 + wind factor). Only ratios are used here, between the
coming day and the day whose spread was seen, so that fuel load, depth and heat cancel. The fuel is a stand of fine
dead fuel: surface-to-volume ratio 1500 per foot, optimum packing, moisture of extinction 25 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from shared.errors import DomainError

SURFACE_TO_VOLUME_FT, EXTINCTION = 1500.0, 0.25
# Wind at mid-flame height over wind at 10 m for partly sheltered fuel (Andrews 2012, RMRS-GTR-266).
MIDFLAME = 0.3
FEET_PER_MINUTE = 196.85  # of a metre a second
NAMES = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "wind_direction_deg")
REACH_KM = 100.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HourlyWeather:
    """Weather at a fire, hourly: hours since the reference time, and (n,) arrays."""

    time_h: Floats
    temperature_c: Floats
    relative_humidity_pct: Floats
    wind_speed_m_s: Floats
    wind_from_deg: Floats

    def between(self, start_h: float, end_h: float) -> HourlyWeather:
        """Hours with start_h < time <= end_h."""
        chosen = (self.time_h > start_h) & (self.time_h <= end_h)
        return HourlyWeather(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def __len__(self) -> int:
        return self.time_h.size


def equilibrium_moisture(temperature_c: Floats, relative_humidity_pct: Floats) -> Floats:
    """Equilibrium moisture of fine dead fuel as a fraction (Simard 1968, as in NFDRS; temperature in Fahrenheit)."""
    t, h = 1.8 * np.asarray(temperature_c, float) + 32.0, np.clip(relative_humidity_pct, 0.0, 100.0)
    dry = 0.03229 + 0.281073 * h - 0.000578 * h * t
    middle = 2.22749 + 0.160107 * h - 0.014784 * t
    wet = 21.0606 + 0.005565 * h**2 - 0.00035 * h * t - 0.483199 * h
    return np.maximum(np.where(h < 10, dry, np.where(h <= 50, middle, wet)), 0.5) / 100.0


def moisture_damping(moisture: Floats, extinction: float = EXTINCTION) -> Floats:
    """Rothermel's moisture damping coefficient, eq. 29; 1 for bone-dry fuel, 0 at and above extinction."""
    ratio = np.clip(np.asarray(moisture, float) / extinction, 0.0, 1.0)
    return np.maximum(1.0 - 2.59 * ratio + 5.11 * ratio**2 - 3.52 * ratio**3, 0.0)


def wind_factor(midflame_m_s: Floats, ratio: float = SURFACE_TO_VOLUME_FT) -> Floats:
    """Rothermel's wind factor, eqs. 47-50, at optimum packing."""
    c = 7.47 * np.exp(-0.133 * ratio**0.55)
    b = 0.02526 * ratio**0.54
    return np.asarray(c * (FEET_PER_MINUTE * np.maximum(midflame_m_s, 0.0)) ** b)


def eccentricity(midflame_m_s: Floats) -> Floats:
    """Eccentricity of the elliptical fire shape (Anderson 1983, as in Finney 1998, eq. 17); length-to-breadth up to
    8."""
    wind = np.asarray(midflame_m_s, float)
    shape = 0.936 * np.exp(0.2566 * wind) + 0.461 * np.exp(-0.1548 * wind) - 0.397
    shape = np.clip(shape, 1.0, 8.0)
    return np.sqrt(1.0 - 1.0 / shape**2)


def run_by_direction(weather: HourlyWeather, angle_rad: Floats) -> Floats:
    """Relative run of a front by direction (n,) (radians from east): the hours' elliptical spread, averaged.

    Unit: the head rate in still air over bone-dry fuel.
    """
    midflame = MIDFLAME * weather.wind_speed_m_s
    head = moisture_damping(equilibrium_moisture(weather.temperature_c, weather.relative_humidity_pct))
    head = head * (1.0 + wind_factor(midflame))
    shape = eccentricity(midflame)
    towards = np.radians(90.0 - (weather.wind_from_deg + 180.0))
    off = np.cos(np.asarray(angle_rad, float).ravel()[:, None] - towards)
    run = (head * (1.0 - shape) / (1.0 - shape * off)).mean(axis=1)
    return np.asarray(run.reshape(np.shape(angle_rad)))


def weather_in(
    table: pd.DataFrame, longitude_deg: float, latitude_deg: float, reference: pd.Timestamp, end: pd.Timestamp
) -> HourlyWeather:
    """Weather of the point of a weather table (contract columns) nearest to a place, of rows issued by `end`. Raises
    DomainError where none lies within 100 km or none was issued by then."""
    known = table[(table["issued_at"] <= end) & table[list(NAMES)].notna().all(axis=1)]
    lon, lat = known.geometry.x.to_numpy(float), known.geometry.y.to_numpy(float)
    east = ((lon - longitude_deg + 180.0) % 360.0 - 180.0) * np.cos(np.radians(latitude_deg))
    distance_km = 111.2 * np.hypot(east, lat - latitude_deg)
    if len(known) == 0 or distance_km.min() > REACH_KM:
        raise DomainError(
            "no weather point near the fire was issued by the end of the period",
            field="weather",
            value=f"{latitude_deg:.2f} N, {longitude_deg:.2f} E",
            accepted=f"a point within {REACH_KM:g} km with issued_at up to {end}",
        )
    chosen = known[distance_km <= distance_km.min() + 1e-6].sort_values(["time", "issued_at"])
    chosen = chosen.drop_duplicates("time", keep="last")  # of several forecasts of an hour the latest
    hours = (chosen["time"] - reference).dt.total_seconds().to_numpy(float) / 3600.0
    return HourlyWeather(hours, *(chosen[name].to_numpy(float) for name in NAMES))


def weather_at(
    dataset: xr.Dataset, longitude_deg: float, latitude_deg: float, reference: pd.Timestamp, end: pd.Timestamp
) -> HourlyWeather:
    """Weather at the grid point nearest to a place, of hours that were issued by `end` (a forecast issued later was
    not known). Raises DomainError where the grid does not reach the place or holds no such hour."""
    lon, lat = (dataset[axis].to_numpy().astype(float) for axis in ("longitude", "latitude"))
    off = np.abs((lon - longitude_deg + 180.0) % 360.0 - 180.0)
    column, row = int(off.argmin()), int(np.abs(lat - latitude_deg).argmin())
    step = max(np.abs(np.diff(lon)).max(initial=0.0), np.abs(np.diff(lat)).max(initial=0.0), 0.5)
    if off[column] > step or abs(lat[row] - latitude_deg) > step:
        raise DomainError(
            "the weather grid does not reach the fire",
            field="weather",
            value=f"{latitude_deg:.2f} N, {longitude_deg:.2f} E",
            accepted=f"a place within {lat.min():g}..{lat.max():g} N, {lon.min():g}..{lon.max():g} E",
        )
    point = dataset.isel(latitude=row, longitude=column)
    issued = pd.to_datetime(point["issued_at"].to_numpy(), utc=True)
    times = pd.to_datetime(point["time"].to_numpy(), utc=True)
    values = [point[name].to_numpy().astype(float) for name in NAMES]
    known = np.asarray(issued <= end) & np.isfinite(values).all(axis=0)
    if not known.any():
        raise DomainError(
            "the weather grid holds no hour issued by the end of the period",
            field="weather",
            value=str(issued.min()),
            accepted=f"issued_at up to {end}",
        )
    hours = np.asarray((times - reference).total_seconds(), float) / 3600.0
    return HourlyWeather(hours[known], *(value[known] for value in values))
