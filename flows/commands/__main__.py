"""``python -m flows.commands`` is the command ``smokeglint``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer
from rich.console import Console

from flows.commands import cases, deciding, ingesting, keeping, keys, latency, products, running, serving
from shared.errors import SmokeglintError

app = typer.Typer(
    name="smokeglint",
    help="Plan what satellites record over wildfires, and map what they saw.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("run")(running.run)
app.command("serve")(serving.serve)
app.command("status")(products.status)
app.command("products")(products.products)
app.command("latency")(latency.latency)
app.command("ingest")(ingesting.ingest)
app.command("backup")(keeping.backup)
app.command("restore")(keeping.restore_root)
app.command("approve")(deciding.approve)
app.command("plans")(deciding.plans)
app.command("decisions")(deciding.decisions)
app.add_typer(deciding.target_app, name="target")
app.add_typer(cases.app, name="case")
app.add_typer(keys.app, name="key")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; an error that we know is told in a line, with the exit status 1."""
    try:
        ended = app(args=arguments, standalone_mode=False)
    except (SmokeglintError, TimeoutError) as error:
        Console(stderr=True).print(f"[red]{error}[/red]", highlight=False, soft_wrap=True)
        return 1
    except typer.Abort:
        return 1
    except Exception as error:
        if hasattr(error, "show") and hasattr(error, "exit_code"):  # click's own: a wrong option, an unknown command
            error.show()
            return int(error.exit_code)
        raise
    return ended if isinstance(ended, int) else 0


if __name__ == "__main__":
    sys.exit(main())
