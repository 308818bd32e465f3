"""How the loop reaches its steps: services over HTTP, the flow's own steps in this process. Both end in the store."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from flows.root import ArtifactRoot, store_of, work_folder
from flows.timings import note_seconds
from shared.artifacts.store import ArtifactStore
from shared.client import ProcessClient
from shared.process import Process, execution
from shared.telemetry import correlation_id
from shared.tracing import span
from shared.versions import code_version

OWNER = "flow"
_FLOWS = Path(__file__).resolve().parent


@dataclass(frozen=True)
class StepEvent:
    """What a display shows of a step: where it stands, and whether the store already had it."""

    cycle: str
    process: str
    percent: float
    message: str
    seconds: float
    done: bool


Display = Callable[[StepEvent], None]


class Runner(Protocol):
    """What the loop needs of whoever runs its steps."""

    def service(self, service: str, process: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Outputs of a service's process."""

    def local(self, process: Process, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Outputs of one of the flow's own steps."""


class Conductor(Protocol):
    """What a case needs of whoever runs its parts."""

    def close_stale_runs(self) -> int:
        """Close what a killed run left open; how many there were."""

    def run(self, name: str, runner: DirectRunner, work: Callable[[Runner], Any]) -> Any:
        """The result of ``work``, run as one part of a case under that name, its steps by way of ``runner``."""


@dataclass
class DirectRunner:
    """Runs each step at once, and remembers the outputs of all of them for the catalogue."""

    urls: Mapping[str, str]
    store: ArtifactStore
    correlation_id: str
    display: Display
    case: str = "adhoc"
    cycle: str = "adhoc"
    made: list[dict[str, Any]] = field(default_factory=list)

    def service(self, service: str, process: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        begun = time.monotonic()

        def progress(percent: float, message: str) -> None:
            self._show(process, percent, message, begun, done=False)

        progress(0, "")
        with self._traced(process), ProcessClient(self.urls[service], correlation_id=self.correlation_id) as client:
            outputs = client.execute(process, self._addressed(inputs), progress=progress)
        return self._finish(process, outputs, begun)

    def local(self, process: Process, inputs: Mapping[str, Any]) -> dict[str, Any]:
        return self.run_here(process, inputs, flow_code_version())

    def run_here(self, process: Process, inputs: Mapping[str, Any], version: str) -> dict[str, Any]:
        """Outputs of a process whose code has this version, run in this very process."""
        begun = time.monotonic()
        self._show(process.id, 0, "", begun, done=False)
        with self._traced(process.id):
            checked = execution.validate_inputs(process, self._addressed(inputs))
            step = execution.resolve_step(process, checked, self.store, version)
            outputs = execution.finished_outputs(step, self.store)
            if outputs is None:
                outputs = execution.run_step(step, self.store, OWNER, step.address.key, lambda *_: None)
        return self._finish(process.id, outputs, begun)

    def _traced(self, process: str) -> AbstractContextManager[None]:
        correlation_id.set(self.correlation_id)
        return span(f"step {process}", case=self.case, cycle=self.cycle, process=process)

    def _addressed(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        given = {name: value for name, value in inputs.items() if value is not None}
        return {**given, "case": self.case, "cycle": self.cycle}

    def _finish(self, process: str, outputs: dict[str, Any], begun: float) -> dict[str, Any]:
        self.made.append(outputs)
        self._note(process, outputs, time.monotonic() - begun)
        self._show(process, 100, "", begun, done=True)
        return outputs

    def _note(self, process: str, outputs: Mapping[str, Any], seconds: float) -> None:
        """Keep how long it took on this machine, under the folder of the step."""
        if step := step_folder(outputs):
            note_seconds(work_folder(self.store.roots.artifact_root), self.case, self.cycle, process, step, seconds)

    def _show(self, process: str, percent: float, message: str, begun: float, *, done: bool) -> None:
        self.display(StepEvent(self.cycle, process, percent, message, time.monotonic() - begun, done))


def step_folder(outputs: Any) -> str:
    """``case/cycle/step/key`` of the first reference among outputs; empty if there is none."""
    if isinstance(outputs, Mapping) and "href" in outputs and "sha256" in outputs:
        return "/".join(str(outputs["href"]).split("/")[-5:-1])
    inner = outputs.values() if isinstance(outputs, Mapping) else outputs if isinstance(outputs, list) else ()
    return next((found for found in map(step_folder, inner) if found), "")


def flow_code_version() -> str:
    """The code version of the flow's own steps."""
    return code_version(_FLOWS, _FLOWS.parent / "shared")


def open_store(root: ArtifactRoot, case_folder: Path) -> ArtifactStore:
    """The artifact store of a run, cleared of what a killed run left half-done.

    The case's own folder may be read as well: it need not lie below the root.
    """
    from flows.steps import LOCAL_STEPS

    store = store_of(root, case_folder)
    store.sweep(OWNER, [process.id for process in LOCAL_STEPS])
    return store
