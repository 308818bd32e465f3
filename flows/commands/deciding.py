"""Decisions from the shell: approve or reject a plan; add, pin, exclude, re-weight or release a target."""

from __future__ import annotations

import getpass
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from flows.commands.options import CaseName, Root
from flows.desk.briefing import known_targets
from flows.desk.decisions import DecisionLog, added_id, keep
from flows.desk.standing import case_folder, plan_standings, undecided_plan

target_app = typer.Typer(help="Targets by hand: they hold from the named cycle on.", no_args_is_help=True)
Why = Annotated[str, typer.Option(help="the reason; kept with the decision")]
Who = Annotated[str, typer.Option(help="who decides", envvar="SMOKEGLINT_OPERATOR")]
Cycle = Annotated[str, typer.Option(help="cut-off of the first cycle it holds for, e.g. 20250902T1200Z")]
Until = Annotated[str, typer.Option(help="cut-off of the last cycle it holds for; empty: until it is released")]


def approve(
    case: CaseName,
    why: Why,
    root: Root = "artifacts",
    cycle: Annotated[str, typer.Option(help="cut-off of the cycle; empty: the newest plan")] = "",
    reject: Annotated[bool, typer.Option("--reject", help="reject it instead")] = False,
    who: Who = "",
) -> None:
    """Approve (or reject) the plan of a cycle as it stands now; a plan made anew needs a new approval."""
    folder = case_folder(root, case)
    plan, action = undecided_plan(root, folder, cycle), "reject" if reject else "approve"
    name = who or getpass.getuser()
    keep(root, folder, action=action, who=name, why=why, cycle=plan.cycle, schedule_sha256=plan.schedule_sha256)
    print(f"{'rejected' if reject else 'approved'} the plan of {plan.cycle} ({plan.schedule_sha256[:12]}) by {name}")


def plans(case: CaseName, root: Root = "artifacts") -> None:
    """Where the plan of each cycle stands, who decided, and when."""
    folder = case_folder(root, case)
    table = Table("cycle", "plan", "state", "history")
    for plan in plan_standings(root, folder, DecisionLog(root, folder).all()):
        history = " → ".join(" ".join(part for part in step if part) for step in plan.history)
        table.add_row(plan.cycle, plan.schedule_sha256[:12], plan.state, history)
    Console().print(table)


def decisions(case: CaseName, root: Root = "artifacts") -> None:
    """Every decision about a case, oldest first."""
    folder = case_folder(root, case)
    for item in DecisionLog(root, folder).all():
        about = item.target_id if item.target_id is not None else item.schedule_sha256[:12] or item.kind
        print(f"{item.at:%Y-%m-%d %H:%M:%S} {item.who}: {item.action} {about} from {item.cycle} - {item.why}")


def _about_target(case: str, root: str, who: str, **decided: Any) -> None:
    folder = case_folder(root, case)
    decision = keep(root, folder, who=who or getpass.getuser(), **decided)
    about = added_id(decision) if decision.action == "add" else decision.target_id
    print(f"{decision.action} of target {about} kept as {decision.id}")
    cycle, known = known_targets(root, folder, decision.cycle)
    if decision.action != "add" and known and about not in known:
        print(f"Cycle {cycle} has no target {about}: this counts only where a later one has.")


@target_app.command()
def add(
    case: CaseName,
    why: Why,
    cycle: Cycle,
    longitude: Annotated[float, typer.Option(help="degrees east")],
    latitude: Annotated[float, typer.Option(help="degrees north")],
    priority: Annotated[float, typer.Option(help="reward: 0.1 to 1 active, 0 to 0.9 pre-fire")],
    kind: Annotated[str, typer.Option(help="active or prefire")] = "active",
    until: Until = "",
    root: Root = "artifacts",
    who: Who = "",
) -> None:
    """Add a target at a place."""
    place = {"longitude_deg": longitude, "latitude_deg": latitude, "kind": kind, "priority": priority}
    _about_target(case, root, who, action="add", why=why, cycle=cycle, until=until, **place)


@target_app.command()
def pin(
    target: int,
    case: CaseName,
    why: Why,
    cycle: Cycle,
    until: Until = "",
    root: Root = "artifacts",
    who: Who = "",
) -> None:
    """Demand that a target is observed."""
    _about_target(case, root, who, action="pin", target_id=target, why=why, cycle=cycle, until=until)


@target_app.command()
def exclude(
    target: int,
    case: CaseName,
    why: Why,
    cycle: Cycle,
    until: Until = "",
    root: Root = "artifacts",
    who: Who = "",
) -> None:
    """Leave a target out."""
    _about_target(case, root, who, action="exclude", target_id=target, why=why, cycle=cycle, until=until)


@target_app.command()
def reweight(
    target: int,
    case: CaseName,
    why: Why,
    cycle: Cycle,
    priority: Annotated[float, typer.Option(help="its new reward of equation 1")],
    until: Until = "",
    root: Root = "artifacts",
    who: Who = "",
) -> None:
    """Give a target another reward."""
    _about_target(
        case, root, who, action="reweight", target_id=target, priority=priority, why=why, cycle=cycle, until=until
    )


@target_app.command()
def release(target: int, case: CaseName, why: Why, cycle: Cycle, root: Root = "artifacts", who: Who = "") -> None:
    """Take back what was decided about a target."""
    _about_target(case, root, who, action="release", target_id=target, why=why, cycle=cycle)
