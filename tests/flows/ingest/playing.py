"""A server that plays every provider of live inputs: one morning's elements, fires and weather, all fresh at NOW."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any

import httpx
import numpy as np
import pytest

from flows.cases.constellation import ELEMENTS
from flows.ingest import elements, fetching, fires, forecasts, sources
from flows.ingest.taking import Source
from tests.flows.ingest.provider import Provider

NOW = datetime(2026, 7, 1, 12, 10, tzinfo=UTC)
AREA = (-111.0, 33.5, -110.0, 34.5)
LEADS = (0, 6, 12, 18, 24, 30, 36, 42, 48)
INCIDENTS = "/WFIGS_Incident_Locations_Current/FeatureServer/0/query"
FIRMS_HEAD = "latitude,longitude,scan,track,acq_date,acq_time,satellite,confidence,frp\n"


def play_all(provider: Provider, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the server in the place of every provider, with no waiting between tries."""

    def playing(client: httpx.Client, now: datetime, area: Any, hours: int) -> Iterator[Source]:
        yield elements.receivers(celestrak=provider.url)
        yield elements.gps(celestrak=f"{provider.url}/gps")
        yield fires.wfigs("incidents", base=provider.url)
        yield fires.hms(now.date(), base=provider.url)
        yield fires.firms("KEY", area, base=provider.url)
        for lead_h in range(0, hours + 1, 6):
            yield forecasts.hrrr(client, now, lead_h, {"HRRR here": provider.url})

    monkeypatch.setattr(sources, "sources", playing)
    monkeypatch.setattr(fires, "wfigs", partial(fires.wfigs, base=provider.url))
    monkeypatch.setattr(fetching, "_sleep", lambda seconds: None)
    tell_all(provider)


def tell_all(provider: Provider) -> None:
    """Everything fresh at NOW; elements that are really of 2025 get an epoch of the morning."""
    for path, name in (("/NORAD/elements/gp.php", "cygnss"), ("/gps/NORAD/elements/gp.php", "gps")):
        own = json.loads((ELEMENTS / f"{name}_20250831.json").read_text())
        provider.tell(path, json.dumps([{**one, "EPOCH": "2026-07-01T06:00:00.000000"} for one in own]).encode())
    first = [incident("2026-AZ-1", hours_ago=3), incident("2026-AZ-2", hours_ago=2, FireOutDateTime=stamp(1))]
    first.append(incident("2026-AZ-3", hours_ago=4, IncidentTypeCategory="RX"))
    second = [incident("2026-AZ-4", hours_ago=-0.05, CreatedOnDateTime_dt=stamp(5)), incident("2026-NM-5", x=-107.0)]
    provider.tell(INCIDENTS, collection(first, exceededTransferLimit=True), collection(second))
    rows = "34.0,-110.5,0.4,0.5,2026-07-01,0915,N20,n,5.2\n34.1,-110.4,0.4,0.5,2026-07-01,1130,N20,l,6.0\n"
    provider.tell("/api/area/csv/KEY/VIIRS_NOAA20_NRT/-111,33.5,-110,34.5/2", (FIRMS_HEAD + rows).encode())
    head = "Lon, Lat, YearDay, Time, Satellite, Method, Ecosystem, FRP\n"
    hms = "-110.5, 34.0, 2026182, 0915, NOAA 20, VIIRS, 22, 5.2\n"
    hms += "-110.6, 34.2, 2026182, 0545, TERRA, MODIS, 22, 9.0\n"
    provider.tell("/pub/FIRE/web/HMS/Fire_Points/Text/2026/07/hms_fire20260701.txt", (head + hms).encode())
    for lead_h in LEADS:
        body, index = grib(lead_h)
        path = f"/hrrr.20260701/conus/hrrr.t06z.wrfsfcf{lead_h:02d}.grib2"
        provider.tell(path, body)
        provider.tell(path + ".idx", index)


def stamp(hours_ago: float) -> float:
    return (NOW - timedelta(hours=hours_ago)).timestamp() * 1000


def incident(name: str, hours_ago: float = 3.0, x: float = -110.5, **more: Any) -> dict[str, Any]:
    told = {"UniqueFireIdentifier": name, "IncidentName": "some fire", "IncidentSize": 100.0}
    told |= {"FireDiscoveryDateTime": stamp(20), "ModifiedOnDateTime_dt": stamp(hours_ago), **more}
    return {"type": "Feature", "geometry": {"type": "Point", "coordinates": [x, 34.0]}, "properties": told}


def collection(features: list[dict[str, Any]], **properties: Any) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": features, "properties": properties}).encode()


def grib(lead_h: int) -> tuple[bytes, bytes]:
    """GRIB messages of 0.5 degrees: 300 K and 0.1 more each lead hour, wind from the south-west, 2 mm an hour."""
    import eccodes

    kinds = {"TMP:2 m above ground": ("2t", 300.0 + lead_h / 10), "RH:2 m above ground": ("2r", 20.0)}
    kinds |= {"UGRD:10 m above ground": ("10u", 3.0), "VGRD:10 m above ground": ("10v", 3.0)}
    kinds |= {"APCP:surface": ("tp", 2.0 * lead_h)}
    body, lines = b"", []
    for number, (told, (short, value)) in enumerate(kinds.items(), start=1):
        handle = eccodes.codes_grib_new_from_samples("regular_ll_sfc_grib2")
        axes = {
            "Ni": 21,
            "Nj": 21,
            "latitudeOfFirstGridPointInDegrees": 39.0,
            "longitudeOfFirstGridPointInDegrees": 244.0,
        }
        axes |= {"latitudeOfLastGridPointInDegrees": 29.0, "longitudeOfLastGridPointInDegrees": 254.0}
        axes |= {"iDirectionIncrementInDegrees": 0.5, "jDirectionIncrementInDegrees": 0.5}
        when = {"dataDate": 20260701, "dataTime": 600, "forecastTime": lead_h}
        for key, set_to in {"shortName": short, **axes, **when}.items():
            eccodes.codes_set(handle, key, set_to)
        if short == "tp":  # accumulated since the run began, as HRRR gives it
            eccodes.codes_set(handle, "stepRange", f"0-{lead_h}")
        eccodes.codes_set_values(handle, np.full(21 * 21, value))
        lines.append(f"{number}:{len(body)}:d=2026070106:{told}:{lead_h} hour fcst:")
        body += eccodes.codes_get_message(handle)
        eccodes.codes_release(handle)
    return body, ("\n".join(lines) + "\n").encode()
