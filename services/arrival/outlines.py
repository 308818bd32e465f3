"""Known ignition points and time-stamped perimeters: what they say as looks, and what they bound for certain.

A perimeter at t says burned by t inside and not by t outside; a point says burning there at t. Both come from people
on or above the fire, so they bound the map, where a satellite's look only weighs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from services.arrival.grid import FireGrid, project
from services.arrival.inference import ArrivalMap
from services.arrival.looks import BURNED_AREA, FIRE, OTHER_SENSOR, Looks

INSIDE, OUTSIDE = 0.97, 0.03
MOST_CELLS = 600
RING_KM = 3.0
# Mapped outlines lie some hundred metres off; a cell this near outside may have burned.
SLACK_KM = 0.25
FRESH_KM = 0.75
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Outlines:
    """One fire's perimeters on its grid: hours (n,) ascending, `inside` (n, rows, columns), `distance_km` to each
    outline outside it (0 inside); ignition points: hours and local km (m,); and flags for what could not be used."""

    time_h: Floats
    inside: Mask
    distance_km: Floats
    point_h: Floats
    point_x_km: Floats
    point_y_km: Floats
    flags: tuple[str, ...]


def area_of(geometry: BaseGeometry) -> BaseGeometry | None:
    """The areal part of a perimeter, made valid: polygons of it, and lines that close; None where it has no area."""
    parts = shapely.get_parts(geometry) if geometry.geom_type.endswith(("Collection", "LineString")) else [geometry]
    areas = []
    for part in parts:
        if part.geom_type == "LineString" and part.is_ring:
            part = shapely.Polygon(shapely.get_coordinates(part))
        elif part.geom_type == "GeometryCollection":
            part = area_of(part)
        if part is not None and part.geom_type in ("Polygon", "MultiPolygon"):
            areas.append(shapely.make_valid(part))
    whole = shapely.union_all(areas) if areas else None
    if whole is not None and whole.geom_type == "GeometryCollection":  # make_valid leaves slivers as lines
        kept = [part for part in shapely.get_parts(whole) if part.geom_type.endswith("Polygon")]
        whole = shapely.union_all(kept)
    return whole if whole is not None and whole.area > 0 else None


def _projected(geometry: BaseGeometry, epsg: int) -> BaseGeometry:
    def move(degrees: Floats) -> Floats:
        return np.column_stack(project(epsg, degrees[:, 0], degrees[:, 1]))

    moved = shapely.transform(geometry, move)
    return moved if moved.is_valid else shapely.make_valid(moved)


def read_outlines(rows: gpd.GeoDataFrame, grid: FireGrid, reference: pd.Timestamp) -> Outlines:
    """Perimeters and ignition points (rows with `time` and `geometry`) of one fire on its grid.

    Lines that do not close and shapes without area bound nothing: flagged `perimeter-without-area` and left out.
    """
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    cells = shapely.points(x, y)
    hours = (pd.to_datetime(rows["time"], utc=True) - reference).dt.total_seconds().to_numpy(float) / 3600.0
    times, insides, distances, points, flags = [], [], [], [], set()
    for hour, geometry in zip(hours, rows.geometry, strict=True):
        if geometry.geom_type in ("Point", "MultiPoint"):
            points += [(hour, point.x, point.y) for point in shapely.get_parts(geometry)]
            continue
        area = area_of(geometry)
        if area is None:
            flags.add("perimeter-without-area")
            continue
        flat = _projected(area, grid.epsg)
        shapely.prepare(flat)
        times.append(hour)
        insides.append(shapely.contains_xy(flat, x, y))
        distances.append(np.where(insides[-1], 0.0, shapely.distance(flat, cells) / 1e3))
    order = np.argsort(times, kind="stable")
    shape = (len(times), *grid.shape)
    local = grid.local_km(np.array([p[1] for p in points], float), np.array([p[2] for p in points], float))
    return Outlines(
        np.array(times, float)[order],
        np.array(insides, bool).reshape(shape)[order],
        np.array(distances, float).reshape(shape)[order],
        np.array([p[0] for p in points], float),
        *local,
        tuple(sorted(flags)),
    )


def _spread(mask: Mask, most: int) -> NDArray[np.int64]:
    """Flat indices of at most `most` cells of a mask, evenly drawn."""
    found = np.flatnonzero(mask.ravel())
    return found if found.size <= most else found[np.linspace(0, found.size - 1, most).astype(int)]


def looks_from_outlines(outlines: Outlines, grid: FireGrid) -> Looks:
    """Perimeters as burned-area looks of cells inside and in a ring around, ignition points as fires seen."""
    x, y = (values.ravel() for values in grid.cell_centres_km())
    parts = [(outlines.point_x_km, outlines.point_y_km, outlines.point_h, FIRE, 1.0)]
    for hour, inside, distance in zip(outlines.time_h, outlines.inside, outlines.distance_km, strict=True):
        ring = ~inside & (distance > SLACK_KM) & (distance <= RING_KM)
        for mask, probability in ((inside, INSIDE), (ring, OUTSIDE)):
            chosen = _spread(mask, MOST_CELLS)
            parts.append((x[chosen], y[chosen], np.full(chosen.size, hour), BURNED_AREA, probability))
    sizes = [part[0].size for part in parts]
    count = sum(sizes)
    return Looks(
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([part[2] for part in parts]),
        np.repeat([part[3] for part in parts], sizes).astype(np.int8),
        np.full(count, OTHER_SENSOR, np.int8),
        np.repeat([part[4] for part in parts], sizes).astype(float),
        np.full(count, grid.cell_m / 2e3),
        np.full(count, grid.cell_m / 2e3),
    )


def _bounds(outlines: Outlines, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Hours (rows, columns) by which each cell had burned (inf: never mapped inside) and had not yet (-inf)."""
    by = np.full(shape, np.inf)
    for hour, inside in zip(outlines.time_h[::-1], outlines.inside[::-1], strict=True):
        by = np.where(inside, hour, by)
    after = np.full(shape, -np.inf)
    for hour, distance in zip(outlines.time_h, outlines.distance_km, strict=True):
        after = np.where((distance > SLACK_KM) & (hour < by), hour, after)
    return by, after


def honour(arrival: ArrivalMap, outlines: Outlines, looks: Looks, start_h: float) -> ArrivalMap:
    """The map within what the perimeters bound: burned inside by their time, not burned outside until then.

    A cell outside the latest perimeter stays burned only where a fire was seen within 0.75 km after it. Intervals
    and spreads shrink to the bracket; `start_h` bounds what no earlier perimeter does.
    """
    flags = tuple(dict.fromkeys((*arrival.flags, *outlines.flags, *(["perimeters"] if outlines.time_h.size else []))))
    if outlines.time_h.size == 0:
        return replace(arrival, flags=flags)
    by, after = _bounds(outlines, arrival.grid.shape)
    low = np.maximum(after, start_h)
    inside = np.isfinite(by)
    width = np.where(inside, by - np.minimum(low, by), np.inf)
    middle = by - np.where(inside, width, 0.0) / 2
    hours = np.where(inside & ~np.isfinite(arrival.arrival_h), middle, arrival.arrival_h)
    stale = ~inside & (hours <= after) & ~_seen_since(arrival.grid, looks, after)
    hours = np.where(stale, np.nan, np.minimum(np.fmax(hours, np.where(np.isnan(hours), hours, low)), by))
    sd = np.fmin(np.where(np.isfinite(hours), np.nan_to_num(arrival.sd_h, nan=np.inf), np.nan), width / np.sqrt(12.0))
    sd = np.where(np.isfinite(sd) | ~np.isfinite(hours), sd, 0.0)
    fill = np.where(inside, width, 0.0)
    q05 = np.where(np.isfinite(arrival.q05_h), arrival.q05_h, hours - 0.45 * fill)
    q95 = np.where(np.isfinite(arrival.q95_h), arrival.q95_h, hours + 0.45 * fill)
    blank = np.where(np.isfinite(hours), 0.0, np.nan)
    probability = np.where(inside, np.maximum(arrival.burned_probability, INSIDE), arrival.burned_probability)
    return replace(
        arrival,
        arrival_h=hours,
        sd_h=sd + blank,
        q05_h=np.minimum(np.clip(q05, low, by), hours) + blank,
        q95_h=np.maximum(np.clip(q95, low, by), hours) + blank,
        burned_probability=np.where(stale, np.minimum(probability, OUTSIDE), probability),
        flags=flags,
    )


def _seen_since(grid: FireGrid, looks: Looks, after_h: Floats) -> Mask:
    """Cells (rows, columns) near which a fire was seen later than their own bound."""
    fire = looks.fire
    seen = np.zeros(grid.shape, bool)
    x, y = grid.cell_centres_km()
    for bound in np.unique(after_h[np.isfinite(after_h)]):
        later = fire.take(fire.time_h > bound)
        if len(later):
            distance, _ = cKDTree(np.column_stack([later.x_km, later.y_km])).query(np.stack([x, y], axis=-1))
            seen |= (after_h == bound) & (distance <= FRESH_KM)
    return seen
