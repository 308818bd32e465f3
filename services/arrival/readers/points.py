"""Lists of active-fire points as detections: NASA FIRMS CSV and the analyses of NOAA's Hazard Mapping System (HMS).

Such lists hold fires only: a place that is missing may have been clear, cloudy or outside the swath, so they yield no
no-fire look.
"""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.arrival.readers.scanners import GEOSTATIONARY_LONGITUDE_DEG, geostationary_footprint_m
from shared.errors import DomainError

LATENCY = pd.Timedelta(hours=3)  # near-real-time active fires take about three hours (LANCE, FIRMS)
FIRMS_COLUMNS = ("latitude", "longitude", "scan", "track", "acq_date", "acq_time", "satellite", "confidence", "frp")
FIRMS_SATELLITES = {"N": "SUOMI NPP", "N20": "NOAA 20", "N21": "NOAA 21", "1": "NOAA 20", "2": "NOAA 21"}
FIRMS_SATELLITES |= {"T": "TERRA", "A": "AQUA"}
# Classes of VIIRS and Landsat rows; MODIS rows state per cent.
FIRMS_CLASSES = {"l": 20.0, "low": 20.0, "n": 75.0, "nominal": 75.0, "m": 75.0, "medium": 75.0}
FIRMS_CLASSES |= {"h": 95.0, "high": 95.0}
VEGETATION_FIRE = 0  # column `type` of the archive: 1 volcano, 2 other static source, 3 offshore
# HMS states the method of detection; `VIIRSS` is a VIIRS algorithm of another name. Pixel sides in m, at half swath for
# the polar orbiters since HMS gives no scan position.
HMS_METHODS = {"VIIRS": ("VIIRS", 470.0), "VIIRSS": ("VIIRS", 470.0), "MODIS": ("MODIS", 1400.0)}
HMS_GEOSTATIONARY = ("FDC", "WFABBA", "GOES")
HMS_ANALYST_M = 2000.0
Floats = NDArray[np.float64]


def _text_table(path: Path, name: str) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, dtype=str, skipinitialspace=True)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise DomainError(f"'{name}' is no table: {error}", field="path", value=name, accepted="CSV text") from error
    table.columns = [str(column).strip().lower().replace(" ", "_") for column in table.columns]
    return table.apply(lambda column: column.str.strip())


def _numbers(table: pd.DataFrame, column: str, name: str, low: float, high: float) -> Floats:
    """A column as floats; DomainError naming the first row that is no number or out of bounds (empty: NaN)."""
    text = table[column].fillna("")
    values = pd.to_numeric(text, errors="coerce").to_numpy(float)
    bad = (np.isnan(values) & (text != "").to_numpy()) | (values < low) | (values > high)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise DomainError(
            f"'{name}', line {row + 2}: {column} is '{text.iloc[row]}'",
            field=column,
            value=text.iloc[row],
            accepted=f"a number from {low:g} to {high:g}",
        )
    return values


def _placed(table: pd.DataFrame, lat: str, lon: str, name: str) -> tuple[Floats, Floats]:
    latitude, longitude = _numbers(table, lat, name, -90, 90), _numbers(table, lon, name, -180, 360)
    missing = np.isnan(latitude) | np.isnan(longitude)
    if missing.any():
        row = int(np.flatnonzero(missing)[0])
        raise DomainError(
            f"'{name}', line {row + 2} has no position", field=lat, value="empty", accepted="degrees north and east"
        )
    return latitude, (longitude + 180.0) % 360.0 - 180.0


def _instants(text: pd.Series, pattern: str, name: str, field: str) -> pd.Series:
    times = pd.to_datetime(text, format=pattern, utc=True, errors="coerce")
    if times.isna().any():
        row = int(np.flatnonzero(times.isna())[0])
        raise DomainError(
            f"'{name}', line {row + 2}: '{text.iloc[row]}' is no time",
            field=field,
            value=text.iloc[row],
            accepted=f"UTC as {pattern}",
        )
    return times


def _detections(columns: dict[str, object], longitude: Floats, latitude: Floats) -> gpd.GeoDataFrame:
    frame = pd.DataFrame({**columns, "fire": True, "look": "fire"})
    frame["delivered_at"] = frame["time"] + LATENCY
    return gpd.GeoDataFrame(frame, geometry=gpd.points_from_xy(longitude, latitude), crs="EPSG:4326")


def read_firms(path: str | Path, name: str | None = None) -> gpd.GeoDataFrame:
    """A FIRMS archive or near-real-time CSV (MODIS, VIIRS or Landsat) as detections, with `look` "fire".

    Footprints are the file's own: `track` along, `scan` across (km). VIIRS classes l, n and h become 20, 75 and 95.
    Volcanoes, other static sources and offshore points (`type` 1-3) are left out. Raises DomainError naming the line.
    """
    label = name or Path(path).name
    table = _text_table(Path(path), label)
    lacking = [column for column in FIRMS_COLUMNS if column not in table]
    if lacking:
        raise DomainError(
            f"'{label}' is no FIRMS table: it lacks {', '.join(lacking)}",
            field=lacking[0],
            value=label,
            accepted=", ".join(FIRMS_COLUMNS),
        )
    latitude, longitude = _placed(table, "latitude", "longitude", label)
    when = table["acq_date"] + " " + table["acq_time"].str.replace(":", "").str.slice(0, 4).str.zfill(4)
    stated = table["confidence"].str.lower()
    percent = _numbers(table.assign(confidence=stated.where(~stated.isin(FIRMS_CLASSES))), "confidence", label, 0, 100)
    satellite = table["satellite"].map(lambda value: FIRMS_SATELLITES.get(value, str(value).upper()))
    modis = satellite.isin(["TERRA", "AQUA"]).to_numpy()
    guessed = pd.Series(np.where(modis, "MODIS", "VIIRS"), table.index)
    instrument = table.get("instrument", guessed).astype(str).str.upper()
    frame = _detections(
        {
            "time": _instants(when, "%Y-%m-%d %H%M", label, "acq_date, acq_time"),
            "satellite": satellite,
            "instrument": instrument,
            "confidence": stated.map(FIRMS_CLASSES).fillna(pd.Series(percent, table.index)),
            "frp_mw": pd.Series(_numbers(table, "frp", label, -1e6, 1e6), table.index).where(lambda frp: frp >= 0),
            "along_m": 1e3 * _numbers(table, "track", label, 0, 20),
            "across_m": 1e3 * _numbers(table, "scan", label, 0, 20),
        },
        longitude,
        latitude,
    )
    kinds = table["type"].fillna("0") if "type" in table else pd.Series("0", table.index)
    return frame[(kinds == str(VEGETATION_FIRE)).to_numpy()].reset_index(drop=True)


def _hms_table(path: Path, name: str) -> pd.DataFrame:
    """Columns longitude, latitude, time (UTC), satellite, method, frp of the daily text file or a Parquet of it."""
    if path.read_bytes()[:4] == b"PAR1":
        table = pd.read_parquet(path)
        named = table.rename(columns={"lon_deg": "longitude", "lat_deg": "latitude", "frp_mw": "frp"})
        needed = ["longitude", "latitude", "time", "satellite", "method"]
        if any(column not in named for column in needed):
            raise DomainError(f"'{name}' is no HMS table", field="path", value=name, accepted=", ".join(needed))
        return named.assign(time=pd.to_datetime(named["time"], utc=True), frp=named.get("frp", np.nan))
    table = _text_table(path, name).rename(columns={"lon": "longitude", "lat": "latitude"})
    method = next((str(column) for column in table if str(column).startswith("method")), "method")
    needed = ["longitude", "latitude", "yearday", "time", "satellite", method]
    if any(column not in table for column in needed):
        raise DomainError(
            f"'{name}' is no HMS fire-point file",
            field="path",
            value=name,
            accepted="the daily text file of HMS: Lon, Lat, YearDay, Time, Satellite, Method of Detection, FRP",
        )
    latitude, longitude = _placed(table, "latitude", "longitude", name)
    when = table["yearday"] + " " + table["time"].str.zfill(4)
    power = next((column for column in table if column in ("frp", "fire_radpower")), "")
    frp = _numbers(table, power, name, -1e6, 1e6) if power else np.full(len(table), np.nan)
    return pd.DataFrame(
        {
            "longitude": longitude,
            "latitude": latitude,
            "time": _instants(when, "%Y%j %H%M", name, "YearDay, Time"),
            "satellite": table["satellite"],
            "method": table[method],
            "frp": frp,
        }
    )


def read_hms(path: str | Path, name: str | None = None) -> gpd.GeoDataFrame:
    """HMS fire points (daily text file, or Parquet with `lon_deg`, `lat_deg`, `time`, `satellite`, `method`) as
    detections, with `look` "fire".

    HMS gives neither confidence (null) nor footprint: VIIRS and MODIS points get their pixel at half swath,
    geostationary ones theirs by the angle of view, points set by an analyst 2 km. Raises DomainError naming the line.
    """
    label = name or Path(path).name
    table = _hms_table(Path(path), label).reset_index(drop=True)
    method, satellite = table["method"].astype(str).str.upper(), table["satellite"].astype(str).str.upper()
    longitude, latitude = table["longitude"].to_numpy(float), table["latitude"].to_numpy(float)
    size = method.map(lambda value: HMS_METHODS.get(value, ("", HMS_ANALYST_M))[1]).to_numpy(float)
    along, across = size.copy(), size.copy()
    for place, meridian in GEOSTATIONARY_LONGITUDE_DEG.items():
        seen = (method.isin(HMS_GEOSTATIONARY) & (satellite.str.replace("_", "-") == place)).to_numpy()
        along[seen], across[seen] = geostationary_footprint_m(longitude[seen], latitude[seen], meridian)
    instrument = method.map(lambda value: HMS_METHODS.get(value, (value, 0.0))[0])
    frame = _detections(
        {
            "time": table["time"],
            "satellite": satellite.str.replace("MODIS ", "", regex=False),
            "instrument": instrument.where(~method.isin(HMS_GEOSTATIONARY), "ABI"),
            "confidence": np.nan,
            "frp_mw": pd.to_numeric(table["frp"], errors="coerce").where(lambda frp: frp >= 0),
            "along_m": np.nan_to_num(along, nan=HMS_ANALYST_M),
            "across_m": np.nan_to_num(across, nan=HMS_ANALYST_M),
        },
        longitude,
        latitude,
    )
    return frame.drop_duplicates(["time", "satellite", "geometry"], ignore_index=True)
