"""What a run left: its artifacts by hash, and whatever should not be there."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Mapping
from pathlib import Path

import httpx

from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import MANIFEST
from shared.artifacts.roots import Roots
from shared.artifacts.store import STAGING, ArtifactStore

CASE = "simulated-tiny"


def artifacts(root: Path) -> dict[str, str]:
    """sha256 of every file of the case, its catalogue included, by path below the root."""
    files = sorted(path for path in (root / CASE).rglob("*") if path.is_file())
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def steps_in_order(root: Path) -> list[tuple[str, float]]:
    """Each finished step's folder below the root and when its manifest was written, in that order."""
    found = [(path.stat().st_mtime, path) for path in (root / CASE).glob(f"*/*/*/{MANIFEST}")]
    return [(str(path.parent.relative_to(root)), written) for written, path in sorted(found)]


def half_written(root: Path) -> list[str]:
    """Step folders without a manifest that verifies: at any moment, there must be none."""
    store, found = ArtifactStore(Roots(str(root))), []
    for folder in sorted((root / CASE).glob("*/*/*")):
        part = folder.relative_to(root).parts
        if "catalogue" in part or ".catalogue" in part or not folder.is_dir():
            continue
        if store.load(StepAddress(*part)) is None:
            found.append(str(folder.relative_to(root)))
    return found


def staged(root: Path) -> list[str]:
    """Files left in staging."""
    return [str(path.relative_to(root)) for path in (root / STAGING).rglob("*") if path.is_file()]


def open_jobs(urls: Mapping[str, str]) -> list[str]:
    """Jobs that no service has ended."""
    listed = [(name, job) for name, url in urls.items() for job in httpx.get(f"{url}/jobs").json()["jobs"]]
    return [
        f"{name} {job['jobID']} {job['status']}" for name, job in listed if job["status"] in ("accepted", "running")
    ]


def open_flow_runs(api: str) -> int:
    """Flow runs that Prefect believes to be under way."""
    states = {"flow_runs": {"state": {"type": {"any_": ["RUNNING", "PENDING"]}}}}
    return int(httpx.post(f"{api}/flow_runs/count", json=states, timeout=60).raise_for_status().json())


def processes_on(root: Path, patience_s: float = 5.0) -> list[str]:
    """Processes that still work on an artifact root, told by their environment or command line."""
    deadline = time.monotonic() + patience_s
    while (found := _mentioning(str(root).encode())) and time.monotonic() < deadline:
        time.sleep(0.2)
    return found


def _mentioning(mark: bytes) -> list[str]:
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        try:
            command = (process / "cmdline").read_bytes()
            if mark in (process / "environ").read_bytes() or mark in command:
                found.append(command.replace(b"\0", b" ").decode(errors="replace")[:200])
        except OSError:
            continue
    return found
