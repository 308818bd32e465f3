"""The worker process: warm, spawned, one job at a time, speaking JSON lines over a pipe with its service."""

from __future__ import annotations

import importlib
import json
import os
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts.limits import InputLimits
from shared.lifeline import end_with_parent
from shared.memory import give_back_freed_memory
from shared.process import execution
from shared.process.declaration import Process
from shared.process.problem import problem_of
from shared.telemetry import configure_logging, correlation_id, logger


@dataclass(frozen=True)
class WorkerSettings:
    """What a worker process is told: its service, the module of its processes, where and how much it may read."""

    service: str
    module: str
    roots: Roots
    limits: InputLimits
    log_level: str


def worker_main(connection: Connection, settings: WorkerSettings) -> None:
    """Serve jobs until the service closes the pipe or goes away."""
    end_with_parent(os.getppid())
    configure_logging(f"{settings.service}-worker", settings.log_level)
    processes = load_processes(settings.module)
    store = ArtifactStore(settings.roots)
    version = execution.service_code_version(settings.module)
    _send(connection, {"event": "ready"})
    while True:
        try:
            request = json.loads(connection.recv_bytes())
        except EOFError:
            return
        correlation_id.set(request["correlation_id"])
        _send(connection, _run(connection, processes[request["process"]], request, store, version, settings))
        give_back_freed_memory()


def load_processes(module: str, *, warm: bool = True) -> dict[str, Process]:
    """The processes that a module declares in its list ``PROCESSES``, by id.

    With ``warm`` the modules named in its ``WARM_MODULES`` are imported as well: the first job does not pay for them.
    """
    declared = importlib.import_module(module)
    for name in getattr(declared, "WARM_MODULES", ()) if warm else ():
        importlib.import_module(name)
    return {process.id: process for process in declared.PROCESSES}


def _run(
    connection: Connection,
    process: Process,
    request: dict[str, Any],
    store: ArtifactStore,
    version: str,
    settings: WorkerSettings,
) -> dict[str, Any]:
    def report(percent: float, message: str) -> None:
        _send(connection, {"event": "progress", "percent": percent, "message": message})

    try:
        inputs = execution.validate_inputs(process, request["inputs"])
        step = execution.resolve_step(process, inputs, store, version)
        outputs = execution.finished_outputs(step, store)
        if outputs is None:
            outputs = execution.run_step(step, store, settings.service, request["job"], report, settings.limits)
        return {"event": "done", "outputs": outputs, "facts": execution.facts(step, store)}
    except Exception as error:
        found = problem_of(error)
        if found["status"] >= 500:  # a fault of ours, whose text the client does not see
            logger().error("job failed", process=process.id, job=request["job"], trace=traceback.format_exc())
        return {"event": "failed", "problem": found}


def _send(connection: Connection, message: dict[str, Any]) -> None:
    connection.send_bytes(json.dumps(message).encode())
