"""Each provider in its documented format, and in the ways in which it fails."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from flows.ingest import earthdata, elements, fires, forecasts
from flows.ingest.fetching import ProviderError
from flows.ingest.taking import StaleSourceError, take
from tests.flows.ingest.provider import Answer, Provider

NOW = datetime(2026, 7, 1, 12, tzinfo=UTC)
LOGIN_PAGE = b"<!DOCTYPE html><html><body>Please log in</body></html>"


def omm(number: int, epoch: str = "2026-07-01T06:00:00.000000") -> dict[str, Any]:
    shape = {"MEAN_MOTION": 15.19, "ECCENTRICITY": 0.001, "INCLINATION": 34.9, "MEAN_ANOMALY": 10.0, "BSTAR": 1e-4}
    return {"OBJECT_NAME": f"CYGFM0{number % 10}", "NORAD_CAT_ID": 41880 + number, "EPOCH": epoch, **shape}


def elements_of(count: int) -> bytes:
    return json.dumps([omm(number) for number in range(count)]).encode()


# Orbits


def test_elements_come_from_celestrak(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    provider.tell("/NORAD/elements/gp.php", elements_of(7))
    taken = take(elements.receivers(celestrak=provider.url), tmp_path, NOW, client)
    kept = json.loads(taken.path.read_bytes())
    assert (len(kept), taken.data_time) == (7, datetime(2026, 7, 1, 6, tzinfo=UTC))
    assert "INTDES=2016-078" in provider.asked[0][1] and "FORMAT=json" in provider.asked[0][1]


def test_space_track_steps_in_and_its_login_is_not_told(
    tmp_path: Path, client: httpx.Client, provider: Provider
) -> None:
    words = b"GP data has not updated since your last successful download"
    provider.tell("/NORAD/elements/gp.php", Answer(words, 403))
    strings = [{name: str(value) for name, value in omm(number).items()} for number in range(7)]
    provider.tell("/ajaxauth/login", json.dumps(strings).encode())
    login = ("ann@example.org", "pass word")
    taken = take(elements.receivers(login, celestrak=provider.url, space_track=provider.url), tmp_path, NOW, client)
    assert taken.provider == "Space-Track" and "has not updated" in taken.problems[0]
    command, _, _, body = provider.asked[-1]
    assert command == "POST" and b"identity=ann" in body and b"OBJECT_ID%2F2016-078" in body
    assert not any("pass" in path.read_text() for path in tmp_path.rglob("*.json"))


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"No GP data found", "no elements but the words: No GP data found"),
        (elements_of(3), "elements of 3 satellites, at least 6"),
        (json.dumps([{**omm(1), "EPOCH": None}]).encode(), "CYGFM01 lack EPOCH"),
        (b'{"error": "You must be logged in"}', "no list of elements"),
        (LOGIN_PAGE, "web page"),
        ("é".encode("latin-1"), "not UTF-8"),
        (elements_of(7)[:200], "no elements but the words"),
    ],
)
def test_what_is_no_elements_is_called_so(answer: bytes, reason: str) -> None:
    with pytest.raises(ProviderError, match=reason):
        elements.check_omm("CelesTrak", answer, 6)


def test_precise_orbits_are_final_then_rapid(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    day = datetime(2023, 7, 5, tzinfo=UTC)
    sp3 = b"#dP2023  7  5  0  0  0.00000000      96 ORBIT IGS20 HLM  IGS\n" + b"* ...\n" * 50 + b"EOF\n"
    folder = "/root_ftp/IGS/products/2269/IGS0OPS"
    provider.tell(f"{folder}RAP_20231860000_01D_15M_ORB.SP3.gz", gzip.compress(sp3))
    taken = take(elements.precise_gps(day, base=provider.url), tmp_path, NOW, client)
    assert taken.path.read_bytes() == sp3 and taken.data_time == day
    assert "FIN_2023186" in taken.problems[0] and "404" in taken.problems[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"#dP2023  7  5  0  0  0.0\n* ...\n", "no EOF line"),
        (gzip.compress(b"#dP2023\nEOF\n" * 99)[:-9], "cut off"),
        (LOGIN_PAGE, "web page"),
        (b"", "no SP3 file"),
    ],
    ids=["no end line", "cut packing", "login page", "empty"],  # gzip's own bytes hold the second they were packed in
)
def test_what_is_no_orbit_file_is_called_so(content: bytes, reason: str) -> None:
    with pytest.raises(ProviderError, match=reason):
        elements.check_sp3(content)


@pytest.mark.skipif(not os.environ.get("SMOKEGLINT_DATA"), reason="needs SMOKEGLINT_DATA")
def test_a_real_orbit_file_passes() -> None:
    for path in sorted((Path(os.environ["SMOKEGLINT_DATA"]) / "orbits/sp3").glob("*.SP3")):
        assert elements.check_sp3(path.read_bytes()).data_time.hour == 0


# Fires


def features(count: int, **more: Any) -> bytes:
    changed = datetime(2026, 7, 1, 10, tzinfo=UTC).timestamp() * 1000
    point = {"type": "Point", "coordinates": [-110.0, 34.0]}
    one = {"type": "Feature", "geometry": point, "properties": {"ModifiedOnDateTime_dt": changed, "IncidentName": "A"}}
    return json.dumps({"type": "FeatureCollection", "features": [one] * count, **more}).encode()


def test_incidents_come_in_pages(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    path = "/WFIGS_Incident_Locations_Current/FeatureServer/0/query"
    provider.tell(path, features(3, properties={"exceededTransferLimit": True}), features(1))
    first = take(fires.wfigs("incidents", base=provider.url), tmp_path, NOW, client)
    second = take(fires.wfigs("incidents", 1000, base=provider.url), tmp_path, NOW, client)
    assert first.data_time == datetime(2026, 7, 1, 10, tzinfo=UTC)
    assert fires.more_pages(first.path.read_bytes()) and not fires.more_pages(second.path.read_bytes())
    assert "resultOffset=1000" in provider.asked[1][1] and "f=geojson" in provider.asked[1][1]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b'{"error": {"code": 400, "message": "Invalid query"}}', "Invalid query"),
        (features(2)[:-30], "not JSON"),
        (features(0), "no feature says when"),
        (b"[]", "no JSON object"),
        (LOGIN_PAGE, "web page"),
    ],
)
def test_what_is_no_incident_list_is_called_so(content: bytes, reason: str) -> None:
    with pytest.raises(ProviderError, match=reason):
        fires.check_wfigs(content, "ModifiedOnDateTime_dt")


FIRMS = (
    b"latitude,longitude,bright_ti4,scan,track,acq_date,acq_time,satellite,instrument,confidence,version,bright_ti5,frp,daynight\n"
    b"34.10,-110.20,330.1,0.4,0.4,2026-07-01,915,N20,VIIRS,n,2.0NRT,290.1,5.2,D\n"
    b"34.11,-110.21,331.1,0.4,0.4,2026-07-01,6,N20,VIIRS,h,2.0NRT,290.1,6.2,N\n"
)


def test_detections_come_from_the_first_satellite_that_saw_some(
    tmp_path: Path, client: httpx.Client, provider: Provider
) -> None:
    base = "/api/area/csv/KEY42"
    box = "-111,33,-109,35/2"
    provider.tell(f"{base}/VIIRS_NOAA20_NRT/{box}", FIRMS.splitlines(keepends=True)[0])
    provider.tell(f"{base}/VIIRS_NOAA21_NRT/{box}", FIRMS)
    taken = take(fires.firms("KEY42", (-111, 33, -109, 35), base=provider.url), tmp_path, NOW, client)
    assert taken.data_time == datetime(2026, 7, 1, 9, 15, tzinfo=UTC)
    assert taken.problems == ("NASA FIRMS: no detection in this box and time",)
    assert not any("KEY42" in path.read_text() for path in tmp_path.rglob("*.json"))


@pytest.mark.parametrize(
    ("content", "reason", "passing"),
    [
        (b"Invalid MAP_KEY.", "Invalid MAP_KEY", False),
        (b"Exceeding allowed transaction limit.", "transaction limit", True),
        (FIRMS[:-40], "cut off", True),
        (FIRMS.replace(b"2026-07-01", b"2026-13-01"), "time cannot be read", False),
        (LOGIN_PAGE, "web page", True),
    ],
)
def test_what_is_no_detection_list_is_called_so(content: bytes, reason: str, passing: bool) -> None:
    with pytest.raises(ProviderError, match=reason) as caught:
        fires.check_firms(content)
    assert caught.value.passing is passing


HMS = (
    b"       Lon,        Lat,  YearDay,  Time,       Satellite,          Method,  Ecosystem,        FRP\n"
    b"  -110.200,     34.100,  2026182,  0915,       NOAA 20  ,     VIIRS     ,         22,      5.200\n"
)


def test_fire_points_of_yesterday_do_until_todays_come(
    tmp_path: Path, client: httpx.Client, provider: Provider
) -> None:
    path = "/pub/FIRE/web/HMS/Fire_Points/Text/2026/{:02d}/hms_fire2026{:02d}{:02d}.txt"
    provider.tell(path.format(7, 7, 1), HMS.splitlines(keepends=True)[0])
    provider.tell(path.format(6, 6, 30), HMS.replace(b"2026182", b"2026181"))
    taken = take(fires.hms(date(2026, 7, 1), base=provider.url), tmp_path, NOW, client)
    assert taken.data_time == datetime(2026, 6, 30, 9, 15, tzinfo=UTC)
    assert "no fire point yet" in taken.problems[0]
    assert fires.check_hms(HMS).data_time == datetime(2026, 7, 1, 9, 15, tzinfo=UTC)


# Weather and vegetation


def grib(*names: tuple[str, str]) -> tuple[bytes, bytes]:
    """A made-up file of GRIB messages and its index, in the form of NOAA's."""
    body, lines = b"", []
    for number, (name, level) in enumerate(names, start=1):
        lines.append(f"{number}:{len(body)}:d=2026070106:{name}:{level}:12 hour fcst:")
        body += b"GRIB" + bytes([number]) * (10 * number) + b"7777"
    return body, ("\n".join(lines) + "\n").encode()


def test_only_the_fields_that_are_needed_are_fetched(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    body, index = grib(("REFC", "entire atmosphere"), *forecasts.FIELDS, ("GUST", "surface"))
    path = "/hrrr.20260701/conus/hrrr.t06z.wrfsfcf12.grib2"
    provider.tell(path, body)
    provider.tell(path + ".idx", index)
    copies = {"gone": provider.url + "/gone", "here": provider.url}
    taken = take(forecasts.hrrr(client, NOW, 12, copies), tmp_path, NOW, client)
    content = taken.path.read_bytes()
    assert taken.data_time == datetime(2026, 7, 1, 6, tzinfo=UTC) and taken.provider == "here"
    assert content.count(b"GRIB") == len(forecasts.FIELDS) and b"GRIB\x01" not in content and b"GRIB\x07" not in content
    assert b"".join(content.split()) in body


def test_the_run_before_does_where_the_newest_is_not_there(
    tmp_path: Path, client: httpx.Client, provider: Provider
) -> None:
    body, index = grib(*forecasts.FIELDS)
    path = "/hrrr.20260701/conus/hrrr.t00z.wrfsfcf12.grib2"
    provider.tell(path, body)
    provider.tell(path + ".idx", index)
    taken = take(forecasts.hrrr(client, NOW, 12, {"here": provider.url}), tmp_path, NOW, client)
    assert taken.data_time == datetime(2026, 7, 1, 0, tzinfo=UTC) and len(taken.problems) == 1


def test_a_field_or_a_message_that_is_not_whole_is_named(client: httpx.Client, provider: Provider) -> None:
    _, index = grib(*forecasts.FIELDS[:-1])
    with pytest.raises(ProviderError, match="lacks APCP surface"):
        forecasts.ranges("HRRR", index, forecasts.FIELDS)
    with pytest.raises(ProviderError, match="index file is damaged"):
        forecasts.ranges("HRRR", b"1:zero:d=", forecasts.FIELDS)
    provider.tell("/file", b"GRIBxxxx")
    with pytest.raises(ProviderError, match="no whole GRIB message"):
        forecasts._message(client, "HRRR", f"{provider.url}/file", (0, 7))


def geotiff() -> bytes:
    stream = io.BytesIO()
    profile = {"driver": "GTiff", "height": 60, "width": 50, "count": 1, "dtype": "int16", "crs": "EPSG:5070"}
    with rasterio.open(stream, "w", transform=from_origin(0, 0, 375, 375), **profile) as raster:
        raster.write(np.random.default_rng(1).integers(0, 9000, (1, 60, 50)).astype(np.int16))
    return stream.getvalue()


def test_the_newest_composite_there_is_is_taken(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    provider.tell("/ndvi/20260701", LOGIN_PAGE)
    provider.tell("/ndvi/20260629", geotiff())
    source = forecasts.ndvi(provider.url + "/ndvi/{date}", NOW)
    taken = take(source, tmp_path, NOW, client)
    assert taken.data_time == datetime(2026, 6, 29, tzinfo=UTC)
    assert "no TIFF file" in taken.problems[0] and "404" in taken.problems[1]


def test_a_cut_off_composite_is_refused() -> None:
    with pytest.raises(ProviderError, match="damaged or cut off"):
        forecasts.check_geotiff("NDVI", geotiff()[:-2000], NOW)


# Earthdata


def granules(base: str, content: bytes, **changes: Any) -> bytes:
    name = "cyg01.ddmi.s20260629.l1.nc"
    stated = {"Name": name, "SizeInBytes": len(content)}
    stated |= {"Checksum": {"Algorithm": "MD5", "Value": hashlib.md5(content).hexdigest()}} | changes
    umm = {
        "RelatedUrls": [
            {"Type": "VIEW RELATED INFORMATION", "URL": "https://example.org"},
            {"Type": "GET DATA", "URL": f"{base}/{name}"},
        ],
        "TemporalExtent": {"RangeDateTime": {"EndingDateTime": "2026-06-29T23:59:59.999Z"}},
        "DataGranule": {"ArchiveAndDistributionInformation": [stated]},
    }
    return json.dumps({"hits": 1, "items": [{"umm": umm}]}).encode()


NETCDF = b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 4


def find(client: httpx.Client, provider: Provider, **changes: Any) -> earthdata.Granule:
    provider.tell("/search/granules.umm_json", granules(provider.url, NETCDF, **changes))
    short_name, _ = earthdata.CYGNSS_L1
    (found,) = earthdata.find_granules(client, short_name, NOW - timedelta(days=3), NOW, cmr=provider.url)
    return found


def test_a_granule_is_found_and_held_to_its_checksum(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    granule = find(client, provider)
    provider.tell("/cyg01.ddmi.s20260629.l1.nc", NETCDF)
    taken = take(earthdata.granule_source(granule, "secret", earthdata.CYGNSS_L1[1]), tmp_path, NOW, client)
    assert taken.path.read_bytes() == NETCDF and taken.path.suffix == ".nc"
    assert provider.asked[-1][2]["Authorization"] == "Bearer secret"
    assert "short_name=CYGNSS_L1_V3.2" in provider.asked[0][1]
    assert not any("secret" in path.read_text() for path in tmp_path.rglob("*.json"))


@pytest.mark.parametrize(
    ("changes", "content", "reason"),
    [
        ({}, LOGIN_PAGE, "web page"),
        ({}, b"plain words", "no netCDF or HDF5 file"),
        ({}, NETCDF[:-5], "1027 bytes, 1032 are stated"),
        ({}, NETCDF[:-1] + b"x", "does not have the stated MD5 checksum"),
    ],
)
def test_what_is_not_the_granule_is_refused(
    tmp_path: Path,
    client: httpx.Client,
    provider: Provider,
    changes: dict[str, Any],
    content: bytes,
    reason: str,
) -> None:
    granule = find(client, provider, **changes)
    provider.tell("/cyg01.ddmi.s20260629.l1.nc", content)
    with pytest.raises(StaleSourceError, match=reason):
        take(earthdata.granule_source(granule, "secret", timedelta(days=5)), tmp_path, NOW, client)


def test_a_list_that_cannot_be_read_is_called_so(client: httpx.Client, provider: Provider) -> None:
    provider.tell("/search/granules.umm_json", b'{"items": [{"umm": {}}]}')
    with pytest.raises(ProviderError, match="cannot be read"):
        earthdata.find_granules(client, "X", NOW, NOW, cmr=provider.url)
