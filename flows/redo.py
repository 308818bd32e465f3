"""Steps made anew on request: forgetting a finished step is removing its manifest, and nothing else."""

from __future__ import annotations

import re

from flows.desk.standing import CYCLE, case_folder
from flows.root import ArtifactRoot, store_of
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


def forget_from(root: ArtifactRoot, case: str, step: str, cycle: int = 0) -> int:
    """Remove the manifests of a step and of those after it in a cycle (by number; 0: the last); how many there were.

    ``case`` is the name of the case or the end of it (``tiny`` of ``simulated-tiny``). DomainError: no such step or
    cycle.
    """
    if step not in CYCLE_STEPS:
        raise DomainError(f"A cycle has no step '{step}'.", field="from-step", accepted=", ".join(CYCLE_STEPS))
    folder = case_folder(root, case)
    store = store_of(root)
    addresses = [address for address in store.addresses(folder) if re.fullmatch(CYCLE, address.cycle)]
    labels = sorted({address.cycle for address in addresses})
    if not labels or cycle > len(labels):
        found = ", ".join(labels) or "none"
        raise DomainError(
            f"Case '{case}' has no finished cycle {cycle or ''} under {root}.", field="cycle", value=found
        )
    later = CYCLE_STEPS[CYCLE_STEPS.index(step) :]
    chosen = labels[(cycle or len(labels)) - 1]
    forgotten = [address for address in addresses if address.cycle == chosen and address.step in later]
    for address in forgotten:
        store.forget(address)
    return len(forgotten)
