"""Everything that is fetched for an area, in one go: what came, how old it is, and what did not."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx

from flows.ingest import earthdata, elements, fires, forecasts
from flows.ingest.fetching import ProviderError
from flows.ingest.taking import Source, StaleSourceError, Taken, take

KEYS = ("SMOKEGLINT_SPACE_TRACK", "SMOKEGLINT_FIRMS_KEY", "SMOKEGLINT_EARTHDATA_TOKEN", "SMOKEGLINT_NDVI_URL")
LEAD_HOURS = 48  # a cycle and its overlap, from a run that may be eight hours old at the cut-off
MOST_PAGES = 50
_AGENT = {"User-Agent": "smokeglint (wildfire observation planning)"}
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Row:
    """What became of one source: ``taken`` is None where nobody gave any and nothing kept will do."""

    source: str
    taken: Taken | None
    remarks: str


@dataclass(frozen=True)
class Fetched:
    """What became of every source that was asked."""

    rows: list[Row]
    now: datetime

    @property
    def failed(self) -> bool:
        return any(row.taken is None for row in self.rows)

    @property
    def said(self) -> list[str]:
        """A line for each source."""
        return [self._line(row) for row in self.rows]

    def _line(self, row: Row) -> str:
        if row.taken is None:
            return f"{row.source}: nobody; {row.remarks}"
        age_h = row.taken.age(self.now) / timedelta(hours=1)
        return f"{row.source}: {row.taken.provider}, {age_h:.1f} h old. {row.remarks}".strip()


def fetch_all(area: Box, into: Path, now: datetime, only: str = "", hours: int = LEAD_HOURS) -> Fetched:
    """Fetch every source whose name begins with ``only``, lists of incidents page by page; no failure ends it."""
    rows: list[Row] = []
    with httpx.Client(headers=_AGENT) as client:
        for source in sources(client, now, area, hours):
            if source.name.startswith(only):
                rows.append(_row(source, into, now, client))
                if source.name in fires.LAYERS:
                    rows += _further_pages(rows[-1], into, now, client)
    return Fetched(rows, now)


def _row(source: Source, into: Path, now: datetime, client: httpx.Client) -> Row:
    try:
        taken = take(source, into, now, client)
    except StaleSourceError as error:
        return Row(source.name, None, str(error))
    problems = "; ".join(taken.problems)
    return Row(source.name, taken, problems if taken.fresh else f"KEPT, not fresh; {problems}")


def _further_pages(first: Row, into: Path, now: datetime, client: httpx.Client) -> list[Row]:
    rows: list[Row] = []
    last = first
    while last.taken is not None and fires.more_pages(last.taken.path.read_bytes()) and len(rows) < MOST_PAGES:
        last = _row(fires.wfigs(first.source, fires.PAGE * (len(rows) + 1)), into, now, client)
        rows.append(last)
    return rows


def sources(client: httpx.Client, now: datetime, area: Box, hours: int) -> Iterator[Source]:
    """The sources for an area. Keys come from the environment; a source without its key is left out."""
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


def left_out() -> list[str]:
    """The keys that are not set, so that their sources are not asked."""
    return [name for name in KEYS if not os.environ.get(name)]
