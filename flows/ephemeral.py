"""The loop in this one process: no Prefect, no services over HTTP, no database, nothing that runs on afterwards.

The services' processes are run where they are asked for, by the same code and under the same keys as in a service, so
a run may begin here and go on with services, or the other way round.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flows.root import ArtifactRoot
from flows.runner import OWNER, DirectRunner, Runner, open_store
from flows.services import SERVICES
from shared.artifacts.store import ArtifactStore
from shared.process import Process
from shared.process.execution import service_code_version
from shared.process.worker import load_processes


class HereRunner:
    """Runs the steps of a service in this process, and leaves the flow's own to another runner."""

    def __init__(self, inner: DirectRunner) -> None:
        self._inner = inner

    def service(self, service: str, process: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        module = _module(service)
        return self._inner.run_here(_processes(service)[process], inputs, service_code_version(module))

    def local(self, process: Process, inputs: Mapping[str, Any]) -> dict[str, Any]:
        return self._inner.local(process, inputs)


class EphemeralConductor:
    """Runs each part of a case by a plain call."""

    def close_stale_runs(self) -> int:
        """None: nobody keeps a record of runs."""
        return 0

    def run(self, name: str, runner: DirectRunner, work: Callable[[Runner], Any]) -> Any:
        return work(HereRunner(runner))


def open_whole_store(root: ArtifactRoot, case_folder: Path) -> ArtifactStore:
    """The artifact store of a run, cleared of what a killed one left half-done, of the services' steps as well."""
    store = open_store(root, case_folder)
    store.sweep(OWNER, [process for service in SERVICES for process in _processes(service)])
    return store


def _processes(service: str) -> dict[str, Process]:
    return load_processes(_module(service), warm=False)


def _module(service: str) -> str:
    return f"services.{service}.processes"
