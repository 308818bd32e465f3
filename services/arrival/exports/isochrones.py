"""Isochrones of an arrival map as GeoJSON (RFC 7946): where the front stood at given times."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import contourpy
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.arrival.exports.product import iso
from services.arrival.inference import ArrivalMap

Floats = NDArray[np.float64]
MAX_LEVELS = 24
STEPS_H = (1, 2, 3, 6, 12, 24, 48, 72, 168)


def step_hours(span_h: float, most: int = MAX_LEVELS) -> int:
    """The smallest round step that cuts `span_h` into at most `most` levels."""
    return next((step for step in STEPS_H if span_h / step <= most), STEPS_H[-1])


def levels(arrival_h: Floats, reference: pd.Timestamp, most: int = MAX_LEVELS) -> Floats:
    """Hours since `reference` of the isochrones: whole multiples of the step in UTC, and the last arrival."""
    known = arrival_h[np.isfinite(arrival_h)]
    if known.size == 0:
        return np.zeros(0)
    step = step_hours(float(np.ptp(known)), most)
    offset = (reference - reference.normalize()).total_seconds() / 3600.0
    first = (np.floor((known.min() + offset) / step) + 1) * step - offset
    return np.unique(np.append(np.arange(first, known.max(), step), known.max()))


def split_at_antimeridian(line: Floats) -> list[list[list[float]]]:
    """A line (n, 2) of degrees as parts that do not cross 180 degrees (RFC 7946, section 3.1.9)."""
    parts: list[list[list[float]]] = []
    current = [[float(line[0, 0]), float(line[0, 1])]]
    for (lon0, lat0), (lon1, lat1) in pairwise(line):
        if abs(lon1 - lon0) > 180:
            side = 180.0 if lon0 > 0 else -180.0
            gap = lon1 + 2 * side - lon0
            latitude = float(lat0 + (lat1 - lat0) * (side - lon0) / gap) if gap else float(lat0)
            parts.append([*current, [side, latitude]])
            current = [[-side, latitude]]
        current.append([float(lon1), float(lat1)])
    parts.append(current)
    rounded = [[[round(lon, 6), round(lat, 6)] for lon, lat in part] for part in parts]
    return [part for part in rounded if len(part) > 1]


def isochrone_features(arrival: ArrivalMap, reference: pd.Timestamp, incident_id: str) -> list[dict[str, Any]]:
    """One MultiLineString feature per time, earliest first; properties `incident_id`, `time` (ISO, UTC), `area_km2`
    burned by then."""
    hours = arrival.arrival_h
    wanted = levels(hours, reference)
    if wanted.size == 0:
        return []
    # Unburned cells lie beyond the last level, so that isochrones close; the pad closes those at the edge of the grid.
    beyond = float(wanted[-1]) + max(float(np.nanmax(hours) - np.nanmin(hours)), 1.0)
    padded = np.pad(np.where(np.isfinite(hours), hours, beyond), 1, constant_values=beyond)
    cell = arrival.grid.cell_m
    x = np.concatenate([[arrival.grid.x_m[0] - cell], arrival.grid.x_m, [arrival.grid.x_m[-1] + cell]])
    y = np.concatenate([[arrival.grid.y_m[0] - cell], arrival.grid.y_m, [arrival.grid.y_m[-1] + cell]])
    generator = contourpy.contour_generator(x, y, padded)
    features = []
    for level in wanted:
        parts: list[list[list[float]]] = []
        for line in generator.lines(float(level)):
            lon, lat = arrival.grid.degrees(np.asarray(line)[:, 0], np.asarray(line)[:, 1])
            parts += split_at_antimeridian(np.column_stack([lon, lat]))
        if not parts:
            continue
        burned = float((hours <= level).sum()) * (cell / 1e3) ** 2
        properties = {
            "incident_id": incident_id,
            "time": iso(reference + pd.Timedelta(hours=float(level))),
            "area_km2": round(burned, 3),
        }
        features.append(
            {"type": "Feature", "properties": properties, "geometry": {"type": "MultiLineString", "coordinates": parts}}
        )
    return features
