"""Steps made anew on request: forgetting a finished step is removing its manifest, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

from flows.desk.standing import CYCLE, case_folder
from shared.artifacts.manifest import MANIFEST
from shared.errors import DomainError

# The order in which a cycle runs them.
CYCLE_STEPS = (
    "assemble-inputs",
    "forecast-fuel-moisture",
    "rate-active-fires",
    "rate-prefire-danger",
    "build-targets",
    "apply-decisions",  # only where people decided something
    "predict-access",
    "set-horizon",
    "plan-observations",
    "check-plan",
    "uplink",
    "execute",
    "simulate-observations",
    "retrieve-burned-area",
    "retrieve-soil-moisture",
    "infer-fire-arrival",
    "observed-places",
    "situation",
    "score",
)


def finished_cycles(root: Path, case: str) -> list[str]:
    """The cycles of a case that have finished steps, oldest first: folders named by a cut-off."""
    folders = [path for path in (root / case).iterdir() if re.fullmatch(CYCLE, path.name)]
    return sorted(path.name for path in folders if any(path.glob(f"*/*/{MANIFEST}")))


def forget_from(root: Path, case: str, step: str, cycle: int = 0) -> int:
    """Remove the manifests of a step and of those after it in a cycle (by number; 0: the last); how many there were.

    ``case`` is the name of the case or the end of it (``tiny`` of ``simulated-tiny``). DomainError: no such step or
    cycle.
    """
    if step not in CYCLE_STEPS:
        raise DomainError(f"A cycle has no step '{step}'.", field="from-step", accepted=", ".join(CYCLE_STEPS))
    folder = case_folder(root, case)
    labels = finished_cycles(root, folder)
    if not labels or cycle > len(labels):
        found = ", ".join(labels) or "none"
        raise DomainError(
            f"Case '{case}' has no finished cycle {cycle or ''} under {root}.", field="cycle", value=found
        )
    later = CYCLE_STEPS[CYCLE_STEPS.index(step) :]
    chosen = root / folder / labels[(cycle or len(labels)) - 1]
    manifests = [path for name in later for path in chosen.glob(f"{name}/*/{MANIFEST}")]
    for path in manifests:
        path.unlink()
    return len(manifests)
