"""GMAT's run through the whole process: OEM file in, contacts and eclipses tables out."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from services.access.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.access.truth import GMAT_STATIONS, gmat_oem, gmat_rows

START = datetime(2025, 12, 16, 6, 39, 56, tzinfo=UTC)  # the first whole second of the track
HOURS = 12


@pytest.fixture(scope="module")
def outputs(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    root = tmp_path_factory.mktemp("gmat")
    (root / "track.oem").write_text(gmat_oem(real_data / "events/gmat_cygfm01"))
    (root / "gps.json").write_text((real_data / "orbits/omm_20250831/gps.json").read_text())
    rows = [(s.name, s.latitude_deg, s.longitude_deg, s.height_m, s.mask_deg, s.datum) for s in GMAT_STATIONS]
    columns = ["station", "latitude_deg", "longitude_deg", "height_m", "mask_deg", "datum"]
    frame = pd.DataFrame(rows, columns=columns).astype(dict.fromkeys(columns[1:5], float))
    write_table(root / "stations.parquet", frame, tables.STATIONS)
    names = {"receivers": "track.oem", "transmitters": "gps.json", "stations": "stations.parquet"}
    request = {name: {"href": file} for name, file in names.items()} | {
        "start": START.isoformat(),
        "duration_s": HOURS * 3600 - 60,
        "step_s": 60,
        "max_element_age_days": 365,
    }
    store = ArtifactStore(Roots(str(root)))
    step = resolve_step(PROCESSES[0], validate_inputs(PROCESSES[0], request), store, "test")
    return run_step(step, store, "test", "job", lambda percent, message: None)


def _edges(table: pd.DataFrame) -> np.ndarray:
    return np.stack([(table[edge] - START).dt.total_seconds() for edge in ("start", "end")], axis=1)


def test_contacts_written_agree_with_gmat(outputs: dict[str, Any], real_data: Path) -> None:
    found = read_table(outputs["contacts"]["href"].removeprefix("file://"), tables.CONTACTS)
    folder = real_data / "events/gmat_cygfm01"
    for station, contacts in found.groupby("station"):
        expected = gmat_rows(folder / f"ContactLocator{station}.txt", START)
        assert np.abs(_edges(contacts) - np.array([row[:2] for row in expected])).max() < 0.02
    assert found["station"].value_counts().to_dict() == {"4": 5, "5": 2, "1": 2}


def test_eclipses_written_agree_with_gmat(outputs: dict[str, Any], real_data: Path) -> None:
    found = read_table(outputs["eclipses"]["href"].removeprefix("file://"), tables.ECLIPSES)
    expected = gmat_rows(real_data / "events/gmat_cygfm01/EclipseLocator1.txt", START)
    assert list(found["kind"]) == [row[2].split()[2].lower() for row in expected]
    assert np.abs(_edges(found) - np.array([row[:2] for row in expected])).max() < 0.2
