"""Orbits: OMM elements of CelesTrak and Space-Track, precise GPS orbits of the IGS."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.parse import urlencode

from flows.ingest.fetching import Limits, ProviderError, Request, text_of, unpacked
from flows.ingest.taking import Checked, Offer, Source

CELESTRAK = "https://celestrak.org"
SPACE_TRACK = "https://www.space-track.org"
BKG = "https://igs.bkg.bund.de"
CYGNSS_LAUNCH = "2016-078"  # international designator of the launch of all eight
_NEEDED = ("NORAD_CAT_ID", "EPOCH", "MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "MEAN_ANOMALY", "BSTAR")
_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


def receivers(
    login: tuple[str, str] | None = None, *, celestrak: str = CELESTRAK, space_track: str = SPACE_TRACK
) -> Source:
    """Elements of the CYGNSS satellites; Space-Track second, where a ``login`` (identity, password) is given."""
    query = f"class/gp/OBJECT_ID/{CYGNSS_LAUNCH}~~/orderby/NORAD_CAT_ID/format/json"
    offers = [_celestrak({"INTDES": CYGNSS_LAUNCH}, "cygnss", 6, celestrak)]
    return _elements("receivers", offers, query, login, space_track, 6, timedelta(days=7))


def gps(login: tuple[str, str] | None = None, *, celestrak: str = CELESTRAK, space_track: str = SPACE_TRACK) -> Source:
    """Elements of the operational GPS satellites."""
    query = "class/gp/OBJECT_NAME/NAVSTAR~~/DECAY_DATE/null-val/orderby/NORAD_CAT_ID/format/json"
    offers = [_celestrak({"GROUP": "gps-ops"}, "gps-ops", 24, celestrak)]
    return _elements("transmitters", offers, query, login, space_track, 24, timedelta(days=7))


def _celestrak(selection: dict[str, str], shown: str, least: int, base: str) -> Offer:
    url = f"{base}/NORAD/elements/gp.php?{urlencode({**selection, 'FORMAT': 'json'})}"
    return Offer(Request("CelesTrak", url), lambda content: check_omm("CelesTrak", content, least))


def _elements(
    name: str,
    offers: list[Offer],
    query: str,
    login: tuple[str, str] | None,
    base: str,
    least: int,
    stale_after: timedelta,
) -> Source:
    if login is not None:
        asked = f"{base}/basicspacedata/query/{query}"
        form = {"identity": login[0], "password": login[1], "query": asked}
        request = Request("Space-Track", f"{base}/ajaxauth/login", form=form, shown=asked)
        offers.append(Offer(request, lambda content: check_omm("Space-Track", content, least)))
    return Source(name, ".json", offers, stale_after, Limits(max_bytes=20_000_000))


def check_omm(provider: str, content: bytes, least: int) -> Checked:
    """A list of orbit mean-elements messages of at least so many satellites; as kept: sorted, one a satellite.

    CelesTrak answers 200 with a sentence when a query is wrong or repeated too soon; Space-Track with an object.
    """
    text = text_of(provider, content)
    try:
        found: Any = json.loads(text)
    except ValueError as error:
        raise ProviderError(provider, f"no elements but the words: {' '.join(text.split())[:160]}") from error
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise ProviderError(provider, f"no list of elements: {json.dumps(found)[:160]}")
    newest: dict[int, dict[str, Any]] = {}
    for item in found:
        lacking = [name for name in _NEEDED if item.get(name) in (None, "")]
        if lacking:
            raise ProviderError(provider, f"elements of {item.get('OBJECT_NAME', '?')} lack {', '.join(lacking)}")
        number = int(item["NORAD_CAT_ID"])
        if number not in newest or str(item["EPOCH"]) > str(newest[number]["EPOCH"]):
            newest[number] = item
    if len(newest) < least:
        raise ProviderError(provider, f"elements of {len(newest)} satellites, at least {least} are expected")
    epochs = [_utc(str(item["EPOCH"])) for item in newest.values()]
    kept = json.dumps([newest[number] for number in sorted(newest)], indent=1, sort_keys=True)
    return Checked(kept.encode(), max(epochs))


def precise_gps(day: datetime, *, base: str = BKG) -> Source:
    """GPS orbits of a UTC day: final, else rapid, else ultra-rapid (half of it predicted)."""
    offers = []
    for kind, span in (("FIN", "01D"), ("RAP", "01D"), ("ULT", "02D")):
        name = f"IGS0OPS{kind}_{day:%Y%j}0000_{span}_15M_ORB.SP3.gz"
        week = (day - _GPS_EPOCH).days // 7
        request = Request("IGS at BKG", f"{base}/root_ftp/IGS/products/{week}/{name}")
        offers.append(Offer(request, check_sp3))
    return Source(f"gps-orbits-{day:%Y%j}", ".sp3", offers, timedelta(days=3650), Limits(max_bytes=50_000_000))


def check_sp3(content: bytes) -> Checked:
    """An SP3 file, unpacked, whole to its ``EOF`` line; its time is that of its first epoch."""
    provider = "IGS at BKG"
    text = text_of(provider, unpacked(provider, content, 50_000_000))
    lines: Sequence[str] = text.splitlines()
    if not lines or lines[0][:2] not in ("#a", "#b", "#c", "#d"):
        raise ProviderError(provider, f"no SP3 file: it begins '{lines[0][:20] if lines else ''}'")
    if lines[-1].strip() != "EOF":
        raise ProviderError(provider, "the SP3 file is cut off: no EOF line", passing=True)
    year, month, day, hour, minute = (int(part) for part in lines[0][3:19].split()[:5])
    return Checked(text.encode(), datetime(year, month, day, hour, minute, tzinfo=UTC))


def _utc(text: str) -> datetime:
    moment = datetime.fromisoformat(text.removesuffix("Z"))
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
