"""Fires: incidents and perimeters of NIFC WFIGS, detections of NASA FIRMS and NOAA HMS."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, date, datetime, timedelta
from typing import Any
from urllib.parse import urlencode

from flows.ingest.fetching import Limits, ProviderError, Request, text_of
from flows.ingest.taking import Checked, Offer, Source

WFIGS = "https://services3.arcgis.com/T4QMspbfLg3qTGWY/arcgis/rest/services"
FIRMS = "https://firms.modaps.eosdis.nasa.gov"
HMS = "https://satepsanone.nesdis.noaa.gov"
LAYERS = {
    "incidents": ("WFIGS_Incident_Locations_Current", "ModifiedOnDateTime_dt"),
    "perimeters": ("WFIGS_Interagency_Perimeters_Current", "poly_DateCurrent"),
}
PAGE = 1000
_FIRMS_COLUMNS = {"latitude", "longitude", "acq_date", "acq_time", "satellite", "confidence", "frp"}
_HMS_COLUMNS = {"lon", "lat", "yearday", "time", "satellite", "method"}


def wfigs(layer: str, offset: int = 0, *, base: str = WFIGS) -> Source:
    """A page of the current ``incidents`` or ``perimeters``; ``more_pages`` says whether another follows."""
    service, changed = LAYERS[layer]
    query = {
        "where": "1=1",
        "outFields": "*",
        "outSR": "4326",
        "orderByFields": "OBJECTID",
        "resultOffset": offset,
        "resultRecordCount": PAGE,
        "f": "geojson",
    }
    request = Request("NIFC WFIGS", f"{base}/{service}/FeatureServer/0/query?{urlencode(query)}")
    name = f"{layer}-{offset:06d}" if offset else layer
    offer = Offer(request, lambda content: check_wfigs(content, changed))
    return Source(name, ".geojson", [offer], timedelta(hours=24), Limits(max_bytes=200_000_000))


def check_wfigs(content: bytes, changed: str) -> Checked:
    """GeoJSON features; ArcGIS tells its errors with status 200."""
    provider = "NIFC WFIGS"
    document = _json(provider, content)
    if "error" in document:
        raise ProviderError(provider, f"its server says: {json.dumps(document['error'])[:200]}", passing=True)
    if document.get("type") != "FeatureCollection" or not isinstance(document.get("features"), list):
        raise ProviderError(provider, f"no GeoJSON features: {json.dumps(document)[:120]}")
    times = [feature["properties"].get(changed) for feature in document["features"] if feature.get("properties")]
    known = [float(time) for time in times if isinstance(time, int | float)]
    if not known:
        raise ProviderError(provider, f"no feature says when it was changed ({changed})")
    return Checked(content, datetime.fromtimestamp(max(known) / 1000, UTC))


def more_pages(content: bytes) -> bool:
    """Whether the server held features back that a next page would bring."""
    document = json.loads(content)
    return bool(document.get("exceededTransferLimit") or document.get("properties", {}).get("exceededTransferLimit"))


def firms(key: str, area: tuple[float, float, float, float], days: int = 2, *, base: str = FIRMS) -> Source:
    """VIIRS detections of the last 1 to 5 days in a box (west, south, east, north): three satellites in turn."""
    box = ",".join(f"{value:g}" for value in area)
    offers = []
    for product in ("VIIRS_NOAA20_NRT", "VIIRS_NOAA21_NRT", "VIIRS_SNPP_NRT"):
        path = f"{product}/{box}/{days}"
        request = Request("NASA FIRMS", f"{base}/api/area/csv/{key}/{path}", shown=f"{base}/api/area/csv/…/{path}")
        offers.append(Offer(request, check_firms))
    return Source("detections-firms", ".csv", offers, timedelta(hours=12), Limits(max_bytes=100_000_000))


def check_firms(content: bytes) -> Checked:
    """Detections as CSV. An empty list is an answer, but not one that says of when it is: the next offer is asked."""
    provider = "NASA FIRMS"
    rows = _rows(provider, content, _FIRMS_COLUMNS)
    if not rows:
        raise ProviderError(provider, "no detection in this box and time")
    return Checked(content, max(_time(row["acq_date"], row["acq_time"].zfill(4)) for row in rows))


def hms(day: date, *, base: str = HMS) -> Source:
    """The day's fire points of NOAA's Hazard Mapping System, with those of the day before as a second choice."""
    offers = []
    for chosen in (day, day - timedelta(days=1)):
        path = f"pub/FIRE/web/HMS/Fire_Points/Text/{chosen:%Y/%m}/hms_fire{chosen:%Y%m%d}.txt"
        offers.append(Offer(Request("NOAA HMS", f"{base}/{path}"), check_hms))
    return Source("detections-hms", ".csv", offers, timedelta(hours=36), Limits(max_bytes=50_000_000))


def check_hms(content: bytes) -> Checked:
    """Fire points: a comma-separated table with blanks, days as year and day of year, times as HHMM."""
    provider = "NOAA HMS"
    rows = _rows(provider, content, _HMS_COLUMNS)
    if not rows:
        raise ProviderError(provider, "the day has no fire point yet")
    try:
        moments = [datetime.strptime(row["yearday"] + row["time"].zfill(4), "%Y%j%H%M") for row in rows]
    except ValueError as error:
        raise ProviderError(provider, f"a time cannot be read: {error}") from error
    return Checked(content, max(moments).replace(tzinfo=UTC))


def _rows(provider: str, content: bytes, needed: set[str]) -> list[dict[str, str]]:
    """The rows of a CSV file with the columns that it must have, names in lower case, blanks taken off."""
    text = text_of(provider, content)
    table = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text)) if any(row)]
    header = [name.lower() for name in table[0]] if table else []
    if not needed <= set(header):
        words = " ".join(text.split())[:120]
        raise ProviderError(
            provider, f"no table with {', '.join(sorted(needed))}, but: {words}", passing="limit" in words
        )
    broken = next((number for number, row in enumerate(table[1:], start=2) if len(row) != len(header)), None)
    if broken is not None:
        raise ProviderError(provider, f"line {broken} has not {len(header)} columns: the file is cut off", passing=True)
    return [dict(zip(header, row, strict=True)) for row in table[1:]]


def _json(provider: str, content: bytes) -> dict[str, Any]:
    text = text_of(provider, content)
    try:
        document = json.loads(text)
    except ValueError as error:
        raise ProviderError(provider, f"the answer is not JSON (cut off?): {error}", passing=True) from error
    if not isinstance(document, dict):
        raise ProviderError(provider, "the answer is no JSON object")
    return document


def _time(day: str, minute: str) -> datetime:
    try:
        return datetime.strptime(f"{day} {minute}", "%Y-%m-%d %H%M").replace(tzinfo=UTC)
    except ValueError as error:
        raise ProviderError("NASA FIRMS", f"a time cannot be read: {error}") from error
