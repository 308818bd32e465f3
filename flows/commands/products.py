"""What a case has made so far, from its manifests: where each cycle stands, and the files for people."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from flows.commands.options import CaseName, Root
from flows.desk.standing import CYCLE, case_folder
from flows.redo import CYCLE_STEPS
from flows.root import store_of
from shared.artifacts.manifest import Manifest

# What every cycle goes through; decisions of people are a step only where there are some.
_EXPECTED = tuple(step for step in CYCLE_STEPS if step != "apply-decisions")
AsJson = Annotated[bool, typer.Option("--json", help="one JSON document, for programs")]


def manifests_of(root: str, case: str) -> list[Manifest]:
    """The finished steps of a case, by its name or the end of it; DomainError if there are none."""
    return list(store_of(root).manifests(case_folder(root, case)))


def status(case: CaseName, root: Root = "artifacts", as_json: AsJson = False) -> None:
    """Where each cycle stands, how old its oldest input is, and what share is simulated."""
    rows = [_standing(cycle, found) for cycle, found in _by_cycle(manifests_of(root, case))]
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    table = Table("cycle (cut-off, UTC)", "steps done", "next", "oldest input", "simulated")
    for row in rows:
        done = f"{row['done']} of {len(_EXPECTED)}"
        table.add_row(
            row["cycle"], done, row["next"] or "–", row["oldest_input"], f"{100 * row['simulated_share']:.0f} %"
        )
    Console().print(table)


def _by_cycle(found: list[Manifest]) -> list[tuple[str, list[Manifest]]]:
    cycles: dict[str, list[Manifest]] = {}
    for manifest in found:
        if re.fullmatch(CYCLE, manifest.cycle):
            cycles.setdefault(manifest.cycle, []).append(manifest)
    return sorted(cycles.items())


def _standing(cycle: str, found: list[Manifest]) -> dict[str, Any]:
    done = {manifest.product.process for manifest in found}
    waiting = [step for step in _EXPECTED if step not in done]
    oldest = sorted(manifest.product.oldest_input for manifest in found if manifest.product.oldest_input)
    return {
        "cycle": cycle,
        "done": len(_EXPECTED) - len(waiting),
        "next": waiting[0] if waiting else "",
        "oldest_input": oldest[0] if oldest else "",
        "simulated_share": max(manifest.product.simulated_share for manifest in found),
    }


def products(
    case: CaseName,
    root: Root = "artifacts",
    cycle: Annotated[str, typer.Option(help="only this cycle, e.g. 20250901T1200Z")] = "",
    kind: Annotated[str, typer.Option(help="only files that end so, e.g. png")] = "",
    as_json: AsJson = False,
) -> None:
    """The files of finished steps, with what they rest on."""
    rows = [
        {
            "cycle": manifest.cycle,
            "step": manifest.product.process,
            "path": f"{manifest.case}/{manifest.cycle}/{manifest.product.process}/{manifest.key}/{name}",
            "bytes": entry.size,
            "simulated": manifest.product_of(name).simulated,
        }
        for manifest in manifests_of(root, case)
        for name, entry in sorted(manifest.files.items())
        if name.endswith(kind) and cycle in ("", manifest.cycle)
    ]
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    for row in rows:
        mark = "SIMULATED" if row["simulated"] else "real"
        print(f"{row['bytes']:>12,} {mark:<9} {row['path']}")
