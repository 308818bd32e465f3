"""CYGNSS level 1 and SMAP soil moisture from NASA's Earthdata: found by the metadata repository, fetched by token.

The search and the download are plain HTTP with the user's Earthdata bearer token, so that they keep to the limits,
retries and checks of every other source.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.parse import urlencode

import httpx

from flows.ingest.fetching import Limits, ProviderError, Request, fetch, text_of
from flows.ingest.taking import Checked, Offer, Source

CMR = "https://cmr.earthdata.nasa.gov"
CYGNSS_L1 = ("CYGNSS_L1_V3.2", timedelta(days=10))
SMAP_L3 = ("SPL3SMP_E", timedelta(days=5))
_HASHES = {"MD5": "md5", "SHA-256": "sha256", "SHA-512": "sha512"}
_NETCDF = (b"\x89HDF\r\n\x1a\n", b"CDF\x01", b"CDF\x02", b"CDF\x05")


@dataclass(frozen=True)
class Granule:
    """A file that the archive offers: its address, the end of its data, and its checksum where one is stated."""

    name: str
    url: str
    end: datetime
    size: int = 0
    algorithm: str = ""
    checksum: str = ""


def find_granules(
    client: httpx.Client, short_name: str, begin: datetime, end: datetime, *, cmr: str = CMR
) -> list[Granule]:
    """Granules of a collection with data between two times, oldest first. ProviderError: no answer that can be used."""
    span = f"{begin:%Y-%m-%dT%H:%M:%SZ},{end:%Y-%m-%dT%H:%M:%SZ}"
    query = {"short_name": short_name, "temporal": span, "page_size": 2000, "sort_key": "start_date"}
    request = Request("Earthdata search", f"{cmr}/search/granules.umm_json?{urlencode(query)}")
    text = text_of(request.provider, fetch(client, request, Limits(max_bytes=50_000_000)))
    try:
        items = json.loads(text)["items"]
        return sorted((_granule(item["umm"]) for item in items), key=lambda granule: granule.end)
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        raise ProviderError(request.provider, f"the list of granules cannot be read: {error!r}") from error


def _granule(umm: dict[str, Any]) -> Granule:
    url = next(link["URL"] for link in umm["RelatedUrls"] if link["Type"] == "GET DATA" and link["URL"][:4] == "http")
    end = datetime.fromisoformat(umm["TemporalExtent"]["RangeDateTime"]["EndingDateTime"].replace("Z", "+00:00"))
    name = url.rsplit("/", 1)[-1]
    stated = umm.get("DataGranule", {}).get("ArchiveAndDistributionInformation", [])
    about = next((item for item in stated if item.get("Name") == name), {})
    checksum = about.get("Checksum", {})
    size = int(about.get("SizeInBytes", 0))
    return Granule(name, url, end.astimezone(UTC), size, checksum.get("Algorithm", ""), checksum.get("Value", ""))


def granule_source(granule: Granule, token: str, stale_after: timedelta) -> Source:
    """The download of a granule, held to its stated size and checksum."""
    request = Request("Earthdata", granule.url, {"Authorization": f"Bearer {token}"})
    name = f"earthdata-{granule.name.rsplit('.', 1)[0]}"
    suffix = "." + granule.name.rsplit(".", 1)[-1]
    limits = Limits(read_s=60.0, total_s=1800.0, max_bytes=3_000_000_000)
    return Source(name, suffix, [Offer(request, lambda content: _check(granule, content))], stale_after, limits)


def _check(granule: Granule, content: bytes) -> Checked:
    provider = "Earthdata"
    if not content.startswith(_NETCDF):
        text_of(provider, content[:2000].decode("utf-8", "replace").encode())  # a login page is called by its name
        raise ProviderError(provider, f"{granule.name} is no netCDF or HDF5 file")
    if granule.size and len(content) != granule.size:
        reason = f"{granule.name} has {len(content)} bytes, {granule.size} are stated"
        raise ProviderError(provider, reason, passing=True)
    algorithm = _HASHES.get(granule.algorithm)
    if algorithm and hashlib.new(algorithm, content).hexdigest() != granule.checksum.lower():
        raise ProviderError(
            provider, f"{granule.name} does not have the stated {granule.algorithm} checksum", passing=True
        )
    return Checked(content, granule.end)
