"""Only fires that a satellite saw get an arrival map, where a whole country burns."""

from __future__ import annotations

from pathlib import Path

import geopandas
import pandas as pd
import pytest

from flows.steps import SEEN_FIRES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.process import execution

TIME = pd.Timestamp("2025-01-08T12:00Z")


@pytest.mark.parametrize(("count", "expected"), [(3, ["NEAR"]), (2, []), (0, [])])
def test_a_fire_detection_within_fifteen_kilometres_is_asked(tmp_path: Path, count: int, expected: list[str]) -> None:
    names, places = ["NEAR", "FAR"], geopandas.points_from_xy([-118.0, -100.0], [34.0, 35.0])
    told = {"incident_id": names, "name": names, "start": TIME, "area_km2": 1.0, "known_at": TIME}
    incidents = geopandas.GeoDataFrame(told, geometry=places, crs=4326)
    # One 20 km off, one that saw no fire right there, and one 10 km off.
    spots = geopandas.points_from_xy([-118.0, -118.0, -118.0], [34.18, 34.0, 34.09])
    seen = {"time": TIME, "delivered_at": TIME, "satellite": "NOAA 20", "instrument": "VIIRS", "confidence": 90.0}
    seen |= {"frp_mw": 1.0, "fire": [True, False, True], "along_m": 375.0, "across_m": 375.0}
    looks = geopandas.GeoDataFrame(seen, geometry=spots, crs=4326).head(count)
    write_table(tmp_path / "incidents.parquet", incidents, tables.INCIDENTS)
    write_table(tmp_path / "detections.parquet", looks, tables.DETECTIONS)
    store = ArtifactStore(Roots(str(tmp_path / "root"), (str(tmp_path),)))
    given = {name: {"href": str(tmp_path / f"{name}.parquet")} for name in ("incidents", "detections")}
    step = execution.resolve_step(SEEN_FIRES, execution.validate_inputs(SEEN_FIRES, given), store, "test")
    made = execution.run_step(step, store, "test", "job", lambda *_: None)
    kept = read_table(Path(made["incidents"]["href"].removeprefix("file://")), tables.INCIDENTS)
    assert list(kept.incident_id) == expected and made["seen"] + made["unseen"] == 2
