"""Requests of infer-fire-arrival run as a step in a folder, as the service runs them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd

from services.arrival.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.grids import read_netcdf
from shared.contracts.schema import write_table
from shared.process.execution import resolve_step, run_step, validate_inputs

START = pd.Timestamp("2022-06-01T18:00Z")
QUICK = {"epochs": 15, "ensemble": 2, "formats": []}


def detections_at(
    longitude: Any, latitude: Any, hours: Any, fire: Any = True, confidence: float = 90.0
) -> gpd.GeoDataFrame:
    """Detections (n,) of a VIIRS-like sensor at hours after START."""
    lon, lat = np.atleast_1d(np.asarray(longitude, float)), np.atleast_1d(np.asarray(latitude, float))
    times = START + pd.to_timedelta(np.broadcast_to(np.asarray(hours, float), lon.shape), unit="h")
    burning = np.broadcast_to(np.asarray(fire, bool), lon.shape)
    columns = {
        "time": times.floor("ms"),
        "delivered_at": times.floor("ms") + pd.Timedelta(hours=3),
        "satellite": "SUOMI NPP",
        "instrument": "VIIRS",
        "confidence": np.where(burning, confidence, np.nan),
        "frp_mw": np.where(burning, 10.0, np.nan),
        "fire": burning,
        "along_m": 375.0,
        "across_m": 375.0,
    }
    return gpd.GeoDataFrame(columns, geometry=gpd.points_from_xy(lon, lat), crs="EPSG:4326")


def incident_at(geometry: Any, hours: float = 0.0, incident_id: str = "one") -> gpd.GeoDataFrame:
    start = START + pd.Timedelta(hours=hours)
    columns = {"incident_id": [incident_id], "name": [incident_id], "start": [start], "area_km2": [np.nan]}
    return gpd.GeoDataFrame({**columns, "known_at": [start]}, geometry=[geometry], crs="EPSG:4326")


def perimeters_of(rows: list[tuple[str, float, Any]], known_h: float | None = None) -> gpd.GeoDataFrame:
    """Perimeters table of (incident, hours, geometry)."""
    times = [START + pd.Timedelta(hours=hours) for _, hours, _ in rows]
    known = times if known_h is None else [START + pd.Timedelta(hours=known_h)] * len(rows)
    columns = {"incident_id": [row[0] for row in rows], "time": times, "known_at": known}
    return gpd.GeoDataFrame(columns, geometry=[row[2] for row in rows], crs="EPSG:4326")


def run_request(
    root: Path,
    staged: dict[str, gpd.GeoDataFrame],
    end_h: float = 48.0,
    files: dict[str, Any] | None = None,
    **more: Any,
) -> dict[str, Any]:
    """Outputs of a request with tables staged under their contract's names; `files` are references as they are."""
    (root / "in").mkdir(parents=True, exist_ok=True)
    body: dict[str, Any] = {
        "start": (START - pd.Timedelta(days=4)).isoformat(),
        "end": (START + pd.Timedelta(hours=end_h)).isoformat(),
        **QUICK,
    }
    contracts = {"ignitions": "PERIMETERS"}
    for name, frame in staged.items():
        write_table(root / f"in/{name}.parquet", frame, getattr(tables, contracts.get(name, name.upper())))
        reference = {"href": f"in/{name}.parquet"}
        body[name] = [reference] if name in ("burned_area", "perimeters", "ignitions") else reference
    store = ArtifactStore(Roots(str(root)))
    request = validate_inputs(PROCESSES[0], {**body, **(files or {}), **more})
    return run_step(resolve_step(PROCESSES[0], request, store, "test"), store, "test", "job", lambda *_: None)


def file_of(reference: dict[str, Any]) -> Path:
    return Path(reference["href"].removeprefix("file://"))


def product_of(outputs: dict[str, Any], index: int = 0) -> Any:
    """The netCDF of an incident, times undecoded."""
    return read_netcdf(file_of(outputs["fire_arrival"][index]), decode_times=False)


def report_of(outputs: dict[str, Any]) -> dict[str, Any]:
    return json.loads(file_of(outputs["report"]).read_text())
