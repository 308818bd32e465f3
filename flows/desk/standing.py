"""Where the plans of a case stand: draft → approved → uplinked → executed → downlinked, with who and when."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flows.desk.decisions import Decision, DecisionLog, verdict_on
from flows.loop_types import BUNDLE
from flows.root import ArtifactRoot, exists, read_bytes, store_of
from shared.artifacts.manifest import Manifest
from shared.errors import DomainError

STATES = ("draft", "rejected", "approved", "uplinked", "executed", "downlinked")
SCHEDULE = "schedule.parquet"
IMPORT = "import-case"  # the step that brings a case's inputs in
CYCLE = r"\d{8}T\d{4}Z"  # the label of a cycle: its cut-off


@dataclass(frozen=True)
class PlanStanding:
    """One plan and what became of it. ``history`` holds (state, who, when); who is empty where nobody acted."""

    cycle: str
    schedule_sha256: str
    history: tuple[tuple[str, str, str], ...]

    @property
    def state(self) -> str:
        return self.history[-1][0]

    @property
    def sent(self) -> bool:
        """Whether it has gone up to the satellites, so that nobody can stop it any more."""
        return self.state in STATES[STATES.index("uplinked") :]


def case_folder(root: ArtifactRoot, case: str) -> str:
    """The folder name of a case, given by its name or the end of it; DomainError if there is none."""
    names = store_of(root).cases() if exists(root) else []
    named = [name for name in names if name == case or name.endswith(f"-{case}")]
    if not named:
        known = ", ".join(names) or "none"
        raise DomainError(
            f"Nothing of case '{case}' is finished under {root}.", field="case", value=case, accepted=known
        )
    return named[0]


def newest_steps(root: ArtifactRoot, case: str) -> dict[str, dict[str, Manifest]]:
    """The newest finished step of each process, by cycle; parts of a case that are no cycle are left out."""
    cycles: dict[str, dict[str, tuple[float, Manifest]]] = {}
    for manifest, written in store_of(root).dated_manifests(case):
        if not re.fullmatch(CYCLE, manifest.cycle):
            continue
        step = manifest.product.process
        known = cycles.setdefault(manifest.cycle, {})
        if step not in known or written > known[step][0]:
            known[step] = (written, manifest)
    return {cycle: {step: manifest for step, (_, manifest) in steps.items()} for cycle, steps in cycles.items()}


def bundle_of(root: ArtifactRoot, case: str, cycle: str) -> Manifest | None:
    """The import of the bundle that a cycle took its inputs from: its own (live), else the case's; None before it."""
    imports = [(m, written) for m, written in store_of(root).dated_manifests(case) if m.product.process == IMPORT]
    for part in (f"{BUNDLE}-{cycle}", BUNDLE):
        own = [(written, manifest) for manifest, written in imports if manifest.cycle == part]
        if own:
            return max(own, key=lambda pair: pair[0])[1]
    return None


def plan_standings(root: ArtifactRoot, case: str, decisions: list[Decision]) -> list[PlanStanding]:
    """The newest plan of each cycle, oldest cycle first, and how far it has come."""
    newest = newest_steps(root, case)
    planned = sorted(cycle for cycle, steps in newest.items() if "plan-observations" in steps)
    return [_standing(root, cycle, newest[cycle], decisions) for cycle in planned]


def undecided_plan(root: ArtifactRoot, case: str, cycle: str = "") -> PlanStanding:
    """The plan of a cycle (left out: the newest) that can still be approved or rejected; DomainError where there is
    none, or where it has gone up to the satellites."""
    plans = plan_standings(root, case, DecisionLog(root, case).all())
    chosen = [plan for plan in plans if cycle in ("", plan.cycle)]
    if not chosen:
        known = ", ".join(plan.cycle for plan in plans) or "none"
        text = f"There is no plan of cycle '{cycle}' in case '{case}'."
        raise DomainError(text, field="cycle", value=cycle, accepted=known)
    plan = chosen[-1]
    if plan.sent:
        text = f"The plan of cycle {plan.cycle} is {plan.state} already: approving or rejecting it comes too late."
        raise DomainError(text, field="cycle", value=plan.cycle, accepted="a cycle whose plan is not uplinked yet")
    return plan


def _standing(root: ArtifactRoot, cycle: str, steps: Mapping[str, Manifest], decisions: list[Decision]) -> PlanStanding:
    digest = steps["plan-observations"].files[SCHEDULE].sha256
    history = [("draft", "", "")]
    verdict = verdict_on(decisions, digest)
    uplink = _of_plan(steps.get("uplink"), digest)
    if uplink is None and verdict is not None:
        state = "rejected" if verdict.action == "reject" else "approved"
        history.append((state, verdict.who, _utc(verdict)))
    if uplink is not None:
        sent = _document(root, uplink, "uplinks.json")
        history.append(("approved", sent["approved_by"], sent["approved_at"]))
        first = min((s["contact_start"] for s in sent["satellites"] if s["contact_start"]), default="")
        history.append(("uplinked", "", first))
        executed = _of_plan(steps.get("execute"), digest)
        if executed is not None:
            history.append(("executed", "", ""))
            if executed.outputs.get("downlinked"):
                history.append(("downlinked", "", ""))
    return PlanStanding(cycle, digest, tuple(history))


def _of_plan(manifest: Manifest | None, digest: str) -> Manifest | None:
    """The step if it worked on that very schedule."""
    return manifest if manifest and any(entry.sha256 == digest for entry in manifest.inputs) else None


def _document(root: ArtifactRoot, manifest: Manifest, name: str) -> dict[str, Any]:
    path = "/".join((manifest.case, manifest.cycle, manifest.product.process, manifest.key, name))
    document: dict[str, Any] = json.loads(read_bytes(root, path))
    return document


def _utc(decision: Decision) -> str:
    return decision.at.isoformat(timespec="seconds")
