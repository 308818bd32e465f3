"""Stations, spacecraft and orbital elements that every case shares: facts, not simulated."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime
from pathlib import Path

import geopandas
import pandas as pd

from flows.cases.bundle import Provenance, iso
from shared.contracts import tables
from shared.contracts.schema import write_table
from shared.contracts.spacecraft import Spacecraft

ELEMENTS = Path(__file__).parent / "elements"
ELEMENTS_OLDEST = datetime(2025, 8, 28, 21, 54, 55, tzinfo=UTC)
# CYGNSS ground stations (Swedish Space Corporation): name, latitude, longitude in degrees, height in m.
STATIONS = (
    ("hawaii", 19.0, -155.65, 367.0),
    ("santiago", -33.13, -70.67, 723.0),
    ("dongara", -29.08, 115.58, 250.0),
)
MASK_DEG = 7.0
SPACECRAFT = {
    "storage_images": 60,
    "downlink_s_per_image": 20,
    "battery_capacity_wh": 90.0,
    "battery_min_wh": 60.0,
    "battery_initial_wh": 85.0,
    "generation_w": 40.0,
    "nominal_w": 20.0,
    "collect_w": 15.0,
    "downlink_w": 25.0,
}


def stations_table() -> geopandas.GeoDataFrame | pd.DataFrame:
    """The three ground stations (contract ``stations``)."""
    names = ["station", "latitude_deg", "longitude_deg", "height_m"]
    return pd.DataFrame(STATIONS, columns=names).assign(mask_deg=MASK_DEG, datum="geodetic")


def write_ground_and_spacecraft(folder: Path, horizon_start: datetime, horizon_s: int) -> None:
    """Write ``stations.parquet`` and ``spacecraft.json``."""
    write_table(folder / "stations.parquet", stations_table(), tables.STATIONS)
    document = SPACECRAFT | {"horizon_start": iso(horizon_start), "horizon_s": horizon_s}
    Spacecraft.model_validate(document)
    (folder / "spacecraft.json").write_text(json.dumps(document, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def copy_elements(folder: Path) -> None:
    """Copy the shipped elements of 2025-08-31: ``receivers.json`` (7 CYGNSS) and ``transmitters.json`` (31 GPS)."""
    shutil.copyfile(ELEMENTS / "cygnss_20250831.json", folder / "receivers.json")
    shutil.copyfile(ELEMENTS / "gps_20250831.json", folder / "transmitters.json")


def constellation_provenance(first_cutoff: datetime) -> dict[str, Provenance]:
    """Provenance of the files that this module writes, elements excepted."""
    facts = "published station positions (geodetic, WGS 84), 7 degree mask"
    model = "CYGNSS-like storage, downlink and power figures, as in the planning cases"
    return {
        "stations": Provenance(False, facts, first_cutoff),
        "spacecraft": Provenance(False, model, first_cutoff),
    }
