"""The step ``execute`` as a whole: who counts as flying, though no station sees it."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas
import pandas as pd

from flows.steps import EXECUTE
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import write_table
from shared.process import execution

START = pd.Timestamp("2025-09-01T12:00Z")
SPACECRAFT = {
    "storage_images": 3, "downlink_s_per_image": 4, "battery_capacity_wh": 90.0, "battery_min_wh": 10.0,
    "battery_initial_wh": 85.0, "generation_w": 40.0, "nominal_w": 20.0, "collect_w": 15.0, "downlink_w": 25.0,
    "horizon_start": START.isoformat(), "horizon_s": 7200,
}  # fmt: skip


def test_a_satellite_without_any_contact_is_told_and_flies_on(tmp_path: Path) -> None:
    hour = pd.Timedelta(hours=1)
    contacts = {"satellite": ["CYGFM01"], "station": "hawaii", "start": START + 3 * hour, "end": START + 3.1 * hour}
    frames = {
        "contacts": (pd.DataFrame(contacts | {"max_elevation_deg": 40.0}), tables.CONTACTS),
        "eclipses": (_rows("CYGFM02", start=START, end=START + hour, kind="umbra"), tables.ECLIPSES),
        "specular_points": (_point("CYGFM03"), tables.SPECULAR_POINTS),
        "schedule": (pd.DataFrame(columns=[column.name for column in tables.SCHEDULE.columns]), tables.SCHEDULE),
    }
    for name, (frame, contract) in frames.items():
        write_table(tmp_path / f"{name}.parquet", frame, contract)
    (tmp_path / "spacecraft.json").write_text(json.dumps(SPACECRAFT))
    given = {name: {"href": str(tmp_path / f"{name}.parquet")} for name in frames}
    given |= {"spacecraft": {"href": str(tmp_path / "spacecraft.json")}, "duration_s": 7200}
    store = ArtifactStore(Roots(str(tmp_path / "root"), (str(tmp_path),)))
    step = execution.resolve_step(EXECUTE, execution.validate_inputs(EXECUTE, given), store, "test")
    made = execution.run_step(step, store, "test", "job", lambda *_: None)
    latency, after = (_json(made[name]["href"]) for name in ("latency", "spacecraft"))
    assert latency["satellites_not_reached"] == 2  # one in eclipse, one that saw a point; neither has a contact
    charge = {name: state["battery_initial_wh"] for name, state in after["satellites"].items()}
    assert charge == {"CYGFM01": 90.0, "CYGFM02": 85.0, "CYGFM03": 90.0}  # an hour of shade takes 20 Wh


def _rows(satellite: str, **values: object) -> pd.DataFrame:
    return pd.DataFrame({"satellite": [satellite], **values})


def _point(satellite: str) -> geopandas.GeoDataFrame:
    told = _rows(satellite, transmitter="G07", time=START, incidence_deg=30.0, rx_gain_dbi=12.0)
    told = told.assign(rx_range_m=7e5, tx_range_m=2.2e7)
    return geopandas.GeoDataFrame(told, geometry=geopandas.points_from_xy([-107.0], [33.0]), crs=4326)


def _json(href: str) -> dict[str, dict[str, dict[str, float]]]:
    document: dict[str, dict[str, dict[str, float]]] = json.loads(Path(href.removeprefix("file://")).read_text())
    return document
