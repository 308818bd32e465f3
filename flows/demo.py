"""``make demo``: build a case, run its cycles through the five services, show what came out."""

from __future__ import annotations

import argparse
import logging
import os
import shutil
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from flows.cases.bundle import Case, read_case
from flows.clock import now_utc
from flows.desk.approval import AwaitingApproval, CycleUnderWay, PeopleDecide
from flows.display import ConsoleDisplay, comparison_table, cycle_table, perimeter_table, planner_table
from flows.loop_types import FEEDBACKS
from flows.prefect_server import running_prefect_server
from flows.profiles import PAPER_DAYS, profile_of
from flows.root import ArtifactRoot, named_root, work_folder
from flows.root_lock import only_run
from flows.runner import Conductor, flow_code_version, open_store
from flows.services import SERVICES, process_environment, running_services, wait_until_ready
from shared.artifacts.store import ArtifactStore
from shared.errors import DomainError, SmokeglintError
from shared.tracing import configure_tracing

if TYPE_CHECKING:
    from flows.case_run import CaseResult

SIMULATED = ("tiny", "demo")
REAL = ("black-2022", *PAPER_DAYS)
LIVE = "live"


@dataclass(frozen=True)
class RunOptions:
    """What is to be run: ``cycles`` 0 is all that the case has, ``plain`` leaves the comparison out."""

    case: str
    root: str
    cycles: int
    cycle_hours: int
    without: tuple[str, ...]
    plain: bool
    services: str
    approve: bool = True
    ephemeral: bool = False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a case from the command line; the exit status is 1 if it could not be run."""
    console = Console(soft_wrap=True)
    try:
        options = _options(arguments)
        with only_run(options.root):
            run_case_here(options, console)
    except (SmokeglintError, TimeoutError) as error:
        console.print(f"[red]{error}[/red]", highlight=False)
        return 1
    return 0


def _options(arguments: Sequence[str] | None) -> RunOptions:
    parser = argparse.ArgumentParser(prog="python -m flows.demo", description="Run two daily cycles of a case.")
    parser.add_argument(
        "--case", default="demo", help=f"{', '.join((*SIMULATED, *REAL, LIVE))}, or a folder with case.toml"
    )
    parser.add_argument("--root", default="artifacts", help="folder for all artifacts, or s3://bucket/prefix")
    parser.add_argument("--cycles", type=int, default=0, help="how many cycles; as the case says if left out")
    parser.add_argument("--cycle-hours", type=int, default=24, choices=(6, 12, 24), help="length of a cycle")
    parser.add_argument("--without", nargs="*", default=[], choices=sorted(FEEDBACKS), help="feedbacks to leave out")
    parser.add_argument(
        "--ephemeral", action="store_true", help="in this one process: no Prefect, services or database"
    )
    parser.add_argument("--plain", action="store_true", help="do not run the last cycle again without feedback")
    parser.add_argument(
        "--services",
        default=os.environ.get("SMOKEGLINT_SERVICES", ""),
        metavar="NAME=URL,...",
        help="use these five running services, whose artifact root must be --root, instead of starting some",
    )
    given = parser.parse_args(arguments)
    return RunOptions(
        given.case,
        named_root(given.root),
        given.cycles,
        given.cycle_hours,
        tuple(given.without),
        given.plain,
        given.services,
        ephemeral=given.ephemeral,
    )


def run_case_here(options: RunOptions, console: Console) -> None:
    """Build the case, start what its steps need (unless they run in this process), run the loop, show it."""
    begun = time.monotonic()
    configure_tracing("flow")
    console.print(f"Smokeglint: case {options.case}, artifacts under {options.root}", highlight=False)
    with _services(options) as urls, nullcontext() if options.ephemeral else running_prefect_server(options.root):
        console.print("Building the case" if options.ephemeral else "Building the case while the services start …")
        case = build_case(options.case, options.root)
        if case.simulated:
            console.print("This case is SIMULATED: orbits and stations are real, nature and measurements are not.")
        wait_until_ready(urls)
        ready_s = time.monotonic() - begun
        display = ConsoleDisplay(console)
        try:
            _show(_loop(options, case, urls, display), options, case, console)
        finally:
            display.close()
    console.print(f"Ready after {ready_s:.0f} s, all done after {time.monotonic() - begun:.0f} s.", highlight=False)


def _services(options: RunOptions) -> AbstractContextManager[dict[str, str]]:
    """The services to use, by URL: those named, some of our own, or none where their processes run in this process."""
    if not options.ephemeral:
        return nullcontext(named_services(options.services)) if options.services else running_services(options.root)
    if options.services:
        raise DomainError("An ephemeral run uses no services.", field="services", value=options.services)
    for name, value in process_environment().items():
        os.environ.setdefault(name, value)
    return nullcontext({})


def _loop(options: RunOptions, case: Case, urls: dict[str, str], display: ConsoleDisplay) -> CaseResult:
    from flows.case_run import run_case

    conductor, store = _conducting(options, case)
    feedback = frozenset(FEEDBACKS) - frozenset(options.without)
    chosen = profile_of(options.case, options.cycle_hours)
    numbers = range(1, (options.cycles or case.cycles) + 1)
    desk = PeopleDecide.of_case(options.root, case.name, automatic=options.approve)
    given = (conductor, case, store, options.root, urls, display, chosen, feedback, numbers)
    now = now_utc() if options.case == LIVE else None  # of a live cycle only what can have happened by now is run
    return run_case(*given, again_plain=not options.plain, desk=desk, now=now)


def _conducting(options: RunOptions, case: Case) -> tuple[Conductor, ArtifactStore]:
    if options.ephemeral:
        from flows.ephemeral import EphemeralConductor, open_whole_store

        return EphemeralConductor(), open_whole_store(options.root, case.folder)
    logging.getLogger("prefect").setLevel(logging.ERROR)
    from flows.cycle import (
        PrefectConductor,  # prefect reads its settings when it is imported: not before the server runs
    )

    return PrefectConductor(), open_store(options.root, case.folder)


def _show(result: CaseResult, options: RunOptions, case: Case, console: Console) -> None:
    if result.stale_runs:
        console.print(f"Closed {result.stale_runs} flow run(s) that an earlier, killed run had left open.")
    if isinstance(result.paused, AwaitingApproval):
        console.print(f"{result.paused} Look at it, decide ('smokeglint approve --help'), and run this again.")
    if isinstance(result.paused, CycleUnderWay):
        console.print(f"{result.paused} Run this again then; its plan is under {options.root}/{case.name}.")
    if not result.cycles:
        return
    console.print()
    console.print(cycle_table(result.cycles, case.title))
    if result.changes:
        console.print(comparison_table(result.changes, result.cycles[-1].label))
    if result.perimeters:
        console.print(perimeter_table(result.perimeters))
    if result.planner_rows:
        console.print(planner_table(result.planner_rows))
    console.print("Look at:")
    for path in result.shown:
        console.print(f"  {path}", highlight=False)


def build_case(name: str, root: ArtifactRoot) -> Case:
    """The case of that name, built under ``.cases`` in the work folder unless this very code has built it already.

    ``live`` is never built here: it is made of what was fetched, bundle by bundle (``flows.cases.live``).
    """
    if name == LIVE:
        from flows.cases.live.bundles import read_live

        return read_live(work_folder(root))
    built = work_folder(root) / ".cases" / f"{name}-{flow_code_version().split('+')[1]}"
    folder = built if name in SIMULATED + REAL else Path(name)
    if name not in SIMULATED + REAL or (folder / "case.toml").exists():
        return read_case(folder)
    shutil.rmtree(folder, ignore_errors=True)
    fresh = folder.with_name(f".{folder.name}")
    shutil.rmtree(fresh, ignore_errors=True)
    if name in SIMULATED:
        from flows.cases.simulated import build_simulated_case

        build_simulated_case(name, fresh)
    elif name in PAPER_DAYS:
        from flows.cases.paper_days.build import build_paper_day

        build_paper_day(name, real_data(), fresh)
    else:
        from flows.cases.black_2022 import build_black_2022

        build_black_2022(real_data(), fresh)
    fresh.rename(folder)
    return read_case(folder)


def named_services(text: str) -> dict[str, str]:
    """The base URL of each service from ``access=http://host:8001,…``; DomainError unless all five are named once."""
    pairs = [pair.partition("=") for pair in text.split(",")]
    urls = {name.strip(): url.strip() for name, _, url in pairs}
    known = len(pairs) == len(urls) and set(urls) == set(SERVICES)
    if not known or not all(url.startswith(("http://", "https://")) for url in urls.values()):
        accepted = ",".join(f"{name}=http://host:port" for name in SERVICES)
        raise DomainError(
            f"'{text}' does not name the five services; it must read {accepted}.",
            field="services",
            value=text,
            accepted=accepted,
        )
    return urls


def real_data() -> Path:
    """The folder of real data; DomainError says how to name it."""
    folder = os.environ.get("SMOKEGLINT_DATA", "")
    if not folder or not Path(folder).is_dir():
        raise DomainError(
            "This case is built from real data: set SMOKEGLINT_DATA to the folder that holds them (see docs/data.md).",
            field="SMOKEGLINT_DATA",
            value=folder or "not set",
            accepted="an existing folder",
        )
    return Path(folder)


if __name__ == "__main__":
    sys.exit(main())
