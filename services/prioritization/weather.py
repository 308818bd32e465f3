"""Weather as the indices need it: checked for units, aggregated by lead day, sampled at places.

Values outside the physical range are missing values, counted; a variable of which more than one in a hundred is
outside is refused by name, since then its unit is wrong (kelvin, fractions, km/h), and no danger may come of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization import longitudes
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

RANGES: dict[str, tuple[float, float, str]] = {
    "temperature_c": (-70.0, 60.0, "degC"),
    "relative_humidity_pct": (0.0, 105.0, "%"),
    "wind_speed_m_s": (0.0, 75.0, "m/s"),
    "rain_mm": (-0.01, 400.0, "mm per hour"),
}
UNITS: dict[str, tuple[str, ...]] = {
    "temperature_c": ("degC", "degree_Celsius", "degrees_Celsius", "celsius", "deg_C", "C", "°C"),
    "relative_humidity_pct": ("%", "percent", "pct"),
    "wind_speed_m_s": ("m/s", "m s-1", "m s^-1", "m s**-1", "meter second-1", "metre second-1"),
    "rain_mm": ("mm", "mm/h", "mm h-1", "mm/hour", "kg m-2", "kg m-2 h-1"),
}
FRACTION_VALUES = 24
REFUSED_SHARE = 0.01
LEAD_DAYS = 8
MIN_HOURS = 6


@dataclass(frozen=True)
class WeatherGrid:
    """Hourly weather on a latitude-longitude grid.

    ``time`` datetime64[ns] UTC ascending (t,), ``latitude_deg`` ascending (y,), ``longitude_deg`` ascending (x,),
    ``fields`` name -> (t, y, x) in the contract's units, NaN where unknown; ``flagged`` counts values taken out.
    """

    time: npt.NDArray[np.datetime64]
    latitude_deg: Array
    longitude_deg: Array
    fields: dict[str, Array]
    flagged: dict[str, int] = field(default_factory=dict)


def check_weather(values: npt.ArrayLike, name: str, where: str) -> tuple[Array, int]:
    """Values with impossible ones replaced by NaN, and how many; DomainError if the unit must be wrong."""
    low, high, unit = RANGES[name]
    array = np.array(values, dtype=np.float64)
    bad = (array < low) | (array > high)
    known = int(np.isfinite(array).sum())
    count = int(bad.sum())
    if known == 0:
        raise DomainError(
            f"Every value of '{name}' in {where} is missing.", field=name, accepted=f"{low:g}..{high:g} {unit}"
        )
    if count > REFUSED_SHARE * known:
        worst = float(array[bad][np.argmax(np.abs(array[bad]))])
        raise DomainError(
            f"'{name}' in {where}: {count} of {known} values lie outside {low:g}..{high:g} {unit} (such as "
            f"{worst:g}); the unit is probably wrong.",
            field=name,
            value=worst,
            accepted=f"{low:g}..{high:g} {unit}",
        )
    array[bad] = np.nan
    if name == "relative_humidity_pct":
        if known >= FRACTION_VALUES and float(np.nanmax(array)) <= 1.0:
            raise DomainError(
                f"'{name}' in {where} never exceeds {float(np.nanmax(array)):g}; it is probably a fraction.",
                field=name,
                value=float(np.nanmax(array)),
                accepted=f"{low:g}..{high:g} {unit}",
            )
        array = np.minimum(array, 100.0)
    if name == "rain_mm":
        array = np.maximum(array, 0.0)
    return array, count


def weather_from_dataset(dataset: xr.Dataset, where: str = "weather") -> WeatherGrid:
    """A checked weather grid from the contract's dataset; of hours given twice the last.

    DomainError naming a missing or impossible variable.
    """
    missing = [name for name in (*RANGES, "time", "latitude", "longitude") if name not in dataset.variables]
    if missing:
        raise DomainError(
            f"The {where} grid lacks '{missing[0]}'; it has {', '.join(sorted(map(str, dataset.variables)))}.",
            field=missing[0],
            accepted=", ".join(RANGES),
        )
    ordered = longitudes.signed(dataset).sortby(["time", "latitude", "longitude"])
    # Of an hour that is there twice the last one given counts, or its rain would fall twice.
    ordered = ordered.drop_duplicates("time", keep="last").transpose("time", "latitude", "longitude", ...)
    times = ordered["time"].to_numpy().astype("datetime64[ns]")
    fields, flagged = {}, {}
    for name in RANGES:
        _check_unit(ordered[name], name, where)
        fields[name], flagged[name] = check_weather(ordered[name].to_numpy(), name, where)
    return WeatherGrid(
        times,
        ordered["latitude"].to_numpy().astype(np.float64),
        ordered["longitude"].to_numpy().astype(np.float64),
        fields,
        flagged,
    )


def _check_unit(variable: xr.DataArray, name: str, where: str) -> None:
    """DomainError where a variable states another unit than its name does."""
    stated = str(variable.attrs.get("units", "")).strip()
    if stated and stated.casefold() not in {unit.casefold() for unit in UNITS[name]}:
        raise DomainError(
            f"'{name}' in {where} is in '{stated}'.", field=name, value=stated, accepted=", ".join(UNITS[name])
        )


def window(grid: WeatherGrid, start: pd.Timestamp, hours: float) -> WeatherGrid:
    """The hours after ``start`` up to and including ``start + hours``: a value at t stands for the hour before t."""
    begin = np.datetime64(start.tz_convert("UTC").tz_localize(None), "ns")
    inside = (grid.time > begin) & (grid.time <= begin + np.timedelta64(int(hours * 3600), "s"))
    return WeatherGrid(
        grid.time[inside],
        grid.latitude_deg,
        grid.longitude_deg,
        {name: values[inside] for name, values in grid.fields.items()},
        grid.flagged,
    )


@dataclass(frozen=True)
class DailyWeather:
    """Burning conditions by lead day, each (lead_day, y, x): hottest hour's T and wind, lowest RH, 24 h rain (mm)."""

    temperature_max_c: Array
    relative_humidity_min_pct: Array
    wind_speed_m_s: Array
    rain_mm: Array
    hours: Array


def daily_burning_conditions(grid: WeatherGrid, start: pd.Timestamp, days: int = LEAD_DAYS) -> DailyWeather:
    """Weather of each of ``days`` 24 h periods from ``start``; NaN where a cell has fewer than 6 whole hours.

    Wind is that of the hottest hour: FPI describes the afternoon, and a gust at night must not meet noon's moisture.
    """
    shape = (days, len(grid.latitude_deg), len(grid.longitude_deg))
    out = {name: np.full(shape, np.nan) for name in ("t", "rh", "wind", "rain")}
    hours = np.zeros(shape)
    for day in range(days):
        part = window(grid, start + pd.Timedelta(days=day), 24).fields
        names = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s")
        whole = np.all([np.isfinite(part[name]) for name in names], axis=0)
        hours[day] = whole.sum(axis=0)
        if not len(whole):
            continue
        enough = hours[day] >= MIN_HOURS
        temperature = np.where(whole, part["temperature_c"], -np.inf)
        hottest = temperature.argmax(axis=0)[None]
        humidity = np.where(whole, part["relative_humidity_pct"], np.inf).min(axis=0)
        out["t"][day] = np.where(enough, temperature.max(axis=0), np.nan)
        out["rh"][day] = np.where(enough, humidity, np.nan)
        out["wind"][day] = np.where(enough, np.take_along_axis(part["wind_speed_m_s"], hottest, 0)[0], np.nan)
        dry_if_unknown = np.nan_to_num(part["rain_mm"], nan=0.0)  # rain only lowers danger: unknown rain must not
        out["rain"][day] = np.where(enough, dry_if_unknown.sum(axis=0), np.nan)
    return DailyWeather(out["t"], out["rh"], out["wind"], out["rain"], hours)


def resample(
    values: Array, latitude_deg: Array, longitude_deg: Array, to_latitude_deg: Array, to_longitude_deg: Array
) -> Array:
    """Bilinear values (..., y, x) on another grid; NaN beyond half a cell outside; nearest where a neighbour is NaN."""
    row = _position(latitude_deg, to_latitude_deg)
    column = _position(longitude_deg, to_longitude_deg)
    nearest = values[..., _nearest(row, len(latitude_deg))[:, None], _nearest(column, len(longitude_deg))[None, :]]
    r0, rw = _split(row, len(latitude_deg))
    c0, cw = _split(column, len(longitude_deg))
    r1 = np.minimum(r0 + 1, len(latitude_deg) - 1)
    c1 = np.minimum(c0 + 1, len(longitude_deg) - 1)
    rw, cw = rw[:, None], cw[None, :]
    low = values[..., r0[:, None], c0] * (1 - cw) + values[..., r0[:, None], c1] * cw
    high = values[..., r1[:, None], c0] * (1 - cw) + values[..., r1[:, None], c1] * cw
    blended = low * (1 - rw) + high * rw
    blended = np.where(np.isnan(blended), nearest, blended)
    outside = _outside(row, len(latitude_deg))[:, None] | _outside(column, len(longitude_deg))[None, :]
    return np.where(outside, np.nan, blended)


def _position(axis: Array, wanted: Array) -> Array:
    if len(axis) == 1:
        return np.where(np.abs(wanted - axis[0]) <= 0.5, 0.0, -9.0)
    index = np.arange(len(axis), dtype=np.float64)
    position = np.interp(wanted, axis, index)
    below, above = axis[1] - axis[0], axis[-1] - axis[-2]
    position = np.where(wanted < axis[0], (wanted - axis[0]) / below, position)
    return np.where(wanted > axis[-1], index[-1] + (wanted - axis[-1]) / above, position)


def _outside(position: Array, size: int) -> npt.NDArray[np.bool_]:
    return (position < -0.501) | (position > size - 0.499)


def _nearest(position: Array, size: int) -> npt.NDArray[np.int64]:
    return np.clip(np.rint(position), 0, size - 1).astype(np.int64)


def _split(position: Array, size: int) -> tuple[npt.NDArray[np.int64], Array]:
    clipped = np.clip(position, 0, size - 1)
    base = np.minimum(np.floor(clipped).astype(np.int64), max(size - 2, 0))
    return base, clipped - base


def series_at(grid: WeatherGrid, longitude_deg: float, latitude_deg: float) -> pd.DataFrame:
    """Hourly weather of the cell nearest to a place, indexed by time; no rows where the place is off the grid."""
    row = _position(grid.latitude_deg, np.array([latitude_deg]))
    column = _position(grid.longitude_deg, np.array([longitude_deg]))
    if _outside(row, len(grid.latitude_deg))[0] or _outside(column, len(grid.longitude_deg))[0]:
        return pd.DataFrame(columns=list(RANGES), index=pd.DatetimeIndex([], tz="UTC"), dtype=np.float64)
    y = _nearest(row, len(grid.latitude_deg))[0]
    x = _nearest(column, len(grid.longitude_deg))[0]
    index = pd.DatetimeIndex(grid.time).tz_localize("UTC")
    return pd.DataFrame({name: grid.fields[name][:, y, x] for name in RANGES}, index=index)


def series_at_stations(table: pd.DataFrame, longitude_deg: float, latitude_deg: float, reach_km: float) -> pd.DataFrame:
    """Hourly weather of the nearest point of a weather table within ``reach_km``; no rows where there is none."""
    places = table.geometry
    east = (places.x.to_numpy() - longitude_deg) * np.cos(np.radians(latitude_deg))
    distance_km = 111.195 * np.hypot(east, places.y.to_numpy() - latitude_deg)
    near = distance_km <= min(reach_km, distance_km.min(initial=np.inf) + 1e-6)
    rows = table.loc[near].sort_values("time").drop_duplicates("time", keep="last")
    return pd.DataFrame({name: rows[name].to_numpy() for name in RANGES}, index=pd.DatetimeIndex(rows["time"]))
