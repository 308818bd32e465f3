"""One fire after another: from the tables of a region to the arrival map of every incident."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from services.arrival.assignment import Assignment
from services.arrival.extent import gather
from services.arrival.grid import FireGrid, make_grid
from services.arrival.inference import DEFAULT_METHOD, FIT_ALONE, ArrivalMap, Settings, infer_arrival
from services.arrival.looks import Ignition, Looks, looks_from_burned_area, looks_from_detections, merge
from services.arrival.outlines import Outlines, honour, looks_from_outlines, read_outlines
from shared.errors import DomainError

MAX_NO_FIRE = 60_000
BURNED_AREA_REACH_KM = 8.0


@dataclass(frozen=True)
class FireCase:
    """One incident with its looks on its grid; hours count from `reference` (UTC, whole hour). `unlike` says in which
    way its input is none that the learned correction knows (empty: it may be)."""

    incident_id: str
    name: str
    reference: pd.Timestamp
    grid: FireGrid
    looks: Looks
    ignition: Ignition
    end_h: float
    outlines: Outlines | None = None
    unlike: str = ""


def within(frame: gpd.GeoDataFrame, start: pd.Timestamp, end: pd.Timestamp) -> gpd.GeoDataFrame:
    """Rows with start <= time <= end. Raises DomainError where end is not after start."""
    if end <= start:
        raise DomainError(
            "the period ends before it starts", field="end", value=str(end), accepted=f"a time after {start}"
        )
    times = pd.to_datetime(frame["time"], utc=True)
    return frame[(times >= start) & (times <= end)]


def _on_grid(frame: gpd.GeoDataFrame, grid: FireGrid) -> NDArray[np.bool_]:
    x, y = grid.local_km(frame.geometry.x.to_numpy(float), frame.geometry.y.to_numpy(float))
    rows, columns = grid.shape
    half = grid.cell_m / 2e3
    return (np.abs(x) <= columns * half) & (np.abs(y) <= rows * half)


def _thinned(no_fire: gpd.GeoDataFrame, seed: int) -> gpd.GeoDataFrame:
    if len(no_fire) <= MAX_NO_FIRE:
        return no_fire
    chosen = np.random.default_rng(seed).choice(len(no_fire), MAX_NO_FIRE, replace=False)
    return no_fire.iloc[np.sort(chosen)]


def _near_own_fire(
    burned_area: gpd.GeoDataFrame, own: gpd.GeoDataFrame, others: gpd.GeoDataFrame, grid: FireGrid
) -> NDArray[np.bool_]:
    """Burned-area points nearer to this incident's detections than to another's, and within reach of them."""
    from scipy.spatial import cKDTree

    def place(frame: gpd.GeoDataFrame) -> NDArray[np.float64]:
        return np.column_stack(grid.local_km(frame.geometry.x.to_numpy(float), frame.geometry.y.to_numpy(float)))

    points = place(burned_area)
    mine = cKDTree(place(own)).query(points)[0]
    theirs = cKDTree(place(others)).query(points)[0] if len(others) else np.full(len(points), np.inf)
    return (mine <= theirs) & (mine <= BURNED_AREA_REACH_KM)


def build_case(
    incident: pd.Series,
    detections: gpd.GeoDataFrame,
    burned_area: gpd.GeoDataFrame,
    assignment: Assignment,
    end: pd.Timestamp,
    cell_m: float,
    margin_km: float,
    seed: int,
    known: gpd.GeoDataFrame | None = None,
) -> FireCase:
    """The looks of one incident on a grid of its own. Tables hold only rows up to `end`.

    The grid spans the incident's detections (without any: its ignition) with a margin; no-fire looks on it take
    part, burned-area points near the incident's own detections too. A point geometry is the place of ignition; an
    outline is used for the assignment only, so that a perimeter never enters what it may be scored against. `known`
    holds this incident's time-stamped perimeters and ignition points where the caller gives any: those do enter.
    """
    incident_id = str(incident["incident_id"])
    own = detections.iloc[assignment.fire[incident_id]]
    taken = np.concatenate(
        [rows for name, rows in assignment.fire.items() if name != incident_id] + [np.zeros(0, np.int64)]
    )
    others = detections.iloc[taken.astype(np.int64)]
    origin = incident.geometry if incident.geometry.geom_type == "Point" else incident.geometry.representative_point()
    is_point = incident.geometry.geom_type == "Point"
    lon, lat = own.geometry.x.to_numpy(float), own.geometry.y.to_numpy(float)
    if is_point or len(own) == 0:
        lon, lat = np.append(lon, origin.x), np.append(lat, origin.y)
    if known is not None and len(known):
        corners = shapely.get_coordinates(known.geometry.to_numpy())
        lon, lat = np.append(lon, corners[:, 0]), np.append(lat, corners[:, 1])
    grid = make_grid(lon, lat, cell_m, margin_km)
    started = pd.Timestamp(incident["start"]).tz_convert("UTC")
    dated = [table["time"].min() for table in (own, known) if table is not None and len(table)]
    reference = min([started, *dated]).floor("h")
    no_fire = detections[~detections["fire"].to_numpy(bool)]
    no_fire = _thinned(no_fire[_on_grid(no_fire, grid)], seed)
    parts = [looks_from_detections(pd.concat([own, no_fire]), grid, reference)]
    if len(burned_area):
        chosen = burned_area[_on_grid(burned_area, grid)]
        if len(own) and len(chosen):
            chosen = chosen[_near_own_fire(chosen, own, others, grid)]
        parts.append(looks_from_burned_area(chosen, grid, reference))
    x, y = (float(value[0]) for value in grid.local_km(np.array([origin.x]), np.array([origin.y])))
    start_h = (started - reference).total_seconds() / 3600.0
    ignition = Ignition(start_h, x, y) if is_point else Ignition(start_h)
    outlines = read_outlines(known, grid, reference) if known is not None and len(known) else None
    if outlines is not None:
        parts.append(looks_from_outlines(outlines, grid))
        ignition = _known_ignition(ignition, outlines)
    looks = merge(parts)
    looks = looks.take(looks.time_h >= 0.0)
    return FireCase(
        incident_id,
        str(incident["name"]),
        reference,
        grid,
        looks,
        ignition,
        (end - reference).total_seconds() / 3600.0,
        outlines,
        _unlike(own, outlines),
    )


def _unlike(fires: gpd.GeoDataFrame, outlines: Outlines | None) -> str:
    """What no training fire was like: looks made of perimeters; and points whose source states no confidence, as
    HMS's do not, whose looks without fire are no scanner's either (on the Black Fire's the correction did harm)."""
    if outlines is not None:
        return "perimeters or ignition points given"
    unrated = len(fires) and fires["confidence"].isna().mean() > 0.5
    return "most sightings state no confidence" if unrated else ""


def _known_ignition(reported: Ignition, outlines: Outlines) -> Ignition:
    """The earliest known ignition point, where one is given, instead of what the incident reports."""
    if outlines.point_h.size == 0:
        return reported
    first = int(outlines.point_h.argmin())
    place = (float(outlines.point_x_km[first]), float(outlines.point_y_km[first]))
    return Ignition(float(outlines.point_h[first]), *place)


def map_case(
    case: FireCase,
    method: str,
    seed: int,
    settings: Settings | None = None,
    progress: Callable[[str], None] | None = None,
) -> ArrivalMap:
    """The arrival map of a case; without any fire evidence an empty map flagged `no-detection`, where nothing burned
    is claimed."""
    used = FIT_ALONE if case.unlike and method == DEFAULT_METHOD else method
    try:
        found = infer_arrival(case.looks, case.grid, case.ignition, case.end_h, used, seed, settings, progress)
        if used != method:
            found = replace(found, basis=f"{FIT_ALONE}: {case.unlike}")
        return found if case.outlines is None else honour(found, case.outlines, case.looks, case.ignition.time_h)
    except DomainError as error:
        if error.field != "detections":
            raise
    blank = np.full(case.grid.shape, np.nan)
    return ArrivalMap(
        case.grid,
        gather(case.grid, case.looks),
        blank,
        blank,
        blank,
        blank,
        np.zeros(case.grid.shape),
        ("no-detection",),
        0,
        0,
    )


def case_report(case: FireCase, arrival: ArrivalMap) -> dict[str, object]:
    """Counts, burned area (km2), times and the weak spots of one map, for people and for the flow."""
    looks, hours = case.looks, arrival.arrival_h
    burned = np.isfinite(hours)
    cell_km2 = (case.grid.cell_m / 1e3) ** 2
    latest = case.reference + pd.Timedelta(hours=float(looks.time_h.max())) if len(looks) else None
    return {
        "incident_id": case.incident_id,
        "name": case.name,
        "reference_time": case.reference.isoformat(),
        "fire_detections": len(looks.fire),
        "no_fire_looks": len(looks.no_fire),
        "burned_area_points": len(looks.burned_area),
        "latest_look": latest.isoformat() if latest is not None else None,
        "burned_km2": round(float(burned.sum()) * cell_km2, 3),
        "mean_sd_h": round(float(np.nanmean(arrival.sd_h)), 3) if burned.any() else None,
        "not_seen_share": round(float((arrival.evidence.information == 0).mean()), 4),
        "flags": list(arrival.flags),
        "basis": arrival.basis,
        "network_parameters": arrival.parameters,
        "epsg": case.grid.epsg,
    }
