"""Bobcat and Mineral: VIIRS granules around two real fires and the outline that an aircraft saw in infrared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from services.arrival.assignment import assign
from services.arrival.fires import FireCase, build_case, map_case
from services.arrival.inference import Settings
from services.arrival.looks import confident
from services.arrival.metrics import sorensen
from services.arrival.readers.granules import read_viirs

# Hours of the perimeter from 00 UTC of the ignition day, as the collection's authors give them.
FIRES = {"bobcat": ("2020-09-06T00:00Z", 56.25), "mineral": ("2020-07-13T00:00Z", 51.25)}


@dataclass(frozen=True)
class AirborneCase:
    """A fire as the service sees it, the cells inside the airborne outline, and when (hours) the aircraft saw it."""

    case: FireCase
    inside: np.ndarray
    seen_h: float

    def sorensen(self, method: str, settings: Settings | None = None) -> float:
        """Sorensen of the cells reached by the time of the airborne perimeter against its area."""
        return sorensen(map_case(self.case, method, 0, settings).arrival_h <= self.seen_h, self.inside)


def airborne_case(data: Path, name: str) -> AirborneCase:
    """The granules around one fire, its grid of 100 m and its outline."""
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
    x, y = np.meshgrid(case.grid.x_m, case.grid.y_m)
    shape = shapely.union_all(shapely.make_valid(outline.to_crs(case.grid.epsg).geometry.to_numpy()))
    limit = (start + pd.Timedelta(hours=hours) - case.reference).total_seconds() / 3600.0
    return AirborneCase(case, shapely.contains_xy(shape, x, y), limit)


def sorensen_against_perimeter(data: Path, name: str, method: str, settings: Settings | None = None) -> float:
    """Sorensen of one method's cells reached by the time of the airborne perimeter against its area."""
    return airborne_case(data, name).sorensen(method, settings)
