"""``smokeglint run``: cycles of a case, whole or from a step on."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from flows.commands.options import CaseName, Root
from flows.demo import RunOptions, run_case_here
from flows.loop_types import FEEDBACKS
from flows.redo import forget_from
from flows.root import named_root
from flows.root_lock import only_run
from shared.errors import DomainError


def run(
    case: CaseName,
    root: Root = "artifacts",
    cycle: Annotated[int, typer.Option(help="run up to this cycle; 0: all that the case has")] = 0,
    from_step: Annotated[str, typer.Option(help="make this step and those after it anew, in the last cycle run")] = "",
    cycle_hours: Annotated[int, typer.Option(help="length of a cycle: 6, 12 or 24")] = 24,
    without: Annotated[list[str], typer.Option(help=f"feedback to leave out: {', '.join(FEEDBACKS)}")] = [],  # noqa: B006
    compare: Annotated[bool, typer.Option("--compare", help="run the last cycle again without feedback")] = False,
    wait: Annotated[
        bool, typer.Option("--wait-for-approval", help="stop before the uplink of a plan that is a draft")
    ] = False,
    ephemeral: Annotated[
        bool,
        typer.Option("--ephemeral", "--without-prefect", help="in this one process: no Prefect, services or database"),
    ] = False,
    services: Annotated[str, typer.Option(envvar="SMOKEGLINT_SERVICES", help="use running ones: name=url,…")] = "",
) -> None:
    """Run the loop. What is finished is answered from the store, so running again costs little."""
    if cycle_hours not in (6, 12, 24):
        raise DomainError("A cycle is 6, 12 or 24 hours.", field="cycle-hours", value=cycle_hours)
    for name in without:
        if name not in FEEDBACKS:
            raise DomainError(f"There is no feedback '{name}'.", field="without", accepted=", ".join(FEEDBACKS))
    named = (case, named_root(root), cycle, cycle_hours, tuple(without))
    options = RunOptions(*named, not compare, services, not wait, ephemeral)
    console = Console(soft_wrap=True)
    with only_run(options.root):
        if from_step:
            forgotten = forget_from(options.root, case, from_step, cycle)
            console.print(f"Forgot {forgotten} finished step(s) from {from_step} on; they are made anew.")
        run_case_here(options, console)
