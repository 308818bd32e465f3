"""Bobcat and Mineral: VIIRS granules around two real fires and the outline that an aircraft saw in infrared."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from services.arrival.assignment import assign
from services.arrival.field import FieldSettings
from services.arrival.fires import build_case, map_case
from services.arrival.looks import confident
from services.arrival.metrics import sorensen
from services.arrival.readers.granules import read_viirs

# Hours of the perimeter from 00 UTC of the ignition day, as the collection's authors give them.
FIRES = {"bobcat": ("2020-09-06T00:00Z", 56.25), "mineral": ("2020-07-13T00:00Z", 51.25)}


def sorensen_against_perimeter(data: Path, name: str, method: str, settings: FieldSettings | None = None) -> float:
    """Sorensen of the cells reached by the time of the airborne perimeter against its area."""
    folder = data / "active_fire" / name
    day, hours = FIRES[name]
    outline = gpd.read_file(next((folder / "ir_perimeter").glob("*HeatPerimeter.shp"))).to_crs(4326)
    west, south, east, north = outline.total_bounds
    area = (west - 0.15, south - 0.12, east + 0.15, north + 0.12)
    granules = [read_viirs(path, area) for path in sorted(folder.glob("VNP14IMG*.nc"))]
    detections = confident(gpd.GeoDataFrame(pd.concat(granules, ignore_index=True), crs=4326)).reset_index(drop=True)
    start = pd.Timestamp(day)
    incidents = gpd.GeoDataFrame(
        {"incident_id": [name], "name": [name], "start": [start + pd.Timedelta(hours=12)]},
        geometry=[shapely.box(west, south, east, north)],
        crs=4326,
    )
    nothing = detections.iloc[:0]
    case = build_case(
        incidents.iloc[0], detections, nothing, assign(detections, incidents), detections["time"].max(), 100.0, 3.0, 0
    )
    arrival = map_case(case, method, 0, settings)
    limit = (start + pd.Timedelta(hours=hours) - case.reference).total_seconds() / 3600.0
    x, y = np.meshgrid(case.grid.x_m, case.grid.y_m)
    shape = shapely.union_all(shapely.make_valid(outline.to_crs(case.grid.epsg).geometry.to_numpy()))
    return sorensen(arrival.arrival_h <= limit, shapely.contains_xy(shape, x, y))
