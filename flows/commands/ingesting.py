"""``smokeglint ingest``: fetch what the providers have now, and say how old everything is."""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import httpx
import typer
from rich.console import Console
from rich.table import Table

from flows.ingest import earthdata, elements, fires, forecasts
from flows.ingest.fetching import ProviderError
from flows.ingest.taking import Source, StaleSourceError, take
from flows.serving.live import now_utc
from shared.errors import DomainError

_AGENT = {"User-Agent": "smokeglint (wildfire observation planning)"}


def ingest(
    area: Annotated[str, typer.Option(help="west,south,east,north in degrees")],
    into: Annotated[Path, typer.Option(help="folder for what is fetched")] = Path("live"),
    only: Annotated[str, typer.Option(help="only sources whose name begins so")] = "",
    hours: Annotated[int, typer.Option(help="lead hours of weather to fetch, every sixth")] = 24,
) -> None:
    """Fetch live inputs. Keys come from the environment; a source without its key is left out and said.

    SMOKEGLINT_SPACE_TRACK (identity:password), SMOKEGLINT_FIRMS_KEY, SMOKEGLINT_EARTHDATA_TOKEN, SMOKEGLINT_NDVI_URL.
    """
    now = now_utc()
    table = Table("source", "from", "data of (UTC)", "age (h)", "remarks")
    failed = False
    with httpx.Client(headers=_AGENT) as client:
        for source in _sources(client, now, _box(area), hours):
            if not source.name.startswith(only):
                continue
            try:
                taken = take(source, into, now, client)
            except StaleSourceError as error:
                failed = True
                table.add_row(source.name, "[red]nobody[/red]", "", "", str(error))
                continue
            age = f"{taken.age(now) / timedelta(hours=1):.1f}"
            remarks = "; ".join(taken.problems) if taken.fresh else "KEPT, not fresh; " + "; ".join(taken.problems)
            table.add_row(source.name, taken.provider, f"{taken.data_time:%Y-%m-%d %H:%M}", age, remarks)
    Console().print(table)
    for name in _left_out():
        print(f"left out without {name}")
    if failed:
        raise typer.Exit(1)


def _sources(
    client: httpx.Client, now: datetime, area: tuple[float, float, float, float], hours: int
) -> Iterator[Source]:
    identity, _, password = os.environ.get("SMOKEGLINT_SPACE_TRACK", "").partition(":")
    login = (identity, password) if password else None
    yield elements.receivers(login)
    yield elements.gps(login)
    yield elements.precise_gps((now - timedelta(days=2)).replace(hour=0, minute=0, second=0, microsecond=0))
    yield fires.wfigs("incidents")
    yield fires.wfigs("perimeters")
    yield fires.hms(now.astimezone(UTC).date())
    if key := os.environ.get("SMOKEGLINT_FIRMS_KEY"):
        yield fires.firms(key, area)
    for lead_h in range(0, hours + 1, 6):
        yield forecasts.hrrr(client, now, lead_h)
    if url := os.environ.get("SMOKEGLINT_NDVI_URL"):
        yield forecasts.ndvi(url, now)
    if token := os.environ.get("SMOKEGLINT_EARTHDATA_TOKEN"):
        yield from _earthdata(client, token, now)


def _earthdata(client: httpx.Client, token: str, now: datetime) -> Iterator[Source]:
    for short_name, stale_after in (earthdata.CYGNSS_L1, earthdata.SMAP_L3):
        try:
            found = earthdata.find_granules(client, short_name, now - stale_after, now)
        except ProviderError as error:
            print(f"{short_name}: {error}")
            continue
        yield from (earthdata.granule_source(granule, token, stale_after) for granule in found)


def _left_out() -> list[str]:
    named = ("SMOKEGLINT_SPACE_TRACK", "SMOKEGLINT_FIRMS_KEY", "SMOKEGLINT_EARTHDATA_TOKEN", "SMOKEGLINT_NDVI_URL")
    return [name for name in named if not os.environ.get(name)]


def _box(text: str) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError as error:
        raise DomainError(f"'{text}' is no box.", field="area", value=text, accepted="west,south,east,north") from error
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise DomainError(
            f"'{text}' is no box.", field="area", value=text, accepted="west < east, south < north, degrees"
        )
    return west, south, east, north
