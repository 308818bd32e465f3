"""``smokeglint ingest``: fetch what the providers have now, and say how old everything is."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from flows.clock import now_utc
from flows.commands.options import box_of
from flows.ingest.sources import LEAD_HOURS, fetch_all, left_out


def ingest(
    area: Annotated[str, typer.Option(help="west,south,east,north in degrees")],
    into: Annotated[Path, typer.Option(help="folder for what is fetched")] = Path("live"),
    only: Annotated[str, typer.Option(help="only sources whose name begins so")] = "",
    hours: Annotated[int, typer.Option(help="lead hours of weather to fetch, every sixth")] = LEAD_HOURS,
) -> None:
    """Fetch live inputs. Keys come from the environment; a source without its key is left out and said.

    SMOKEGLINT_SPACE_TRACK (identity:password), SMOKEGLINT_FIRMS_KEY, SMOKEGLINT_EARTHDATA_TOKEN, SMOKEGLINT_NDVI_URL.
    """
    fetched = fetch_all(box_of(area), into, now_utc(), only, hours)
    table = Table("source", "from", "data of (UTC)", "age (h)", "remarks")
    for row in fetched.rows:
        if row.taken is None:
            table.add_row(row.source, "[red]nobody[/red]", "", "", row.remarks)
            continue
        age = f"{row.taken.age(fetched.now) / timedelta(hours=1):.1f}"
        table.add_row(row.source, row.taken.provider, f"{row.taken.data_time:%Y-%m-%d %H:%M}", age, row.remarks)
    Console().print(table)
    for name in left_out():
        print(f"left out without {name}")
    if fetched.failed:
        raise typer.Exit(1)
