"""Cases from the shell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from flows.clock import now_utc
from flows.commands.options import Root, box_of
from flows.demo import LIVE, REAL, SIMULATED, build_case
from flows.root import work_folder

app = typer.Typer(help="Case bundles.", no_args_is_help=True)


@app.command("list")
def list_cases() -> None:
    """The cases that can be built."""
    table = Table("case", "kind")
    for name in SIMULATED:
        table.add_row(name, "simulated nature, real orbits")
    for name in REAL:
        table.add_row(name, "real fires (needs SMOKEGLINT_DATA)")
    table.add_row(LIVE, "what 'smokeglint ingest' fetched, a bundle a day")
    Console().print(table)


@app.command()
def build(
    name: str,
    root: Root = "artifacts",
    area: Annotated[str, typer.Option(help="live: west,south,east,north in degrees; as before if left out")] = "",
    ingested: Annotated[Path, typer.Option("--from", help="live: folder of 'smokeglint ingest'")] = Path("live"),
) -> None:
    """Build a case, or find it built, and say where it lies. Of 'live' the bundle of the cycle that has begun."""
    if name == LIVE:
        _build_live(work_folder(root), area, ingested)
        return
    case = build_case(name, root)
    kind = "SIMULATED" if case.simulated else "real"
    print(f"{case.folder}\n{case.title}: {kind}, {case.cycles} cycles from {case.first_cutoff:%Y-%m-%d %H:%M} UTC")


def _build_live(root: Path, area: str, ingested: Path) -> None:
    from flows.cases.live.build import ages
    from flows.cases.live.bundles import add_bundle, begin
    from flows.root_lock import only_run

    now = now_utc()
    with only_run(root):  # not while a loop takes its inputs from here
        if area:
            begin(root, box_of(area), ingested, now)
        case = add_bundle(root, now)
    print(f"{case.folder}\n{case.title}")
    table = Table("input", "", "age (h)", "source")
    for row in ages(case, now).itertuples():
        table.add_row(row.input, "SIMULATED" if row.simulated else "", f"{row.age_h:.1f}", row.source)
    Console().print(table)
