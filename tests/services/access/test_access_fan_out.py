"""The work split by receiver: the same bytes here, over processes, and over a Dask cluster of one worker or two."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from services.access.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.access.staging import stage

TABLES = ("opportunities", "specular_points", "cell_opportunities", "cells", "cell_coverage", "revisit", "report")


def _run(root: Path) -> dict[str, Any]:
    body = stage(root) | {
        "duration_s": 1800,
        "area": None,
        "grid": {"spacing_deg": 2.0, "land_only": True},
        "with_cell_opportunities": True,
    }
    store = ArtifactStore(Roots(str(root)))
    step = resolve_step(PROCESSES[0], validate_inputs(PROCESSES[0], body), store, "test")
    return run_step(step, store, "test", "job", lambda percent, message: None)


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    outputs = _run(tmp_path_factory.mktemp("here"))
    assert outputs["opportunity_count"] > 50 and outputs["cells_covered"] > 20
    return outputs


@contextmanager
def _cluster(workers: int) -> Iterator[str]:
    from distributed import LocalCluster

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as cluster:
            yield f"dask:{cluster.scheduler_address}"


def test_processes_give_the_same_bytes(here: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SMOKEGLINT_FAN_OUT", "processes:2")
    spread = _run(tmp_path)
    assert {name: spread[name]["sha256"] for name in TABLES} == {name: here[name]["sha256"] for name in TABLES}


@pytest.mark.parametrize("workers", [1, 2])
def test_dask_workers_give_the_same_bytes(
    here: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    with _cluster(workers) as address:
        monkeypatch.setenv("SMOKEGLINT_FAN_OUT", address)
        spread = _run(tmp_path)
    assert {name: spread[name]["sha256"] for name in TABLES} == {name: here[name]["sha256"] for name in TABLES}
