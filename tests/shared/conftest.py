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


@pytest.fixture(scope="module")
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


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An artifact root that holds a targets table at ``case/targets.parquet``."""
    folder = tmp_path_factory.mktemp("root") / "artifacts"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def targets_file(root: Path, targets: geopandas.GeoDataFrame) -> Path:
    path = root / "case" / "targets.parquet"
    path.parent.mkdir()
    write_table(path, targets, tables.TARGETS)
    return path


@pytest.fixture(scope="module")
def toy(root: Path) -> Iterator[TestClient]:
    """The toy service with one real worker process, shared by the tests of a module: starting one takes seconds."""
    from toy_processes import PROCESSES

    app = create_app("toy", "Toy", PROCESSES, module="toy_processes", settings=ServiceSettings(artifact_root=str(root)))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client
