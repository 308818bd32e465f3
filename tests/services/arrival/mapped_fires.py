"""Black, Cerro Pelado, Cooks Peak and Tunnel (2022): HMS detections against the perimeters that people mapped.

A perimeter is trusted as the case of the Black Fire trusts it (scraped within 36 h of its date); the fire had that
outline somewhere in [date, scrape]. What an outline adds to the one before must have been reached between the earlier
one's date and the later one's scrape.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import binary_erosion, distance_transform_edt

from flows.cases.hms import derived_no_fire, hms_fires, read_elements
from flows.cases.simulated import with_points
from flows.cases.wfigs import trusted_perimeters
from services.arrival.assignment import assign
from services.arrival.fires import FireCase, build_case, map_case
from services.arrival.inference import ArrivalMap
from services.arrival.metrics import sorensen

FIRES = {
    "Black": "perimeters_wfigs_black_2022.parquet",
    "Cerro Pelado": "perimeters_wfigs_other_2022.parquet",
    "Cooks Peak": "perimeters_wfigs_other_2022.parquet",
    "Tunnel": "perimeters_wfigs_other_2022.parquet",
}
HMS = "fires/detections_hms_conus_20220405_20220717.parquet"
OVERPASSES = "orbits/tle_20220505/viirs_modis.tle"
FRESH_KM = 0.5
CELL_M = 250.0


@dataclass(frozen=True)
class Outline:
    """Cells inside a perimeter, the cells of its outline that are new since the one before, and the bracket (h)."""

    inside: np.ndarray
    fresh: np.ndarray
    before_h: float
    dated_h: float
    scraped_h: float


@dataclass(frozen=True)
class OutlineScore:
    """`reached`: share of the fresh outline reached within its bracket; `error_h`: mean hours outside it, cells never
    reached counted as reached at the end of the period; `sorensen`: best of five times between date and scrape."""

    reached: float
    error_h: float
    sorensen: float


def _bounded(shape: shapely.Geometry, pad_deg: float = 0.12) -> tuple[float, float, float, float]:
    west, south, east, north = shape.bounds
    return west - pad_deg, south - pad_deg, east + pad_deg, north + pad_deg


def mapped_case(data: Path, name: str) -> tuple[FireCase, list[Outline]]:
    """The fire as the service sees it (HMS VIIRS and MODIS points, no-fire looks derived from passes) and its
    outlines."""
    path = data / "fires" / FIRES[name]
    outlines = trusted_perimeters(path, name)
    record = gpd.read_parquet(path).query("incident == @name").iloc[0]
    place = (float(record.initial_lon_deg), float(record.initial_lat_deg))
    start, end = pd.Timestamp(record.discovered), outlines.known_at.max()
    region = _bounded(shapely.union_all([*outlines.geometry, shapely.Point(place)]))
    fires = hms_fires(data / HMS, region, str(start.tz_convert(None) - pd.Timedelta(days=1)), str(end.tz_convert(None)))
    looks = derived_no_fire(fires, read_elements(data / OVERPASSES), place)
    detections = with_points(pd.concat([fires, looks], ignore_index=True).sort_values("time", ignore_index=True))
    detections = detections[detections["time"] <= end].reset_index(drop=True)
    incident = gpd.GeoDataFrame(
        {"incident_id": [name], "name": [name], "start": [start]}, geometry=gpd.points_from_xy(*zip(place)), crs=4326
    )
    assigned = assign(detections, incident)
    case = build_case(incident.iloc[0], detections, detections.iloc[:0], assigned, end, CELL_M, 4.0, 0)
    return case, _outlines(case, outlines)


def _outlines(case: FireCase, perimeters: gpd.GeoDataFrame) -> list[Outline]:
    x, y = np.meshgrid(case.grid.x_m, case.grid.y_m)
    found, before = [], np.zeros(case.grid.shape, bool)
    before_h = case.ignition.time_h
    for shape, dated, scraped in zip(
        perimeters.to_crs(case.grid.epsg).geometry, perimeters.time, perimeters.known_at, strict=True
    ):
        inside = shapely.contains_xy(shape, x, y)
        edge = inside & ~binary_erosion(inside)
        away = distance_transform_edt(~before) * CELL_M / 1e3 if before.any() else np.full(inside.shape, np.inf)
        hours = [(time - case.reference).total_seconds() / 3600.0 for time in (dated, scraped)]
        found.append(Outline(inside, edge & (away > FRESH_KM), before_h, *hours))
        before, before_h = before | inside, hours[0]
    return found


def score_outlines(case: FireCase, arrival: ArrivalMap, outlines: list[Outline]) -> list[OutlineScore]:
    """One score an outline; those that add nothing have NaN for what concerns their fresh part."""
    scores = []
    hours = np.where(np.isfinite(arrival.arrival_h), arrival.arrival_h, case.end_h)
    for outline in outlines:
        times = np.linspace(outline.dated_h, outline.scraped_h, 5)
        overlap = max(sorensen(arrival.arrival_h <= time, outline.inside) for time in times)
        at = hours[outline.fresh]
        outside = np.maximum(np.maximum(outline.before_h - at, at - outline.scraped_h), 0.0)
        empty = at.size == 0
        reached = float("nan") if empty else float((outside == 0).mean())
        scores.append(OutlineScore(reached, float("nan") if empty else float(outside.mean()), overlap))
    return scores


def compare(data: Path, name: str, methods: tuple[str, ...]) -> dict[str, list[OutlineScore]]:
    """Every method's scores on the same case, outline by outline; empty where HMS has no detection of the fire."""
    case, outlines = mapped_case(data, name)
    if len(case.looks.fire) == 0:
        return {}
    return {method: score_outlines(case, map_case(case, method, 0), outlines) for method in methods}
