"""Weather and vegetation: fields of NOAA's HRRR by byte range, NDVI composites of the USGS."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime, timedelta

import httpx

from flows.ingest.fetching import Limits, ProviderError, Request, fetch, text_of
from flows.ingest.taking import Checked, Offer, Source

HRRR_AT = {
    "HRRR at AWS": "https://noaa-hrrr-bdp-pds.s3.amazonaws.com",
    "HRRR at Google": "https://storage.googleapis.com/high-resolution-rapid-refresh",
}
# What the fire weather indices need: name and level as the index file writes them.
FIELDS = (
    ("TMP", "2 m above ground"),
    ("RH", "2 m above ground"),
    ("UGRD", "10 m above ground"),
    ("VGRD", "10 m above ground"),
    ("APCP", "surface"),
)
_LATE = timedelta(hours=2)  # from a run's time to its files


def hrrr(client: httpx.Client, now: datetime, lead_h: int, at: dict[str, str] | None = None) -> Source:
    """The surface fields of a lead hour: of the newest run from the first copy that has it, else of the run before.

    Runs to 48 h start at 00, 06, 12 and 18 UTC.
    """
    newest = (now - _LATE).replace(minute=0, second=0, microsecond=0)
    newest -= timedelta(hours=newest.hour % 6)
    offers = [
        _offer(client, provider, base, run, lead_h)
        for run in (newest, newest - timedelta(hours=6))
        for provider, base in (at or HRRR_AT).items()
    ]
    return Source(f"hrrr-f{lead_h:02d}", ".grib2", offers, timedelta(hours=18), Limits(max_bytes=200_000_000))


def _offer(client: httpx.Client, provider: str, base: str, run: datetime, lead_h: int) -> Offer:
    url = f"{base}/hrrr.{run:%Y%m%d}/conus/hrrr.t{run:%H}z.wrfsfcf{lead_h:02d}.grib2"

    def messages(index: bytes) -> Checked:
        parts = [_message(client, provider, url, span) for span in ranges(provider, index, FIELDS)]
        return Checked(b"".join(parts), run)

    return Offer(Request(provider, url + ".idx"), messages)


def ranges(provider: str, index: bytes, fields: Iterable[tuple[str, str]]) -> list[tuple[int, int | None]]:
    """First and last byte of each field's message (no end: to that of the file). ProviderError names one not there."""
    rows = [line.split(":") for line in text_of(provider, index).splitlines() if line]
    if not rows or any(len(row) < 6 or not row[1].isdigit() for row in rows):
        raise ProviderError(provider, "the index file is damaged", passing=True)
    starts = [int(row[1]) for row in rows]
    found = {(row[3], row[4]): place for place, row in reversed(list(enumerate(rows)))}
    lacking = [" ".join(wanted) for wanted in fields if wanted not in found]
    if lacking:
        raise ProviderError(provider, f"the run lacks {', '.join(lacking)}")
    places = [found[wanted] for wanted in fields]
    return [(starts[place], starts[place + 1] - 1 if place + 1 < len(starts) else None) for place in places]


def _message(client: httpx.Client, provider: str, url: str, span: tuple[int, int | None]) -> bytes:
    """One GRIB message, whole from its first word to its last."""
    wanted = f"bytes={span[0]}-{'' if span[1] is None else span[1]}"
    content = fetch(client, Request(provider, url, {"Range": wanted}))
    if content[:4] != b"GRIB" or content[-4:] != b"7777":
        raise ProviderError(provider, f"bytes {wanted} of {url} are no whole GRIB message")
    return content


def ndvi(url: str, now: datetime) -> Source:
    """The newest NDVI composite as GeoTIFF from the ``url`` that the operator sets, with ``{date}`` for its last day.

    The USGS serves eVIIRS composites behind a login and over web coverage services whose addresses change with the
    collection: there is none to ship. The last seven days are tried, newest first.
    """

    def offer(day: datetime) -> Offer:
        request = Request("NDVI", url.replace("{date}", f"{day:%Y%m%d}"))
        return Offer(request, lambda content: check_geotiff("NDVI", content, day))

    today = now.replace(hour=0, minute=0, second=0, microsecond=0)
    days = [today - timedelta(days=back) for back in range(7)]
    return Source("ndvi", ".tif", [offer(day) for day in days], timedelta(days=21), Limits(max_bytes=2_000_000_000))


def check_geotiff(provider: str, content: bytes, day: datetime) -> Checked:
    """A GeoTIFF whose header and last row can be read; a web page or a cut-off file cannot."""
    import rasterio
    from rasterio.io import MemoryFile
    from rasterio.windows import Window

    if not re.match(rb"II[\x2a\x2b]\x00|MM\x00[\x2a\x2b]", content):
        raise ProviderError(provider, f"no TIFF file: it begins {content[:12]!r}")
    try:
        with MemoryFile(content) as memory, memory.open() as raster:
            raster.read(1, window=Window(0, raster.height - 1, raster.width, 1))
            if raster.crs is None:
                raise ProviderError(provider, "the TIFF file has no coordinate system")
    except rasterio.errors.RasterioError as error:
        raise ProviderError(provider, f"the TIFF file is damaged or cut off: {error}", passing=True) from error
    return Checked(content, day)
