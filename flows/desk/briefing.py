"""What an operator is told of a cycle on one page: plan, changes, why a fire is missing, how old everything is."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import pandas as pd

from flows.desk.decisions import Decision, DecisionLog
from flows.desk.standing import PlanStanding, bundle_of, newest_steps, plan_standings
from flows.root import ArtifactRoot, read_bytes
from shared.artifacts.manifest import Manifest
from shared.errors import DomainError

PICTURES = (".png", ".gif")
TILES_FOR_PROGRAMS = "wrfxweb_"
"""Bare map tiles of the wrfxweb manifest, without axes or legend: nothing to look at by themselves."""
FIRST_PICTURES = ("situation", "plan-observations", "rate-prefire-danger", "retrieve-burned-area")
"""Steps whose pictures come first; the situation map stands above all else."""
Steps = Mapping[str, Manifest]


@dataclass(frozen=True)
class Briefing:
    """The facts of one cycle, each from a manifest, a report or a table of a finished step."""

    case: str
    cycle: str
    plan: PlanStanding | None
    numbers: dict[str, str]
    fires: list[dict[str, Any]]
    changes: list[str]
    products: list[dict[str, Any]]
    inputs: list[dict[str, Any]]
    pictures: list[tuple[str, str]]
    decisions: list[str]


def briefing(root: ArtifactRoot, case: str, cycle: str) -> Briefing:
    """The facts of a cycle; DomainError if it has no finished step."""
    cycles = newest_steps(root, case)
    if cycle not in cycles:
        known = ", ".join(sorted(cycles)) or "none"
        raise DomainError(f"Case '{case}' has no cycle '{cycle}'.", field="cycle", value=cycle, accepted=known)
    steps = cycles[cycle]
    earlier = [label for label in sorted(cycles) if label < cycle]
    log = DecisionLog(root, case).all()
    standings = {standing.cycle: standing for standing in plan_standings(root, case, log)}
    return Briefing(
        case,
        cycle,
        standings.get(cycle),
        _numbers(root, steps),
        _fires(root, steps),
        _changes(root, steps, cycles[earlier[-1]] if earlier else {}),
        [_product(manifest) for _, manifest in sorted(steps.items())],
        _inputs(bundle_of(root, case, cycle), cycle),
        _pictures(steps),
        [_decided(decision, steps) for decision in log if decision.holds_in(cycle)],
    )


def known_targets(root: ArtifactRoot, case: str, cycle: str) -> tuple[str, set[int]]:
    """The targets of that cycle by id or, while it has none, of the newest one that has; and which cycle that is."""
    cycles = {label: steps for label, steps in newest_steps(root, case).items() if "build-targets" in steps}
    if not cycles:
        return cycle, set()
    label = cycle if cycle in cycles else max(cycles)
    last = "apply-decisions" if "apply-decisions" in cycles[label] else "build-targets"
    table = _read_table(root, cycles[label], last, "targets.parquet")
    return label, set() if table is None else set(table["target_id"].astype(int))


def _decided(decision: Decision, steps: Steps) -> str:
    """One decision in a line, and whether its target is none of this cycle's."""
    lacking = steps["apply-decisions"].outputs.get("without_target", ()) if "apply-decisions" in steps else ()
    missed = decision.target_id is not None and decision.target_id in {change["target_id"] for change in lacking}
    told = f"{decision.at:%Y-%m-%d %H:%M} {decision.who}: {decision.action} {decision.target_id or ''} ({decision.why})"
    return f"{told}: no such target in this cycle" if missed else told


def _pictures(steps: Steps) -> list[tuple[str, str]]:
    """(title, path) of everything that a person can look at: maps before moving pictures, in order of use."""
    order = {step: rank for rank, step in enumerate(FIRST_PICTURES)}
    found = [
        ((name.endswith(".gif"), order.get(step, len(order)), step, name), manifest)
        for step, manifest in steps.items()
        for name in manifest.files
        if name.endswith(PICTURES) and not name.startswith(TILES_FOR_PROGRAMS)
    ]
    return [
        (f"{step}: {PurePath(name).stem.replace('_', ' ')}", _path(manifest, name))
        for (*_, step, name), manifest in sorted(found, key=lambda pair: pair[0])
    ]


def _path(manifest: Manifest, name: str) -> str:
    return f"{manifest.case}/{manifest.cycle}/{manifest.product.process}/{manifest.key}/{name}"


def _read_json(root: ArtifactRoot, steps: Steps, step: str) -> dict[str, Any]:
    if step not in steps:
        return {}
    document: dict[str, Any] = json.loads(read_bytes(root, _path(steps[step], "report.json")))
    return document


def _read_table(root: ArtifactRoot, steps: Steps, step: str, name: str) -> pd.DataFrame | None:
    if step not in steps or name not in steps[step].files:
        return None
    return pd.read_parquet(io.BytesIO(read_bytes(root, _path(steps[step], name))))


def _numbers(root: ArtifactRoot, steps: Steps) -> dict[str, str]:
    plan = _read_json(root, steps, "plan-observations")
    if not plan:
        return {}
    kinds = plan["targets"]
    told = {f"{kind} targets planned": f"{row['planned']} of {row['total']}" for kind, row in kinds.items()}
    told["reward"] = f"{plan['objective']:.1f} of at most {plan['bound']:.1f} (gap {100 * plan['gap']:.2f} %)"
    told["images"] = str(plan["images_planned"])
    if "execute" in steps:
        done = steps["execute"].outputs
        told["executed"] = f"{done['collected']} recorded, {done['downlinked']} down, {done['lost']} lost"
        told |= _latency(root, steps["execute"])
    return told


def _latency(root: ArtifactRoot, executed: Manifest) -> dict[str, str]:
    """From observation to product, in hours of the cycle's time; empty for cycles that an older release executed."""
    if "latency.json" not in executed.files:
        return {}
    modes = json.loads(read_bytes(root, _path(executed, "latency.json")))["modes"]
    spreads = {mode: row["observed_to_product_h"] for mode, row in modes.items() if row["observations"]}
    return {
        f"observation to product, {mode}": f"median {hours['median']} h, longest {hours['longest']} h"
        for mode, hours in spreads.items()
    }


def _fires(root: ArtifactRoot, steps: Steps) -> list[dict[str, Any]]:
    """For each fire: why it ranks where it does, how many of its targets are planned, and why the others are not."""
    outcomes = _read_table(root, steps, "plan-observations", "target_outcomes.parquet")
    targets = _read_table(root, steps, "build-targets", "targets.parquet")
    listed = _read_json(root, steps, "build-targets").get("fires", [])
    if outcomes is None or targets is None:
        return [
            {"name": fire["name"], "why": fire["reason"], "changed": "", "planned": "", "missing": []}
            for fire in listed
        ]
    joined = targets.merge(outcomes, on="target_id", how="left", suffixes=("", "_outcome"))
    return [_fire(fire, joined[joined["source"] == f"incident:{fire['incident_id']}"]) for fire in listed]


def _fire(fire: Mapping[str, Any], own: pd.DataFrame) -> dict[str, Any]:
    planned = own["observed"].fillna(False).astype(bool)
    reasons = own.loc[~planned, "reason"].fillna("not known to the plan").value_counts()
    missing = [f"{count}: {reason}" for reason, count in reasons.items()]
    changed = str(fire.get("changed") or fire.get("change") or "")
    return {
        "name": fire["name"],
        "why": str(fire["reason"]).removesuffix(changed).rstrip(),  # the report's sentence ends with it
        "changed": changed,
        "planned": f"{int(planned.sum())} of {len(own)}",
        "missing": missing,
    }


def _changes(root: ArtifactRoot, steps: Steps, before: Steps) -> list[str]:
    """What is different from the cycle before: targets come, gone and re-weighted; commands kept, dropped, added."""
    now, then = (_read_table(root, found, "build-targets", "targets.parquet") for found in (steps, before))
    if now is None or then is None:
        return ["This is the first cycle: there is nothing to compare it with."]
    told = []
    for kind in ("active", "prefire"):
        new, old = (frame[frame["kind"] == kind].set_index("target_id")["priority"] for frame in (now, then))
        both = new.index.intersection(old.index)
        moved = int(((new[both] - old[both]).abs() > 0.01).sum())
        counts = f"{len(new.index.difference(old.index))} new, {len(old.index.difference(new.index))} gone"
        told.append(f"{kind} targets: {counts}, {moved} re-weighted by more than 0.01")
    commands = _read_json(root, steps, "plan-observations").get("previous_plan", {}).get("changes", {})
    for change in ("kept", "dropped", "added"):
        if change in commands:
            seconds = commands[change]
            told.append(f"commands {change}: {seconds['collect_s']} s recording, {seconds['downlink_s']} s downlink")
    told += [f"dropped because {reason}: {s} s" for reason, s in commands.get("dropped_because", {}).items()]
    return told


def _product(manifest: Manifest) -> dict[str, Any]:
    product = manifest.product
    return {
        "step": product.process,
        "oldest_input": product.oldest_input,
        "age_h": _age_h(product.oldest_input, manifest.cycle),
        "simulated": f"{100 * product.simulated_share:.0f} %" if product.simulated else "no",
        "code": product.code_version,
        "files": [(name, _path(manifest, name)) for name in sorted(manifest.files)],
    }


def _inputs(bundle: Manifest | None, cycle: str) -> list[dict[str, Any]]:
    """Where each input of the cycle came from; ``poor`` where no provider gave it in time, or none at all."""
    entries = bundle.files if bundle else {}
    return [
        {
            "name": PurePath(name).stem,
            "simulated": "yes" if entry.simulated else "no",
            "oldest_input": entry.oldest_input or "",
            "age_h": _age_h(entry.oldest_input or "", cycle),
            "source": entry.source,
            "poor": "STALE" in entry.source or entry.source.startswith("none"),
        }
        for name, entry in sorted(entries.items())
        if entry.source
    ]


def _age_h(oldest: str, cycle: str) -> str:
    if not oldest:
        return ""
    at = pd.to_datetime(cycle, format="%Y%m%dT%H%MZ", utc=True)
    return f"{(at - pd.Timestamp(oldest)) / pd.Timedelta(hours=1):.0f}"
