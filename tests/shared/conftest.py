"""A toy service behind its real HTTP face, and a targets table for it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import geopandas
import pytest
from fastapi.testclient import TestClient

from shared.contracts import tables
from shared.contracts.schema import write_table
from shared.process.app import create_app
from shared.settings import ServiceSettings

sys.path.insert(0, str(Path(__file__).parent))  # the worker imports toy_processes by name, too


@pytest.fixture
def targets() -> geopandas.GeoDataFrame:
    """Two targets, one of each kind."""
    return geopandas.GeoDataFrame(
        {
            "target_id": [1, 2],
            "kind": ["active", "prefire"],
            "priority": [1.0, 0.25],
            "priority_low": [0.5, 0.1],
            "priority_high": [1.0, 0.5],
            "source": ["incident", "danger"],
        },
        geometry=geopandas.points_from_xy([-107.5, 179.9], [33.2, -12.0]),
        crs="EPSG:4326",
    )


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """An artifact root that holds a targets table at ``case/targets.parquet``."""
    folder = tmp_path / "artifacts"
    folder.mkdir()
    return folder


@pytest.fixture
def targets_file(root: Path, targets: geopandas.GeoDataFrame) -> Path:
    path = root / "case" / "targets.parquet"
    path.parent.mkdir()
    write_table(path, targets, tables.TARGETS)
    return path


@pytest.fixture
def toy(root: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    """The toy service with one real worker process."""
    from toy_processes import PROCESSES

    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    app = create_app("toy", "Toy", PROCESSES, module="toy_processes", settings=ServiceSettings(artifact_root=str(root)))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client
