"""Run a process of the room straight on a store, as its worker would."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from services.retrieval.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.process.execution import resolve_step, run_step, validate_inputs

BY_ID = {process.id: process for process in PROCESSES}


def run(root: Path, process: str, **inputs: Any) -> dict[str, Any]:
    """Outputs of a process over the artifact root ``root``."""
    store = ArtifactStore(Roots(str(root)))
    declared = BY_ID[process]
    step = resolve_step(declared, validate_inputs(declared, inputs), store, "test")
    return run_step(step, store, "test", "job", lambda *_: None)


def local(reference: dict[str, Any]) -> Path:
    """The file behind an output."""
    return Path(reference["href"].removeprefix("file://"))
