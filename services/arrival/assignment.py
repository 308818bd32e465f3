"""Which looks belong to which incident: fire detections by clusters in space, everything else by nearness."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely import contains_xy, get_coordinates

from services.arrival.looks import positions

EARTH_KM = 6371.0088
LINK_KM = 3.0
REACH_KM = 10.0
EARLY_DAYS = 3.0


@dataclass(frozen=True)
class Assignment:
    """Row positions of detections and burned-area points per incident; `unassigned` fire detections belong to none."""

    fire: dict[str, NDArray[np.int64]]
    unassigned: NDArray[np.int64]


def unit_vectors(longitude_deg: NDArray[np.float64], latitude_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions on the sphere in km (n, 3): straight distances there know no antimeridian."""
    lon, lat = np.radians(longitude_deg), np.radians(latitude_deg)
    return EARTH_KM * np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def clusters(points_km: NDArray[np.float64], link_km: float = LINK_KM) -> NDArray[np.int64]:
    """Single-linkage labels (n,) of points (n, 3): two points within `link_km` belong together."""
    if len(points_km) == 0:
        return np.zeros(0, np.int64)
    # A thousand detections of one pixel need not be linked pair by pair: link the distinct places.
    places, back = np.unique(np.round(points_km, 1), axis=0, return_inverse=True)
    pairs = cKDTree(places).query_pairs(link_km, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(places), len(places)))
    return connected_components(graph, directed=False)[1][back.ravel()].astype(np.int64)


def _incident_points(incidents: gpd.GeoDataFrame) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    coordinates, owner = get_coordinates(incidents.geometry.to_numpy(), return_index=True)
    return unit_vectors(coordinates[:, 0], coordinates[:, 1]), owner.astype(np.int64)


def assign(detections: gpd.GeoDataFrame, incidents: gpd.GeoDataFrame, reach_km: float = REACH_KM) -> Assignment:
    """Fire detections of each incident, at most `EARLY_DAYS` before its reported start.

    A cluster goes to the incident whose geometry comes nearest, if within `reach_km`. A cluster that reaches several
    incidents (fires that merged) is divided: each detection goes to the nearest of them. Raises DomainError at a NaN
    position.
    """
    rows = np.flatnonzero(detections["fire"].to_numpy(bool))
    ids = incidents["incident_id"].astype(str).to_list()
    empty = {incident: np.zeros(0, np.int64) for incident in ids}
    lon, lat = positions(detections, "detections")
    if rows.size == 0 or not ids:
        return Assignment(empty, rows)
    lon, lat = lon[rows], lat[rows]
    chosen = detections.iloc[rows]
    points = unit_vectors(lon, lat)
    outline, owner = _incident_points(incidents)
    columns = []
    for k, geometry in enumerate(incidents.geometry):
        distance, _ = cKDTree(outline[owner == k]).query(points)
        columns.append(np.where(contains_xy(geometry, lon, lat), 0.0, distance))
    distances = np.column_stack(columns)
    times = chosen["time"].to_numpy("datetime64[ms]")
    starts = incidents["start"].dt.tz_convert("UTC").dt.tz_localize(None).to_numpy("datetime64[ms]")
    possible = times[:, None] >= starts[None] - np.timedelta64(int(EARLY_DAYS * 86400), "s")
    distances = np.where(possible, distances, np.inf)
    label = clusters(points)
    nearest = np.full((label.max() + 1, len(ids)), np.inf)
    np.minimum.at(nearest, label, distances)
    # Only incidents that the cluster reaches may own its detections.
    reachable = (nearest <= reach_km)[label] & np.isfinite(distances)
    distances = np.where(reachable, distances, np.inf)
    best = distances.argmin(axis=1)
    owned = np.isfinite(distances.min(axis=1))
    return Assignment({incident: rows[owned & (best == k)] for k, incident in enumerate(ids)}, rows[~owned])
