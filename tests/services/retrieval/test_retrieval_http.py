"""Bad input over HTTP: a problem document that names field, value and cure; never a traceback, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import netCDF4
import pytest
from fastapi.testclient import TestClient

from services.retrieval.processes import PROCESSES
from services.retrieval.raw_if.recording import HEADER, write_recording
from services.retrieval.simulation.observations import simulate_nominal
from shared.process.app import create_app
from shared.settings import ServiceSettings
from tests.services.retrieval import small_world
from tests.services.retrieval.raw_if.test_retrieval_raw_if import HEAD, _samples

Edit = Callable[[Path], None]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, Path]]:
    root = tmp_path_factory.mktemp("http")
    app = create_app("retrieval", "Retrieval", PROCESSES, settings=ServiceSettings(artifact_root=str(root)))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client, root


def _maps(root: Path, edit: Edit) -> dict[str, Any]:
    start = small_world.SPLIT_MS
    simulate_nominal(small_world.points(start, start + 10_000_000), small_world.surface(), 3).write(root / "n.nc", {})
    edit(root / "n.nc")
    return {"observations": [{"href": "n.nc"}]}


def _recording(root: Path, edit: Edit, **given: Any) -> dict[str, Any]:
    write_recording(root / "raw.bin", HEAD, _samples(4, 0.12, 400.25, 1730.0))
    edit(root / "raw.bin")
    return {"recording": {"href": "raw.bin"}, "prn": 7, "doppler_hz": 1700.0, "search_hz": 250.0, **given}


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def _swap(path: Path) -> None:
    with netCDF4.Dataset(path, "a") as file:
        file.renameVariable("power_analog", "kept")
        file.createVariable("power_analog", "f4", ("sample", "ddm", "doppler", "delay"))


def _magic(path: Path) -> None:
    path.write_bytes(b"DRT9" + path.read_bytes()[4:])


def _silence(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: HEADER.size] + bytes(path.stat().st_size - HEADER.size))


@pytest.mark.parametrize(
    ("process", "body", "words"),
    [
        ("retrieve-burned-area", lambda root: _maps(root, _cut), ("observations", "n.nc")),
        ("retrieve-burned-area", lambda root: _maps(root, _swap), ("power_analog", "swapped")),
        (
            "retrieve-soil-moisture",
            lambda root: {**_maps(root, _cut), "reference": {"href": "n.nc"}},
            ("observations",),
        ),
        ("compute-ddm", lambda root: _recording(root, _magic), ("recording.magic", "DRT0")),
        ("compute-ddm", lambda root: _recording(root, _silence), ("recording", "lost packets")),
        ("compute-ddm", lambda root: _recording(root, lambda path: None, prn=77), ("prn", "32")),
    ],
)
def test_bad_input_is_answered_with_a_problem_document(
    service: tuple[TestClient, Path], process: str, body: Callable[[Path], dict[str, Any]], words: tuple[str, ...]
) -> None:
    client, root = service
    answer = client.post(f"/processes/{process}/execution", json={"inputs": body(root)})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"].startswith("application/problem+json")
    for word in words:
        assert word in answer.text
    assert str(root) not in answer.text and "Traceback" not in answer.text
    assert not list(root.rglob("manifest.json"))
