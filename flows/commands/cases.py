"""Cases from the shell."""

from __future__ import annotations

from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table

from flows.commands.options import Root
from flows.demo import REAL, SIMULATED, build_case

app = typer.Typer(help="Case bundles.", no_args_is_help=True)


@app.command("list")
def list_cases() -> None:
    """The cases that can be built."""
    table = Table("case", "kind")
    for name in SIMULATED:
        table.add_row(name, "simulated nature, real orbits")
    for name in REAL:
        table.add_row(name, "real fires (needs SMOKEGLINT_DATA)")
    Console().print(table)


@app.command()
def build(name: str, root: Root = Path("artifacts")) -> None:
    """Build a case, or find it built, and say where it lies."""
    case = build_case(name, root.resolve())
    kind = "SIMULATED" if case.simulated else "real"
    print(f"{case.folder}\n{case.title}: {kind}, {case.cycles} cycles from {case.first_cutoff:%Y-%m-%d %H:%M} UTC")
