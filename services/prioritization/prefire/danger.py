"""The pre-fire danger grid: WFPI, WLFP and WFSP of lead days 0-7, without and with what the satellites saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization import weather
from services.prioritization.prefire import fire_potential, large_fire_probability, observed_land
from shared.errors import DomainError

Array = npt.NDArray[np.float64]
FpiVersion = Literal["1998", "2000"]
DIMENSIONS = ("lead_day", "latitude", "longitude")
CHANGE_THRESHOLD = 0.5


@dataclass(frozen=True)
class Fuels:
    """Vegetation of the danger grid: 1-D axes in degrees ascending, (y, x) fields as in the contract's fuels grid."""

    latitude_deg: Array
    longitude_deg: Array
    greenness: Array
    ndvi_max: Array
    live_load: Array
    dead_load: Array
    extinction_pct: Array
    mask_code: npt.NDArray[np.uint8]
    soil_moisture_q05: Array
    soil_moisture_q95: Array


@dataclass(frozen=True)
class DangerEffects:
    """The stated forms of everything that no publication fixes."""

    terms: fire_potential.WeatherTerms = field(default_factory=fire_potential.WeatherTerms)
    soil_moisture: observed_land.SoilMoistureEffect = field(default_factory=observed_land.SoilMoistureEffect)
    burn_scar: observed_land.BurnScarEffect = field(default_factory=observed_land.BurnScarEffect)
    spread: large_fire_probability.SpreadCoefficients = large_fire_probability.DEMONSTRATION


def fuels_from_dataset(dataset: xr.Dataset) -> Fuels:
    """Checked fuels; DomainError naming the variable for NDVI in a wrong scale, negative loads or unknown codes."""
    ordered = dataset.sortby(["latitude", "longitude"]).transpose("latitude", "longitude", ...)

    def values(name: str) -> Array:
        return ordered[name].to_numpy().astype(np.float64)

    extinction = values("extinction_pct")
    if (extinction <= 2).any() or (extinction > 100).any():
        worst = float(extinction[(extinction <= 2) | (extinction > 100)].flat[0])
        raise DomainError(
            f"'extinction_pct' holds {worst:g}.", field="extinction_pct", value=worst, accepted="2..100 % (above 2)"
        )
    for name in ("live_load", "dead_load"):
        if (values(name) < 0).any():
            raise DomainError(f"'{name}' holds a negative load.", field=name, accepted="0 or more, kg/m2")
    unknown = np.full(extinction.shape, np.nan)
    return Fuels(
        latitude_deg=values("latitude"),
        longitude_deg=values("longitude"),
        greenness=fire_potential.relative_greenness(values("ndvi"), values("ndvi_min"), values("ndvi_max")),
        ndvi_max=values("ndvi_max"),
        live_load=values("live_load"),
        dead_load=values("dead_load"),
        extinction_pct=extinction,
        mask_code=fire_potential.checked_mask(ordered["mask_code"].to_numpy()),
        soil_moisture_q05=values("soil_moisture_q05") if "soil_moisture_q05" in ordered else unknown,
        soil_moisture_q95=values("soil_moisture_q95") if "soil_moisture_q95" in ordered else unknown,
    )


def afternoon_moisture(
    daily: weather.DailyWeather, forecast: xr.Dataset | None, start: pd.Timestamp, grid: weather.WeatherGrid
) -> Array:
    """10-h moisture of each lead day on the weather grid: the day's lowest of the forecast, else 1.28 x equilibrium."""
    burgan = fire_potential.ten_hour_moisture_pct(daily.temperature_max_c, daily.relative_humidity_min_pct)
    if forecast is None:
        return burgan
    name = "fuel_moisture_10h_pct"
    if name not in forecast.variables:
        raise DomainError(f"The fuel moisture grid lacks '{name}'.", field="fuel_moisture", value=name, accepted=name)
    ordered = forecast.sortby(["time", "latitude", "longitude"]).transpose("time", "latitude", "longitude", ...)
    times = ordered["time"].to_numpy().astype("datetime64[ns]")
    origin = np.datetime64(start.tz_convert("UTC").tz_localize(None), "ns")
    axes = [ordered[axis].to_numpy().astype(np.float64) for axis in ("latitude", "longitude")]
    lowest = np.full(burgan.shape, np.nan)
    for day in range(len(lowest)):
        begin = origin + np.timedelta64(day, "D")
        hours = ordered[name].to_numpy()[(times > begin) & (times <= begin + np.timedelta64(1, "D"))]
        if len(hours) >= weather.MIN_HOURS:
            least = np.where(np.isnan(hours), np.inf, hours).min(axis=0)
            least = np.where(np.isinf(least), np.nan, least)
            lowest[day] = weather.resample(least, *axes, grid.latitude_deg, grid.longitude_deg)
    return np.where(np.isnan(lowest), burgan, lowest)


@dataclass(frozen=True)
class BurningConditions:
    """Weather on the danger grid by lead day, each (lead_day, y, x)."""

    temperature_c: Array
    wind_speed_m_s: Array
    rain_mm: Array
    moisture_10h_pct: Array


def conditions_on_fuels(
    grid: weather.WeatherGrid, forecast: xr.Dataset | None, start: pd.Timestamp, fuels: Fuels
) -> BurningConditions:
    """Daily burning conditions interpolated to the fuels grid; NaN where the weather does not reach."""
    daily = weather.daily_burning_conditions(grid, start)
    moisture = afternoon_moisture(daily, forecast, start, grid)
    fields = (daily.temperature_max_c, daily.wind_speed_m_s, daily.rain_mm, moisture)
    axes = (grid.latitude_deg, grid.longitude_deg, fuels.latitude_deg, fuels.longitude_deg)
    return BurningConditions(*(weather.resample(values, *axes) for values in fields))


def wfpi_of(
    greenness: Array, fuels: Fuels, conditions: BurningConditions, version: FpiVersion, effects: DangerEffects
) -> Array:
    """WFPI (lead_day, y, x) for a greenness (y, x); NaN on masked cells and where anything is unknown."""
    moisture = conditions.moisture_10h_pct
    if version == "1998":
        fpi = fire_potential.fpi_1998(greenness, fuels.live_load, fuels.dead_load, moisture, fuels.extinction_pct)
    else:
        burnable = fuels.mask_code < 248
        absolute = float(np.nanmax(np.where(burnable, fuels.ndvi_max, np.nan))) if burnable.any() else 1.0
        share = fire_potential.live_ratio(greenness, fuels.ndvi_max, absolute)
        fpi = fire_potential.fpi_2000(share, moisture, fuels.extinction_pct)
    values = fire_potential.wfpi(
        fpi, conditions.wind_speed_m_s, conditions.temperature_c, conditions.rain_mm, effects.terms
    )
    return np.where(fuels.mask_code >= 248, np.nan, values)


@dataclass(frozen=True)
class SeenLand:
    """What of the land was seen: soil moisture with its weight, and the burn scar, each (y, x)."""

    soil_moisture: observed_land.SoilMoistureOnGrid
    scar: Array


def seen_land(
    fuels: Fuels,
    soil_moisture: list[pd.DataFrame],
    burned_area: list[pd.DataFrame],
    time: pd.Timestamp,
    effects: DangerEffects,
    resolution_km: int = 9,
) -> SeenLand:
    """Soil moisture and burn scars known at ``time``, on the fuels grid."""
    latitude, longitude = np.meshgrid(fuels.latitude_deg, fuels.longitude_deg, indexing="ij")
    step = (_spacing(fuels.latitude_deg), _spacing(fuels.longitude_deg))
    moisture = observed_land.soil_moisture_on_grid(
        soil_moisture, longitude, latitude, time, effects.soil_moisture, resolution_km
    )
    scar = observed_land.burn_scar(burned_area, longitude, latitude, time, step, effects.burn_scar)
    return SeenLand(moisture, scar)


def _spacing(axis: Array) -> float:
    return float(np.median(np.diff(axis))) if len(axis) > 1 else 0.05


def danger(
    fuels: Fuels,
    conditions: BurningConditions,
    seen: SeenLand,
    time: pd.Timestamp,
    version: FpiVersion = "2000",
    effects: DangerEffects | None = None,
) -> xr.Dataset:
    """The danger grid of the contract. Without soil moisture and scars every ``_x`` equals its plain twin exactly."""
    effects = effects or DangerEffects()
    latitude = fuels.latitude_deg[:, None] * np.ones_like(fuels.longitude_deg)
    day = float(time.dayofyear)
    growing = observed_land.growing_season(day, latitude)
    strength = observed_land.alpha(growing, fuels.live_load, fuels.dead_load, effects.soil_moisture)
    position = observed_land.soil_position(
        seen.soil_moisture.soil_moisture, fuels.soil_moisture_q05, fuels.soil_moisture_q95
    )
    weight = seen.soil_moisture.weight
    greenness_x = observed_land.greenness_with_soil_moisture(fuels.greenness, weight, strength, position)
    plain = wfpi_of(fuels.greenness, fuels, conditions, version, effects)
    seen_wfpi = wfpi_of(greenness_x, fuels, conditions, version, effects) * (1 - seen.scar)
    season = large_fire_probability.season_term(day, latitude, effects.spread)
    layers = {"": plain, "_x": seen_wfpi}
    data: dict[str, Any] = {}
    for suffix, values in layers.items():
        wfsp = large_fire_probability.wfsp_pct(values, season, effects.spread)
        wlfp = large_fire_probability.wlfp_per_million_km2_day(values, season, effects.spread)
        data["wfpi" + suffix] = (DIMENSIONS, values.astype(np.float32), _attributes("wfpi", suffix))
        data["wlfp" + suffix] = (DIMENSIONS, wlfp.astype(np.float32), _attributes("wlfp", suffix))
        data["wfsp" + suffix] = (DIMENSIONS, wfsp.astype(np.float32), _attributes("wfsp", suffix))
        code = fire_potential.coded(values, fuels.mask_code)
        data["wfpi_code" + suffix] = (DIMENSIONS, code, {"long_name": "WFPI as USGS code, 248-255 masks"})
    data |= _land_layers(fuels, seen, position)
    return xr.Dataset(data, coords=_coordinates(fuels, time, len(plain)), attrs=_global_attributes(time, version))


_MEANING = {
    "wfpi": ("wildland fire potential index", "1"),
    "wlfp": (
        "expected large fires (over 500 acres) per million km2 and day, demonstration coefficients",
        "1e-6 km-2 d-1",
    ),
    "wfsp": ("probability that an ignited fire exceeds 500 acres, demonstration coefficients", "percent"),
}


def _attributes(name: str, suffix: str) -> dict[str, str]:
    meaning, units = _MEANING[name]
    return {"long_name": meaning + (", with soil moisture and burned area" if suffix else ""), "units": units}


def _land_layers(fuels: Fuels, seen: SeenLand, position: Array) -> Mapping[str, Any]:
    flat = ("latitude", "longitude")
    codes = sorted(fire_potential.MASK_CODES)
    mask_attributes = {
        "long_name": "mask code, 0 where burnable",
        "flag_values": np.array([0, *codes], dtype=np.uint8),
        "flag_meanings": "burnable outside_a outside_b snow_or_ice agriculture barren marsh water no_data",
    }
    return {
        "mask_code": (flat, fuels.mask_code, mask_attributes),
        "soil_moisture_weight": (flat, seen.soil_moisture.weight.astype(np.float32), {"units": "1"}),
        "soil_moisture_position": (flat, position.astype(np.float32), {"units": "1"}),
        "burn_scar": (flat, seen.scar.astype(np.float32), {"long_name": "share of fuel lost to scars", "units": "1"}),
    }


def _coordinates(fuels: Fuels, time: pd.Timestamp, days: int) -> dict[str, Any]:
    starts = pd.date_range(time.tz_convert("UTC").tz_localize(None), periods=days, freq="D")
    return {
        "lead_day": ("lead_day", np.arange(days, dtype=np.int32), {"long_name": "lead day, 24 h from its start"}),
        "latitude": ("latitude", fuels.latitude_deg, {"units": "degrees_north", "standard_name": "latitude"}),
        "longitude": ("longitude", fuels.longitude_deg, {"units": "degrees_east", "standard_name": "longitude"}),
        "lead_day_start": ("lead_day", starts.to_numpy()),
    }


def _global_attributes(time: pd.Timestamp, version: str) -> dict[str, Any]:
    return {
        "title": "Pre-fire danger: WFPI, WLFP, WFSP and the same with soil moisture and burned area",
        "valid_from": time.tz_convert("UTC").strftime("%Y-%m-%dT%H:%M:%SZ"),
        "fpi_version": version,
    }


def summary(grid: xr.Dataset) -> dict[str, Any]:
    """What the report says of a grid: ranges by layer, what lacks weather, how much the satellites changed."""
    burnable = grid["mask_code"].to_numpy() < 248
    known = np.isfinite(grid["wfpi"].to_numpy())
    difference = (grid["wfpi_x"] - grid["wfpi"]).to_numpy()
    changed = np.abs(difference[0][burnable & known[0]]) >= CHANGE_THRESHOLD
    layers = {}
    for name in ("wfpi", "wlfp", "wfsp", "wfpi_x", "wlfp_x", "wfsp_x"):
        values = grid[name].to_numpy()
        finite = values[np.isfinite(values)]
        levels = np.quantile(finite, [0, 0.5, 0.95, 1]) if len(finite) else np.full(4, np.nan)
        layers[name] = dict(zip(("minimum", "median", "q95", "maximum"), map(float, levels), strict=True))
    return {
        "layers": layers,
        "burnable_cells": int(burnable.sum()),
        "lead_days_without_weather": [int(d) for d in range(len(known)) if not known[d][burnable].any()],
        "burnable_cells_unknown_on_day_0": int((burnable & ~known[0]).sum()),
        "share_changed_by_satellites": float(changed.mean()) if len(changed) else 0.0,
        "wfpi_change_largest": float(np.nanmax(difference)) if known.any() else 0.0,
        "wfpi_change_smallest": float(np.nanmin(difference)) if known.any() else 0.0,
        "masked_cells": {str(c): int((grid["mask_code"].to_numpy() == c).sum()) for c in fire_potential.MASK_CODES},
    }
