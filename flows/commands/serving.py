"""``smokeglint serve``: the loop left running."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated

import typer

from flows.clock import now_utc
from flows.commands.options import CaseName, Root
from flows.demo import build_case
from flows.prefect_server import await_prefect, running_prefect_server
from flows.root import named_root
from flows.serving.live import LiveSettings, rate_now, run_due_cycles
from shared.errors import DomainError


def serve(
    case: CaseName,
    root: Root = "artifacts",
    services: Annotated[str, typer.Option(envvar="SMOKEGLINT_SERVICES", help="running ones: name=url,…")] = "",
    wait: Annotated[bool, typer.Option("--wait-for-approval", help="uplink no plan before it is approved")] = False,
    missed: Annotated[str, typer.Option(help="cycles missed while nothing ran: catch-up or skip")] = "catch-up",
    cycle_hours: Annotated[int, typer.Option(help="length of a cycle: 6, 12 or 24")] = 24,
    once: Annotated[bool, typer.Option("--once", help="run what is due now and end: for a cron of your own")] = False,
) -> None:
    """Run what is due, when it is due: the daily cycle after each cut-off, the ratings each hour."""
    if missed not in ("catch-up", "skip"):
        raise DomainError("A missed cycle is caught up or skipped.", field="missed", accepted="catch-up, skip")
    if cycle_hours not in (6, 12, 24):
        raise DomainError("A cycle is 6, 12 or 24 hours.", field="cycle-hours", value=cycle_hours)
    settings = LiveSettings(case, named_root(root), services, not wait, missed, cycle_hours)  # type: ignore[arg-type]
    with _prefect(settings.root):
        if once:
            print(run_due_cycles(settings, now_utc()))
            print(rate_now(settings, now_utc()))
            return
        from flows.serving.deployments import serve_for_ever  # prefect reads its settings when it is imported

        serve_for_ever(settings, build_case(case, settings.root).first_cutoff)


def _prefect(root: str) -> AbstractContextManager[object]:
    """A Prefect server of our own, unless ``PREFECT_API_URL`` names one: that is waited for."""
    if url := os.environ.get("PREFECT_API_URL"):
        await_prefect(url)
        return nullcontext()
    return running_prefect_server(root)
