"""Mapped fire perimeters (NIFC WFIGS): which of them can be trusted, and the fire arrival that lies between them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import shapely
from pyproj import Transformer
from scipy.ndimage import distance_transform_edt

from flows.cases.nature.spread import FireGrid
from flows.cases.scoring import polygonal

KM2_PER_ACRE = 0.0040468564224
TRUSTED_WITHIN = pd.Timedelta(hours=36)


def trusted_perimeters(path: Path, incident: str) -> geopandas.GeoDataFrame:
    """The trustworthy perimeters of one incident, in order of time, as a ``perimeters`` table with ``acres``.

    ``time`` (when the polygon is dated) is often stale: a row counts only where it was scraped less than 36 h
    later, and of several rows at one time the earliest scrape does. ``known_at`` is the scrape; the fire had the
    outline somewhere between the two.
    """
    table = geopandas.read_parquet(path)
    table = table[table.incident == incident].to_crs(4326)
    age = table.scraped - table.polygon_time
    table = table[(age >= pd.Timedelta(0)) & (age < TRUSTED_WITHIN)].sort_values(["polygon_time", "scraped"])
    table = table.drop_duplicates("polygon_time", keep="first").reset_index(drop=True)
    geometry = [polygonal(shape) for shape in table.geometry]
    columns = pd.DataFrame(
        {
            "incident_id": table.unique_fire_id.astype(str),
            "time": table.polygon_time,
            "known_at": table.scraped,
            "acres": table.acres,
        }
    )
    return geopandas.GeoDataFrame(columns, geometry=geometry, crs=4326)


def arrival_between(
    perimeters: geopandas.GeoDataFrame,
    origin: tuple[float, float],
    discovered: datetime,
    start: datetime,
    *,
    epsg: int,
    cell_m: float = 250.0,
    margin_m: float = 6000.0,
) -> FireGrid:
    """A fire arrival that has every perimeter burned at the time it is dated, hours since ``start``.

    From the origin (longitude, latitude in degrees) at ``discovered`` on, the time between two outlines is shared out
    by the distance to each. The date is the early end of the span in which the fire had the outline; taking the late
    one (the scrape) would have the Black Fire's arrival more than an hour after 84 % of the VIIRS points of 14-21 May
    inside the outlines, the date after 18 %. A stand-in for the truth that the DDM simulator needs, not an observation.
    """
    to_utm = Transformer.from_crs(4326, epsg, always_xy=True)
    outlines = geopandas.GeoSeries(perimeters.geometry).to_crs(epsg)
    west, south, east, north = outlines.total_bounds
    x_m = np.arange(np.floor((west - margin_m) / cell_m), np.ceil((east + margin_m) / cell_m)) * cell_m + cell_m / 2
    y_m = np.arange(np.floor((south - margin_m) / cell_m), np.ceil((north + margin_m) / cell_m)) * cell_m + cell_m / 2
    x, y = np.meshgrid(x_m, y_m)
    where = to_utm.transform(*origin)
    burned = np.hypot(x - where[0], y - where[1]) < cell_m
    hour = _hours(discovered, start)
    arrival = np.where(burned, hour, np.nan)
    for outline, dated in zip(outlines, perimeters.time, strict=True):
        shapely.prepare(outline)
        reached = burned | shapely.contains_xy(outline, x, y)
        inner, outer = distance_transform_edt(~burned), distance_transform_edt(reached)
        later = _hours(dated, start)
        fresh = reached & ~burned
        share = inner[fresh] / (inner[fresh] + outer[fresh])
        arrival[fresh] = hour + share * (later - hour)
        burned, hour = reached, later
    return FireGrid(str(perimeters.incident_id.iloc[0]), x_m, y_m, epsg, arrival)


def area_reports(perimeters: geopandas.GeoDataFrame) -> pd.DataFrame:
    """The reported areas as they became known: incident_id, known_at, area_km2."""
    reports: Sequence[float] = np.round(perimeters.acres * KM2_PER_ACRE, 1)
    return pd.DataFrame(
        {"incident_id": perimeters.incident_id, "known_at": perimeters.known_at, "area_km2": reports}
    ).reset_index(drop=True)


def _hours(time: datetime, start: datetime) -> float:
    return (pd.Timestamp(time) - pd.Timestamp(start)).total_seconds() / 3600.0
