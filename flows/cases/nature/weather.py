"""Hourly weather of a nature run, analyses and forecasts whose error grows with the lead time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from flows.cases.nature.fields import KM_PER_DEG, RandomField, random_field, smooth_step
from flows.cases.nature.land import Land
from flows.cases.nature.setting import FloatArray, Setting

LEAD_HOURS = 192
VARIABLES = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "wind_direction_deg", "rain_mm")
DECIMALS = {"temperature_c": 2, "relative_humidity_pct": 1, "wind_speed_m_s": 2, "wind_direction_deg": 1, "rain_mm": 2}


@dataclass(frozen=True)
class Storms:
    """Rain cells: (n,) centres in degrees, radius in km, start and length in h, peak rate in mm/h."""

    longitude_deg: FloatArray
    latitude_deg: FloatArray
    radius_km: FloatArray
    start_h: FloatArray
    length_h: FloatArray
    rate_mm_h: FloatArray

    def rain_mm(self, longitude: ArrayLike, latitude: ArrayLike, from_h: ArrayLike, to_h: ArrayLike) -> FloatArray:
        """Rain fallen between two times, mm; the arguments broadcast together."""
        shape = np.broadcast_shapes(np.shape(longitude), np.shape(latitude), np.shape(from_h), np.shape(to_h))
        total = np.zeros(shape)
        for i in range(len(self.start_h)):
            end = self.start_h[i] + self.length_h[i]
            hours = np.clip(np.minimum(to_h, end) - np.maximum(from_h, self.start_h[i]), 0.0, None)
            if not np.any(hours):
                continue
            east = (np.asarray(longitude) - self.longitude_deg[i]) * KM_PER_DEG * 0.83
            north = (np.asarray(latitude) - self.latitude_deg[i]) * KM_PER_DEG
            reach = np.exp(-0.5 * (east**2 + north**2) / self.radius_km[i] ** 2)
            total = total + self.rate_mm_h[i] * reach * hours
        return total


@dataclass(frozen=True)
class Weather:
    """The true weather: call :meth:`at` with positions in degrees and hours since the run's start."""

    setting: Setting
    land: Land
    storms: Storms
    synoptic: dict[str, RandomField]
    local: dict[str, RandomField]

    def at(self, longitude: ArrayLike, latitude: ArrayLike, time_h: ArrayLike) -> dict[str, FloatArray]:
        """The five weather variables (names and units of the weather contract); the arguments broadcast together."""
        longitude, latitude, time = np.asarray(longitude), np.asarray(latitude), np.asarray(time_h, dtype=np.float64)
        rain = self.storms.rain_mm(longitude, latitude, time - 1.0, time)
        temperature = self._temperature(longitude, latitude, time, rain)
        east, north = self._wind(longitude, latitude, time)
        humidity = relative_humidity(temperature, self._dewpoint(longitude, latitude, time))
        return {
            "temperature_c": temperature,
            "relative_humidity_pct": np.where(rain > 0.2, np.maximum(humidity, 85.0), humidity),
            "wind_speed_m_s": np.hypot(east, north),
            "wind_direction_deg": np.degrees(np.arctan2(-east, -north)) % 360.0,
            "rain_mm": np.where(rain < 0.05, 0.0, rain),
        }

    def _solar_hour(self, longitude: FloatArray, time: FloatArray) -> FloatArray:
        start = self.setting.start
        return (start.hour + start.minute / 60 + time + longitude / 15.0) % 24.0

    def _temperature(
        self, longitude: FloatArray, latitude: FloatArray, time: FloatArray, rain: FloatArray
    ) -> FloatArray:
        lapse = -0.0065 * (self.land.elevation_m(longitude, latitude) - 1900.0)
        diurnal = 8.0 * np.cos(2 * np.pi * (self._solar_hour(longitude, time) - 15.0) / 24.0)
        changes = 2.2 * self.synoptic["temperature"].at(longitude, latitude, time)
        changes = changes + 0.7 * self.local["temperature"].at(longitude, latitude, time)
        return self.setting.mean_temperature_c + lapse + diurnal + changes - 4.0 * np.minimum(rain, 1.0)

    def _dewpoint(self, longitude: FloatArray, latitude: FloatArray, time: FloatArray) -> FloatArray:
        drying = smooth_step(time, self.setting.cutoff_h - 24 * self.setting.wet_until_days, self.setting.cutoff_h - 48)
        return 11.0 - 8.0 * drying + 2.0 * self.synoptic["dewpoint"].at(longitude, latitude, time)

    def _wind(self, longitude: FloatArray, latitude: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        setting = self.setting
        shift = setting.cutoff_h + setting.wind_shift_h
        turned = smooth_step(time, shift, shift + 10.0)
        origin = setting.wind_from_deg + (setting.wind_to_from_deg - setting.wind_from_deg) * turned
        origin = np.radians(origin + 22.0 * self.synoptic["direction"].at(longitude, latitude, time))
        breeze = np.clip(np.cos(2 * np.pi * (self._solar_hour(longitude, time) - 16.0) / 24.0), 0.0, None)
        speed = setting.mean_wind_m_s * (0.45 + 1.15 * breeze)
        speed = speed * np.exp(0.22 * self.synoptic["speed"].at(longitude, latitude, time))
        east = -speed * np.sin(origin) + 0.6 * self.local["east"].at(longitude, latitude, time)
        north = -speed * np.cos(origin) + 0.6 * self.local["north"].at(longitude, latitude, time)
        return east, north


def relative_humidity(temperature_c: FloatArray, dewpoint_c: FloatArray) -> FloatArray:
    """Relative humidity over water, %, Magnus form with the coefficients of Alduchov and Eskridge (1996)."""
    spread = 17.625 * dewpoint_c / (243.04 + dewpoint_c) - 17.625 * temperature_c / (243.04 + temperature_c)
    return np.clip(100.0 * np.exp(spread), 3.0, 100.0)


def make_weather(setting: Setting, land: Land) -> Weather:
    """The weather from the setting's seed."""
    rng = setting.generator("weather")
    large, small = ("temperature", "dewpoint", "direction", "speed"), ("temperature", "east", "north")
    synoptic = {name: random_field(rng, 350.0, correlation_h=30.0, modes=24) for name in large}
    local = {name: random_field(rng, 35.0, correlation_h=6.0, modes=24) for name in small}
    return Weather(setting, land, _make_storms(setting), synoptic, local)


def _make_storms(setting: Setting) -> Storms:
    """Storms end ``wet_until_days`` before the first cut-off: the fires burn in a dry spell."""
    rng = setting.generator("storms")
    west, south, east, north = setting.region
    count = 6 + round(2.0 * (east - west) * (north - south))
    return Storms(
        rng.uniform(west - 0.2, east + 0.2, count),
        rng.uniform(south - 0.2, north + 0.2, count),
        rng.uniform(20.0, 55.0, count),
        rng.uniform(0.0, max(setting.cutoff_h - 24 * setting.wet_until_days, 1.0), count),
        rng.uniform(2.0, 7.0, count),
        rng.uniform(1.5, 6.0, count),
    )


def analysis_dataset(weather: Weather, from_h: float, to_h: float) -> xr.Dataset:
    """Hourly analyses from ``from_h`` to ``to_h`` (hours since the run's start), each issued an hour after its time."""
    setting = weather.setting
    longitude, latitude = setting.axes(setting.weather_step_deg)
    hours = np.arange(from_h, to_h + 0.5)
    values = weather.at(longitude[None, None, :], latitude[None, :, None], hours[:, None, None])
    dims = ("time", "latitude", "longitude")
    dataset = _grid(values, dims, longitude, latitude).assign_coords(
        time=("time", setting.times(hours)), issued_at=("time", setting.times(hours + 1.0))
    )
    return _stored_times(dataset, setting, ("time", "issued_at"))


def forecast_dataset(weather: Weather) -> xr.Dataset:
    """Forecasts by issue and lead (0..192 h): the truth plus errors of its own, growing with the lead.

    Dimensions (issue, lead, latitude, longitude); ``valid_at`` (issue, lead) is the time that a value is for.
    """
    setting = weather.setting
    longitude, latitude = setting.axes(setting.weather_step_deg)
    leads = np.arange(LEAD_HOURS + 1.0)
    span = setting.cycles * setting.cycle_hours
    issues = setting.cutoff_h + np.arange(0.0, span + 0.5, setting.issue_every_h)
    position = (longitude[None, None, :], latitude[None, :, None])
    stack = [_one_forecast(weather, number, issue + leads, leads, *position) for number, issue in enumerate(issues)]
    values = {name: np.stack([one[name] for one in stack]) for name in VARIABLES}
    dataset = _grid(values, ("issue", "lead", "latitude", "longitude"), longitude, latitude).assign_coords(
        issue=("issue", setting.times(issues)),
        lead=("lead", leads, {"long_name": "lead time in hours"}),
        valid_at=(("issue", "lead"), setting.times(issues[:, None] + leads[None, :])),
    )
    return _stored_times(dataset, setting, ("issue", "valid_at"))


def _one_forecast(
    weather: Weather, number: int, hours: FloatArray, leads: FloatArray, longitude: FloatArray, latitude: FloatArray
) -> dict[str, FloatArray]:
    rng = weather.setting.generator(f"forecast {number}")
    time, days = hours[:, None, None], leads[:, None, None] / 24.0
    truth = weather.at(longitude, latitude, time)
    errors = [random_field(rng, 150.0, correlation_h=14.0, modes=16).at(longitude, latitude, time) for _ in range(5)]
    speed, origin = truth["wind_speed_m_s"], np.radians(truth["wind_direction_deg"])
    growth = 0.35 + 0.45 * days
    east = -speed * np.sin(origin) + growth * errors[0]
    north = -speed * np.cos(origin) + growth * errors[1]
    humidity = truth["relative_humidity_pct"] + (2.0 + 2.0 * days) * errors[3]
    return {
        "temperature_c": truth["temperature_c"] + (0.4 + 0.4 * days) * errors[2],
        "relative_humidity_pct": np.clip(humidity, 3.0, 100.0),
        "wind_speed_m_s": np.hypot(east, north),
        "wind_direction_deg": np.degrees(np.arctan2(-east, -north)) % 360.0,
        "rain_mm": truth["rain_mm"] * np.exp((0.2 + 0.1 * days) * errors[4]),
    }


def _grid(
    values: dict[str, FloatArray], dims: tuple[str, ...], longitude: FloatArray, latitude: FloatArray
) -> xr.Dataset:
    rounded = {name: np.round(values[name], DECIMALS[name]).astype(np.float32) for name in VARIABLES}
    rounded["wind_direction_deg"] = rounded["wind_direction_deg"] % np.float32(360.0)
    return xr.Dataset(
        {name: (dims, field) for name, field in rounded.items()},
        coords={"latitude": latitude, "longitude": longitude},
        attrs={"source": "simulated"},
    )


def _stored_times(dataset: xr.Dataset, setting: Setting, names: tuple[str, ...]) -> xr.Dataset:
    """Fix how times are stored, whole seconds since the run's start, so that the bytes do not depend on a guess."""
    for name in names:
        dataset[name].encoding = {"units": f"seconds since {setting.start:%Y-%m-%d %H:%M:%S}", "dtype": "int64"}
    return dataset
