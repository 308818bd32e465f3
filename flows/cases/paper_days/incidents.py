"""Incidents of a paper's day: those of WFIGS and ICS-209 as they could be known, and simulated ones where both lack."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from flows.cases.nature.fields import on_sphere_km
from flows.cases.wfigs import area_reports

KNOWN_AFTER = pd.Timedelta(hours=6)  # stated, not measured: from discovery to the first public incident record
WFIGS_ACTIVE = pd.Timedelta(days=21)
# An ICS-209 record here has a date and no hour: it counts as known once that date is over everywhere in the country.
ICS209_KNOWN_AFTER = pd.Timedelta(hours=24 + 8) + KNOWN_AFTER
ICS209_ACTIVE = pd.Timedelta(days=7)  # nothing says when such a fire was out
SAME_FIRE_KM, SAME_FIRE_WITHIN = 10.0, pd.Timedelta(days=3)
SEASON_DAYS = 20
SIMULATED_STARTED = pd.Timedelta(hours=60)
COLUMNS = [
    "incident_id",
    "name",
    "start",
    "known_at",
    "area_km2",
    "origin",
    "simulated",
    "longitude_deg",
    "latitude_deg",
]
Box = tuple[float, float, float, float]


def wfigs_fires(table: geopandas.GeoDataFrame, cutoff: datetime, end: datetime) -> pd.DataFrame:
    """Fires of the last three weeks and of the day itself, each known six hours after its discovery.

    Nothing of a later scrape enters but the place where no initial point is given: the middle of the first outline, to
    0.1 degree, which ``origin`` says. Fires whose last record by the cut-off says contained are left out.
    """
    moment, until = pd.Timestamp(cutoff), pd.Timestamp(end)
    rows = []
    for incident_id, own in table.sort_values("scraped").groupby("unique_fire_id", sort=True):
        discovered = own["discovered"].min()
        if not moment - WFIGS_ACTIVE < discovered <= until:
            continue
        contained = own.loc[own["scraped"] <= moment, "percent_contained"].dropna()
        if len(contained) and contained.iloc[-1] >= 100:
            continue
        rows.append(_wfigs_row(str(incident_id), own, discovered))
    return pd.DataFrame(rows, columns=COLUMNS)


def _wfigs_row(incident_id: str, own: geopandas.GeoDataFrame, discovered: pd.Timestamp) -> dict[str, object]:
    first = own.iloc[0]
    given = own[own["initial_lat_deg"].notna() & own["initial_lon_deg"].notna()]
    if len(given):
        place = (float(given.iloc[0]["initial_lon_deg"]), float(given.iloc[0]["initial_lat_deg"]))
    else:
        middle = first.geometry.representative_point()
        place = (round(middle.x, 1), round(middle.y, 1))
    origin = "WFIGS" if len(given) else "WFIGS, place to 0.1 degree from a later outline"
    told = {"start": discovered, "known_at": discovered + KNOWN_AFTER, "area_km2": np.nan}
    named = {"incident_id": incident_id, "name": str(first["incident"]).strip().title(), "origin": origin}
    return {**named, **told, "simulated": False, "longitude_deg": place[0], "latitude_deg": place[1]}


def ics209_fires(path: Path, beside: pd.DataFrame, cutoff: datetime, box: Box) -> pd.DataFrame:
    """Fires with a large-incident report that began in the last week and are not among those ``beside``.

    Of the report only name, date and place enter: its area is the final one, which nobody knew.
    """
    table = pd.read_parquet(path).dropna(subset=["lat_deg", "lon_deg", "ignition_date"])
    begun = pd.to_datetime(table["ignition_date"]).dt.tz_localize("UTC")
    moment = pd.Timestamp(cutoff)
    chosen = (begun > moment - ICS209_ACTIVE) & (begun + ICS209_KNOWN_AFTER <= moment) & _inside(table, box)
    table = table[chosen].assign(start=begun[chosen]).sort_values("incident_id").drop_duplicates(["lat_deg", "lon_deg"])
    new = ~_same_fire(table, beside)
    rows = pd.DataFrame(
        {
            "incident_id": "ICS209-" + table["incident_id"].str.replace(r"[^A-Za-z0-9]+", "-", regex=True),
            "name": table["name"],
            "start": table["start"],
            "known_at": table["start"] + ICS209_KNOWN_AFTER,
            "area_km2": np.nan,
            "origin": "ICS-209",
            "simulated": False,
            "longitude_deg": table["lon_deg"],
            "latitude_deg": table["lat_deg"],
        }
    )
    return rows[new].reset_index(drop=True)[COLUMNS]


def _same_fire(table: pd.DataFrame, beside: pd.DataFrame) -> np.ndarray:
    if beside.empty or table.empty:
        return np.zeros(len(table), dtype=bool)
    places = cKDTree(on_sphere_km(beside["longitude_deg"], beside["latitude_deg"]))
    near = places.query_ball_point(on_sphere_km(table["lon_deg"], table["lat_deg"]), SAME_FIRE_KM)
    starts = beside["start"].reset_index(drop=True)
    return np.array(
        [
            any(abs(starts[index] - start) <= SAME_FIRE_WITHIN for index in found)
            for found, start in zip(near, table["start"], strict=True)
        ]
    )


def simulated_fires(path: Path, count: int, cutoff: datetime, box: Box, seed: int) -> pd.DataFrame:
    """Fires that stand in for incidents not to be had: places of ICS-209 fires of the same season in earlier years."""
    table = pd.read_parquet(path).dropna(subset=["lat_deg", "lon_deg", "ignition_date"])
    begun = pd.to_datetime(table["ignition_date"])
    apart = (begun.dt.dayofyear - cutoff.timetuple().tm_yday + 182) % 365 - 182
    past = table[(begun.dt.year < cutoff.year) & (apart.abs() <= SEASON_DAYS) & _inside(table, box)]
    rng = np.random.default_rng([seed, 209])
    drawn = past.sort_values("incident_id").iloc[np.sort(rng.permutation(len(past))[:count])]
    moment = pd.Timestamp(cutoff)
    known = moment - pd.to_timedelta(np.round(rng.uniform(0, 1, len(drawn)) * SIMULATED_STARTED.total_seconds()), "s")
    return pd.DataFrame(
        {
            "incident_id": [f"SIM{number:03d}" for number in range(1, len(drawn) + 1)],
            "name": [f"Simulated {number}" for number in range(1, len(drawn) + 1)],
            "start": known - KNOWN_AFTER,
            "known_at": known,
            "area_km2": np.nan,
            "origin": "simulated",
            "simulated": True,
            "longitude_deg": drawn["lon_deg"].to_numpy(),
            "latitude_deg": drawn["lat_deg"].to_numpy(),
        }
    )[COLUMNS]


def reported_areas(table: geopandas.GeoDataFrame, fires: pd.DataFrame) -> pd.DataFrame:
    """What each scrape said of a fire's area: incident_id, known_at, area_km2."""
    own = table[table["unique_fire_id"].isin(fires["incident_id"]) & table["acres"].notna()].sort_values("scraped")
    told = own.rename(columns={"unique_fire_id": "incident_id", "scraped": "known_at"})
    return area_reports(told).drop_duplicates(["incident_id", "known_at"], keep="last").reset_index(drop=True)


def in_box(fires: pd.DataFrame, box: Box) -> pd.DataFrame:
    """The fires within a box (west, south, east, north in degrees)."""
    west, south, east, north = box
    inside = fires["longitude_deg"].between(west, east) & fires["latitude_deg"].between(south, north)
    return fires[inside].reset_index(drop=True)


def _inside(table: pd.DataFrame, box: Box) -> pd.Series[bool]:
    west, south, east, north = box
    return table["lon_deg"].between(west, east) & table["lat_deg"].between(south, north)
