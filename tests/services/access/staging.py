"""Input files of a small prediction, staged under an artifact root."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd

from shared.contracts import tables
from shared.contracts.schema import write_table
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS

HOURS = 3
STATION_ROWS = {
    "station": ["hawaii", "santiago", "dongara"],
    "latitude_deg": [19.0, -33.13, -29.08],
    "longitude_deg": [-155.65, -70.67, 115.58],
    "height_m": [367.0, 723.0, 250.0],
    "mask_deg": [7.0, 7.0, 7.0],
    "datum": ["geodetic"] * 3,
}


def lattice() -> geopandas.GeoDataFrame:
    """A lattice over the tropics, dateline included, ids of no order."""
    longitude, latitude = np.meshgrid(np.arange(-180.0, 180.0, 4.0), np.arange(-34.0, 35.0, 4.0))
    count = longitude.size
    return geopandas.GeoDataFrame(
        {
            "target_id": np.random.default_rng(5).permutation(count) + 7_000_000_000,
            "kind": "prefire",
            "priority": 0.1,
        },
        geometry=geopandas.points_from_xy(longitude.ravel(), latitude.ravel()),
        crs="EPSG:4326",
    )


def stage(root: Path) -> dict[str, Any]:
    (root / "in").mkdir(parents=True)
    (root / "in/receivers.tle").write_text(RECEIVERS)
    (root / "in/transmitters.tle").write_text(TRANSMITTERS)
    write_table(root / "in/stations.parquet", pd.DataFrame(STATION_ROWS), tables.STATIONS)
    write_table(root / "in/targets.parquet", lattice(), tables.TARGETS)
    names = ("receivers.tle", "transmitters.tle", "stations.parquet", "targets.parquet")
    return {name.split(".")[0]: {"href": f"in/{name}"} for name in names} | {
        "start": START.isoformat(),
        "duration_s": HOURS * 3600,
        "target_radius_km": 60.0,
        "with_specular_points": True,
        "area": (170.0, -35.0, -120.0, 35.0),
    }
