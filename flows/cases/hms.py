"""Fire looks from NOAA HMS, and no-fire looks derived, cautiously, from where its satellites passed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from sgp4.api import Satrec

from flows.cases.nature.fields import KM_PER_DEG
from flows.cases.nature.setting import FloatArray

LATENCY = pd.Timedelta(hours=3)  # stated, not measured: near-real-time active fires take about three hours
METHODS = {"VIIRS": ("VIIRS", 375.0), "VIIRSS": ("VIIRS", 375.0), "MODIS": ("MODIS", 1000.0)}
# Half the swath less a tenth: near its edge the granule may have ended, and pixels are large.
REACH_KM = {"VIIRS": 1350.0, "MODIS": 1000.0}
PASS_WITHIN = pd.Timedelta(minutes=10)
LATTICE_KM = 1.5
AROUND_KM = 30.0
CLEAR_WITHIN_KM = 15.0
KEEP_OFF_KM = 2.5
EARTH_KM = 6371.0


def hms_fires(path: Path, region: tuple[float, float, float, float], start: str, end: str) -> pd.DataFrame:
    """VIIRS and MODIS fire points of a region (degrees) and time span, as ``detections`` without geometry.

    Analysts' points and geostationary ones are left out. Footprints are the nominal pixel of the instrument,
    confidence is not given by HMS (null), delivery is three hours after the overpass as stated.
    """
    return hms_looks(pd.read_parquet(path), region, pd.Timestamp(start, tz="UTC"), pd.Timestamp(end, tz="UTC"))


def hms_looks(
    table: pd.DataFrame, region: tuple[float, float, float, float], start: pd.Timestamp, end: pd.Timestamp
) -> pd.DataFrame:
    """As ``hms_fires``, of a table with lon_deg, lat_deg, time (UTC), satellite, method and frp_mw."""
    west, south, east, north = region
    inside = table.lon_deg.between(west, east) & table.lat_deg.between(south, north) & table.method.isin(list(METHODS))
    span = (table.time >= start) & (table.time < end)
    table = table[inside & span].drop_duplicates(["time", "satellite", "lat_deg", "lon_deg"])
    table = table.sort_values(["time", "satellite", "lat_deg", "lon_deg"]).reset_index(drop=True)
    size = table.method.map(lambda method: METHODS[method][1])
    return pd.DataFrame(
        {
            "time": table.time,
            "delivered_at": table.time + LATENCY,
            "satellite": table.satellite.str.replace("MODIS ", "", regex=False),
            "instrument": table.method.map(lambda method: METHODS[method][0]),
            "confidence": np.nan,
            "frp_mw": table.frp_mw.where(table.frp_mw >= 0),
            "fire": True,
            "along_m": size,
            "across_m": size,
            "derived": False,
            "longitude_deg": table.lon_deg,
            "latitude_deg": table.lat_deg,
        }
    )


def read_elements(path: Path) -> dict[str, Satrec]:
    """SGP4 satellites by name from a file of three-line elements."""
    lines = [line.strip() for line in path.read_text().splitlines() if line.strip()]
    groups = zip(lines[0::3], lines[1::3], lines[2::3], strict=True)
    return {name: Satrec.twoline2rv(first, second) for name, first, second in groups}


def subsatellite_unit_vectors(satellite: Satrec, times: np.ndarray) -> FloatArray:
    """Unit vectors (n, 3) to the satellite, Earth-fixed (TEME turned by Greenwich mean sidereal time).

    Good to some kilometres, which is all that a question of swaths needs. Sidereal time: Vallado (2013), eq. 3-47,
    its linear term.
    """
    julian = times.astype("datetime64[ms]").astype(np.float64) / 86_400_000.0 + 2440587.5
    error, position, _ = satellite.sgp4_array(np.floor(julian), julian - np.floor(julian))
    if error.any():
        raise ValueError(f"SGP4 error {int(error.max())} for satellite {satellite.satnum}")
    turn = np.radians((280.46061837 + 360.98564736629 * (julian - 2451545.0)) % 360.0)
    x = position[:, 0] * np.cos(turn) + position[:, 1] * np.sin(turn)
    y = position[:, 1] * np.cos(turn) - position[:, 0] * np.sin(turn)
    fixed = np.stack([x, y, position[:, 2]], axis=1)
    return np.asarray(fixed / np.linalg.norm(fixed, axis=1, keepdims=True))


def closest_pass(satellite: Satrec, time: pd.Timestamp, place: tuple[float, float]) -> tuple[pd.Timedelta, float]:
    """When, relative to a time, the ground track comes closest to a place (lon, lat degrees), and how close, km."""
    longitude, latitude = np.radians(place)
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    offsets = np.arange(-1800, 1801, 10)
    times = np.datetime64(time.tz_convert(None)) + offsets.astype("timedelta64[s]")
    distance = EARTH_KM * np.arccos(np.clip(subsatellite_unit_vectors(satellite, times) @ up, -1.0, 1.0))
    best = int(distance.argmin())
    return pd.Timedelta(seconds=int(offsets[best])), float(distance[best])


def derived_no_fire(fires: pd.DataFrame, satellites: dict[str, Satrec], centre: tuple[float, float]) -> pd.DataFrame:
    """No-fire looks around a fire (centre lon, lat in degrees), from snapshots that did look there and saw it.

    A snapshot (satellite and minute) counts only if it holds a fire point near the centre and the satellite's track
    passed within its swath inside ten minutes. Places are taken on a 1.5 km lattice within 15 km of a point of the
    same snapshot (so that cloud is unlikely) and more than 2.5 km from every fire point up to then: where it
    has burned, absence says nothing. Nothing later than the snapshot enters. Marked ``derived``.
    """
    lattice = _lattice(centre)
    near = fires[_distance_km(fires, centre) <= AROUND_KM]
    tree_of = {key: cKDTree(_plane(group, centre)) for key, group in near.groupby(["time", "satellite"])}
    spots = np.full(len(lattice), np.inf)
    frames = []
    for moment, snapshots in near.groupby("time"):
        for satellite in sorted(snapshots.satellite.unique()):
            spots = np.minimum(spots, tree_of[(moment, satellite)].query(lattice)[0])
        for satellite, group in snapshots.groupby("satellite"):
            if not _looked(group.iloc[0], satellites, centre):
                continue
            clear = tree_of[(moment, satellite)].query(lattice)[0] <= CLEAR_WITHIN_KM
            chosen = lattice[clear & (spots > KEEP_OFF_KM)]
            if len(chosen):
                frames.append(_looks(chosen, group.iloc[0], centre))
    return pd.concat(frames, ignore_index=True) if frames else fires.iloc[:0]


def _looked(example: pd.Series, satellites: dict[str, Satrec], centre: tuple[float, float]) -> bool:
    satellite = satellites.get(example.satellite)
    if satellite is None:
        return False
    offset, distance = closest_pass(satellite, example.time, centre)
    return bool(abs(offset) <= PASS_WITHIN and distance <= REACH_KM[example.instrument])


def _looks(chosen: FloatArray, example: pd.Series, centre: tuple[float, float]) -> pd.DataFrame:
    scale = KM_PER_DEG * np.cos(np.radians(centre[1]))
    same = ["time", "delivered_at", "satellite", "instrument", "along_m", "across_m"]
    return pd.DataFrame(
        {
            **{name: [example[name]] * len(chosen) for name in same},
            "confidence": np.nan,
            "frp_mw": np.nan,
            "fire": False,
            "derived": True,
            "longitude_deg": centre[0] + chosen[:, 0] / scale,
            "latitude_deg": centre[1] + chosen[:, 1] / KM_PER_DEG,
        }
    )


def _lattice(centre: tuple[float, float]) -> FloatArray:
    steps = np.arange(-AROUND_KM, AROUND_KM + 0.1, LATTICE_KM)
    east, north = (part.ravel() for part in np.meshgrid(steps, steps))
    within = np.hypot(east, north) <= AROUND_KM - KEEP_OFF_KM  # so that every fire point that matters has been read
    return np.stack([east[within], north[within]], axis=1)


def _plane(table: pd.DataFrame, centre: tuple[float, float]) -> FloatArray:
    """Kilometres east and north of the centre, (n, 2)."""
    east = (table.longitude_deg - centre[0]) * KM_PER_DEG * np.cos(np.radians(centre[1]))
    return np.stack([east, (table.latitude_deg - centre[1]) * KM_PER_DEG], axis=1)


def _distance_km(table: pd.DataFrame, centre: tuple[float, float]) -> FloatArray:
    return np.asarray(np.hypot(*_plane(table, centre).T))
