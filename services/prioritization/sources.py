"""From files to what the core computes with: weather as known at a time, drought and fuel moisture at places."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from pandas.api.types import is_numeric_dtype

from services.prioritization import longitudes, plain_columns, weather
from services.prioritization.indices import KBDI_MAX_MM
from services.prioritization.large_fire import features, rating
from services.prioritization.large_fire.rating import SeriesAt
from shared.contracts import grids, schema, tables
from shared.errors import DomainError

STATION_REACH_KM = 100.0


def to_utc(time: object) -> pd.Timestamp:
    """An aware time as a pandas timestamp in UTC."""
    return pd.Timestamp(time).tz_convert("UTC")  # type: ignore[arg-type]


def is_netcdf(path: Path) -> bool:
    """Whether a file is netCDF by its first bytes (classic or HDF5)."""
    with path.open("rb") as stream:
        start = stream.read(8)
    return start[:3] == b"CDF" or start == b"\x89HDF\r\n\x1a\n"


def weather_grid(path: Path, time: pd.Timestamp) -> weather.WeatherGrid:
    """The grid's hours that had been issued by ``time``, checked; DomainError where none had."""
    dataset = grids.read_netcdf(path, grids.WEATHER_GRID)
    issued = dataset["issued_at"].to_numpy().astype("datetime64[ns]")
    known = issued <= np.datetime64(time.tz_localize(None), "ns")
    if not known.any():
        raise DomainError(
            f"Nothing of the weather had been issued by {time.isoformat()}.",
            field="weather",
            value=str(issued.min()) if len(issued) else "no hours",
            accepted="weather with issued_at at or before the time",
        )
    newest_last = np.flatnonzero(known)[np.argsort(issued[known], kind="stable")]
    return weather.weather_from_dataset(dataset.isel(time=newest_last))


def weather_series(path: Path, time: pd.Timestamp) -> tuple[SeriesAt, dict[str, int]]:
    """A function giving hourly weather at a place, from a grid or a table of points, and what reading flagged."""
    if is_netcdf(path):
        grid = weather_grid(path, time)
        return lambda longitude, latitude: weather.series_at(grid, longitude, latitude), grid.flagged
    table = schema.read_table(path, tables.WEATHER)
    known = table[table["issued_at"] <= time].sort_values(["valid_at", "issued_at"], kind="stable")
    if known.empty:
        raise DomainError(f"Nothing of the weather had been issued by {time.isoformat()}.", field="weather")
    flagged = {}
    for name in weather.RANGES:
        known[name], flagged[name] = weather.check_weather(known[name].to_numpy(), name, "weather")
    known = known.assign(time=known["valid_at"])
    return lambda longitude, latitude: weather.series_at_stations(known, longitude, latitude, STATION_REACH_KM), flagged


def drought_at(path: Path | None, series_at: SeriesAt, time: pd.Timestamp) -> Callable[[float, float], float]:
    """KBDI in mm at a place and ``time``; NaN (to be imputed) without a fuels grid, off it, or where it is missing.

    The grid's value is that of its ``state_time``; from there whole days of weather up to ``time`` carry it on, where
    the grid states ``annual_rain_mm`` too.
    """
    if path is None:
        return lambda longitude, latitude: float("nan")
    dataset = longitudes.signed(grids.read_netcdf(path))
    if "kbdi" not in dataset.variables:
        return lambda longitude, latitude: float("nan")
    state_time = pd.to_datetime(str(dataset.attrs.get("state_time", "")), utc=True, errors="coerce")
    values = _flat(dataset, "kbdi")
    worst = float(values.max())
    if worst > KBDI_MAX_MM or float(values.min()) < 0:
        raise DomainError(
            f"'kbdi' reaches {worst:g}; it is probably in hundredths of an inch.",
            field="kbdi",
            value=worst,
            accepted=f"0..{KBDI_MAX_MM} mm",
        )
    if pd.isna(state_time) or "annual_rain_mm" not in dataset.variables:
        return lambda longitude, latitude: _nearest(values, longitude, latitude)
    annual = _flat(dataset, "annual_rain_mm")

    def at(longitude: float, latitude: float) -> float:
        start, rain = _nearest(values, longitude, latitude), _nearest(annual, longitude, latitude)
        return rating.carried_drought(start, rain, series_at(longitude, latitude), state_time, time)

    return at


def elevation_at(path: Path | None) -> Callable[[float, float], float]:
    """Height in metres of a place by the fuels grid; NaN without a grid, off it, or where the grid has no heights."""
    if path is None:
        return lambda longitude, latitude: float("nan")
    dataset = longitudes.signed(grids.read_netcdf(path))
    if "elevation_m" not in dataset.variables:
        return lambda longitude, latitude: float("nan")
    values = _flat(dataset, "elevation_m")
    return lambda longitude, latitude: _nearest(values, longitude, latitude)


def _flat(dataset: xr.Dataset, name: str) -> xr.DataArray:
    """A field of the fuels grid as (latitude, longitude); DomainError if it lies on other dimensions."""
    axes = ("latitude", "longitude")
    if set(dataset[name].dims) != set(axes) or not set(axes) <= set(dataset.variables):
        raise DomainError(
            f"'{name}' of the fuels grid lies on {tuple(map(str, dataset[name].dims))}.",
            field=name,
            value=str(dataset[name].dims),
            accepted="latitude, longitude",
        )
    return dataset[name].transpose(*axes)


def fuel_moisture_at(path: Path | None) -> Callable[[float, float, pd.Timestamp], float]:
    """Forecast 10-h moisture (per cent) at a place and hour; NaN where none is known, so that 1.28 x EMC stands in."""
    if path is None:
        return lambda longitude, latitude, hour: float("nan")
    values = fuel_moisture_grid(path)["fuel_moisture_10h_pct"].transpose("time", "latitude", "longitude")
    times = pd.DatetimeIndex(values["time"].to_numpy()).tz_localize("UTC")

    def at(longitude: float, latitude: float, hour: pd.Timestamp) -> float:
        index = int(times.get_indexer([hour], method="nearest")[0])
        if abs(times[index] - hour) > pd.Timedelta(hours=1):
            return float("nan")
        return _nearest(values.isel(time=index), longitude, latitude)

    return at


def fuel_moisture_grid(path: Path) -> xr.Dataset:
    """The product of forecast-fuel-moisture; DomainError naming the variable it lacks."""
    dataset = longitudes.signed(grids.read_netcdf(path))
    for name in ("fuel_moisture_10h_pct", "time", "latitude", "longitude"):
        if name not in dataset.variables:
            raise DomainError(
                f"The fuel moisture grid lacks '{name}'.",
                field="fuel_moisture",
                value=name,
                accepted="fuel_moisture_10h_pct",
            )
    return dataset


def _nearest(values: xr.DataArray, longitude: float, latitude: float) -> float:
    y, x = values["latitude"].to_numpy(), values["longitude"].to_numpy()
    row, column = int(np.abs(y - latitude).argmin()), int(np.abs(x - longitude).argmin())
    step_y = float(np.abs(np.diff(y)).max()) if len(y) > 1 else 1.0
    step_x = float(np.abs(np.diff(x)).max()) if len(x) > 1 else 1.0
    if abs(y[row] - latitude) > step_y or abs(x[column] - longitude) > step_x:
        return float("nan")
    return float(values.to_numpy()[row, column])


def fire_table(path: Path) -> pd.DataFrame:
    """A training table (CSV, gzipped CSV or Parquet) with the model's names and units, derived columns added.

    The Victorian and the US table are known by their own columns; any other must have ours.
    """
    head = path.open("rb").read(4)
    try:
        if head == b"PAR1":
            table = pd.read_parquet(path)
        else:
            table = pd.read_csv(path, compression="gzip" if head[:2] == b"\x1f\x8b" else None, low_memory=False)
    except (ValueError, OSError, EOFError) as error:
        raise DomainError(
            f"The table cannot be read: {error}", field="table", accepted="CSV, CSV.gz or Parquet"
        ) from error
    text = [name for name in features.NUMERIC if name in table.columns and not is_numeric_dtype(table[name])]
    table = table.assign(**{name: plain_columns.numbers(table, name, name) for name in text})
    if "T_SFC_historical" in table.columns:
        return features.from_victoria(table)
    if {"tmmx", "ics_id"} <= set(table.columns):
        return features.from_us(table)
    return features.derive(table)


STATION_COLUMNS = "Parquet with time, fuel_moisture_10h_pct and geometry or longitude_deg, latitude_deg"


def station_table(path: Path) -> pd.DataFrame:
    """Fuel-moisture observations: Parquet with time, fuel_moisture_10h_pct and points (geometry or *_deg columns)."""
    import geopandas

    try:
        frame = geopandas.read_parquet(path)
    except (ValueError, OSError):
        frame = _points(path)
    if "time" in frame.columns:
        frame["time"] = plain_columns.times(frame, "time", "observations")
    for name in ("fuel_moisture_10h_pct", "fuel_moisture_sd_pct"):
        if name in frame.columns:
            frame[name] = plain_columns.numbers(frame, name, "observations")
    if "fuel_moisture_sd_pct" in frame.columns and not (frame["fuel_moisture_sd_pct"].fillna(1.0) > 0).all():
        worst = float(frame["fuel_moisture_sd_pct"].min())
        raise DomainError(
            f"'fuel_moisture_sd_pct' of the observations falls to {worst:g}.",
            field="observations",
            value=worst,
            accepted="standard deviations above 0 %",
        )
    return frame


def _points(path: Path) -> pd.DataFrame:
    """A plain Parquet table as points; DomainError if it is none or has no places."""
    import geopandas

    try:
        frame = pd.read_parquet(path)
    except (ValueError, OSError) as error:
        raise DomainError(
            "The table of observations is not Parquet.", field="observations", accepted=STATION_COLUMNS
        ) from error
    if not {"longitude_deg", "latitude_deg"} <= set(frame.columns):
        raise DomainError("The observations have no place.", field="observations", accepted=STATION_COLUMNS)
    places = [plain_columns.numbers(frame, name, "observations") for name in ("longitude_deg", "latitude_deg")]
    return geopandas.GeoDataFrame(frame, geometry=geopandas.points_from_xy(*places), crs="EPSG:4326")
