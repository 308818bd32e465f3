"""``smokeglint latency``: from observation to product to the next plan on board, step by step."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from flows.commands.options import CaseName, Root
from flows.desk.standing import case_folder, newest_steps
from flows.root import ArtifactRoot, read_bytes, work_folder
from flows.timings import step_seconds
from shared.errors import DomainError

REPORT = "latency.json"
# What is computed between the end of a cycle and its products, and between those and the release of the next plan.
PRODUCT_STEPS = (
    "execute", "simulate-observations", "retrieve-burned-area", "retrieve-soil-moisture", "infer-fire-arrival",
)  # fmt: skip
PLAN_STEPS = (
    "assemble-inputs", "forecast-fuel-moisture", "rate-active-fires", "rate-prefire-danger", "build-targets",
    "predict-access", "plan-observations", "check-plan",
)  # fmt: skip
_SHOWN = {
    "observed → downlinked": "observed_to_downlinked_h",
    "downlinked → level 1": "downlinked_to_level1_h",
    "level 1 → product": "level1_to_product_h",
    "observed → product": "observed_to_product_h",
    "observed → next plan on board": "observed_to_next_plan_h",
}


def latency_of(root: ArtifactRoot, case: str) -> list[dict[str, Any]]:
    """The latency report of each executed cycle, oldest first, with the seconds that computing took here.

    DomainError: nothing of the case has been executed yet.
    """
    folder, found = case_folder(root, case), []
    seconds = step_seconds(work_folder(root), folder)
    for cycle, steps in sorted(newest_steps(root, folder).items()):
        if "execute" in steps and REPORT in steps["execute"].files:
            manifest = steps["execute"]
            report = json.loads(read_bytes(root, f"{folder}/{cycle}/execute/{manifest.key}/{REPORT}"))
            found.append({"cycle": cycle, **report, "computing_s": _computing(seconds.get(cycle, {}))})
    if not found:
        raise DomainError(f"No cycle of '{case}' has been executed yet.", field="case", value=case)
    return found


def _computing(took: dict[str, float]) -> dict[str, Any]:
    """Seconds by step; None in all where a step was never timed here (its products came from elsewhere)."""
    told: dict[str, Any] = {
        "steps": {step: round(took[step], 1) for step in (*PLAN_STEPS, *PRODUCT_STEPS) if step in took}
    }
    for name, steps in (("products", PRODUCT_STEPS), ("plan", PLAN_STEPS)):
        known = [took[step] for step in steps if step in took]
        told[name] = round(sum(known), 1) if known else None
    return told


def latency(
    case: CaseName,
    root: Root = "artifacts",
    as_json: Annotated[bool, typer.Option("--json", help="one JSON document, for programs")] = False,
) -> None:
    """How long from observation to product to the next plan on board, step by step (hours: median, 95 %, longest)."""
    reports = latency_of(root, case)
    if as_json:
        print(json.dumps(reports, indent=1))
        return
    console = Console()
    for report in reports:
        table = Table("hours: median / 95 % / longest", *report["modes"], title=f"cycle {report['cycle']}")
        table.add_row("observations", *(f"{mode['observations']:,}" for mode in report["modes"].values()))
        for shown, name in _SHOWN.items():
            table.add_row(shown, *(_spread(mode[name]) for mode in report["modes"].values()))
        table.add_row("products within 30 h", *(_share(mode["share_within_30_h"]) for mode in report["modes"].values()))
        console.print(table)
        took = report["computing_s"]
        console.print(
            f"Computing on this machine: products {took['products']} s, plan {took['plan']} s.", highlight=False
        )


def _spread(hours: dict[str, float | None]) -> str:
    return " / ".join("–" if hours[name] is None else f"{hours[name]:.1f}" for name in ("median", "p95", "longest"))


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.0f} %"
