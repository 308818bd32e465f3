"""Targets of both kinds on the one reward scale, with a report that says why."""

from __future__ import annotations

from typing import Any

import geopandas
import numpy as np
import pandas as pd
import xarray as xr

from services.prioritization import reward
from services.prioritization.active_targets import Situation, active_targets
from services.prioritization.expected_front import DETECTION_MEMORY_H, DETECTION_REACH_KM, distance_km
from services.prioritization.lattice import Lattice
from services.prioritization.prefire_targets import prefire_targets
from shared.errors import DomainError

SCALE_NOTE = (
    "r of equation 1: active 0.1..1, pre-fire 0..0.9; with the factor 10 any active target exceeds "
    "any single pre-fire one"
)
COLUMNS = [
    "target_id",
    "kind",
    "priority",
    "priority_low",
    "priority_high",
    "source",
    "staleness",
    "observed_age_h",
    "worth",
    "longitude_deg",
    "latitude_deg",
]


def check_area(area: tuple[float, float, float, float]) -> None:
    """DomainError unless west < east and south < north, in degrees."""
    west, south, east, north = area
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise DomainError(
            f"The area {area} is no box.",
            field="area",
            value=area,
            accepted="west, south, east, north in degrees, ascending",
        )


def build(
    situation: Situation, danger: xr.Dataset, active_lattice: Lattice, prefire_lattice: Lattice
) -> tuple[geopandas.GeoDataFrame, dict[str, Any]]:
    """Targets of the contract (sorted by id) and the report of ``build-targets``."""
    check_area(situation.area)
    active, fires = active_targets(situation, active_lattice)
    prefire, prefire_report = prefire_targets(
        danger,
        active,
        situation.observed,
        situation.area,
        situation.time,
        situation.horizon_h,
        prefire_lattice,
        active_lattice.spacing_km,
    )
    parts = [part.assign(kind=kind) for part, kind in ((active, "active"), (prefire, "prefire")) if len(part)]
    table = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=COLUMNS)
    table = table[COLUMNS].sort_values("target_id").reset_index(drop=True)
    points = geopandas.points_from_xy(table["longitude_deg"].astype(float), table["latitude_deg"].astype(float))
    frame = geopandas.GeoDataFrame(
        table.drop(columns=["longitude_deg", "latitude_deg"]), geometry=points, crs="EPSG:4326"
    )
    unclaimed = _unclaimed_detections(situation)
    late = situation.incidents[situation.incidents["known_at"] > situation.time]
    report = {
        "time": situation.time.isoformat(),
        "scale": SCALE_NOTE,
        "active_targets": len(active),
        "prefire_targets": len(prefire),
        "reward_active_total": float(10 * active["priority"].sum()) if len(active) else 0.0,
        "reward_prefire_total": float(prefire["priority"].sum()) if len(prefire) else 0.0,
        "staleness": {"floor": reward.STALENESS_FLOOR, "hours": reward.STALENESS_H},
        "fires": fires,
        "prefire": prefire_report,
        "recent_detections_far_from_incidents": unclaimed,
        "arrival_maps_without_incident": sorted(set(situation.arrival_maps) - set(situation.incidents["incident_id"])),
        "incidents_not_yet_known": sorted(late["incident_id"]),
    }
    return frame, report


def _unclaimed_detections(situation: Situation) -> int:
    """Fire detections of the last 48 h that no incident claims: unreported fires or noise, for the operator to see."""
    detections = situation.detections
    if detections is None:
        return 0
    recent = detections[detections["fire"] & (detections["delivered_at"] <= situation.time)]
    recent = recent[recent["time"] >= situation.time - pd.Timedelta(hours=DETECTION_MEMORY_H)]
    far = np.ones(len(recent), dtype=bool)
    for geometry in situation.incidents.loc[situation.incidents["known_at"] <= situation.time].geometry:
        places = (recent.geometry.x.to_numpy(), recent.geometry.y.to_numpy())
        far &= distance_km(*places, geometry) > DETECTION_REACH_KM
    return int(far.sum())
