"""The live case: bundles of what a server that plays the providers gave, and what is said where it gave nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from flows.cases.bundle import Case
from flows.cases.known_at import detections_known_at, incidents_known_at, weather_known_at
from flows.cases.live.build import ages, build_live
from flows.cases.live.bundles import add_bundle, begin, has_bundle, read_live
from flows.cases.live.fires import incidents_of
from flows.commands.__main__ import main
from flows.demo import build_case
from flows.ingest import sources
from shared.errors import MissingArtifactError
from tests.flows.ingest.playing import AREA, NOW, collection, incident, play_all
from tests.flows.ingest.provider import Provider, running_provider


@pytest.fixture(scope="module")
def provider() -> Iterator[Provider]:
    with running_provider() as running:
        yield running


@pytest.fixture
def asked(provider: Provider, monkeypatch: pytest.MonkeyPatch) -> Provider:
    play_all(provider, monkeypatch)
    return provider


@pytest.fixture
def ingested(asked: Provider, tmp_path: Path) -> Path:
    fetched = sources.fetch_all(AREA, tmp_path / "kept", NOW)
    assert not fetched.failed, fetched.said
    assert any(line.startswith("incidents-001000: NIFC WFIGS") for line in fetched.said)
    return tmp_path / "kept"


def test_a_bundle_is_made_of_what_was_fetched(ingested: Path, tmp_path: Path) -> None:
    case = build_live(ingested, tmp_path / "case", AREA, NOW)
    marked = {name for name, origin in case.provenance.items() if origin.simulated}
    assert marked == {"fuels", "smap", "surface"}
    assert case.provenance["receivers"].source == "CelesTrak, data of 2026-07-01 06:00 UTC, 6.2 h old"
    assert len(json.loads(case.path("receivers").read_text())) == 7
    known = incidents_known_at(case, NOW).set_index("incident_id")
    # One is out, one prescribed, one in another state; the last was changed after the cut-off: no area is known of it.
    assert list(known.index) == ["2026-AZ-1", "2026-AZ-4"]
    assert known.area_km2["2026-AZ-1"] == pytest.approx(0.4047, abs=1e-4) and np.isnan(known.area_km2["2026-AZ-4"])
    table = ages(case, NOW + timedelta(hours=1)).set_index("input")
    assert table.age_h["receivers"] == pytest.approx(7.17, abs=0.01) and not table.simulated["incidents"]


def test_detections_of_two_lists_are_told_once_and_none_is_of_the_future(ingested: Path, tmp_path: Path) -> None:
    seen = detections_known_at(build_live(ingested, tmp_path / "case", AREA, NOW), NOW)
    assert list(zip(seen.satellite, seen.time.dt.strftime("%H:%M"), strict=True)) == [
        ("TERRA", "05:45"),
        ("NOAA 20", "09:15"),
        ("NOAA 20", "11:30"),
    ]
    assert seen.confidence.iloc[1:].tolist() == [75.0, 20.0]
    assert seen.along_m.tolist() == [1000.0, 500.0, 500.0] and (seen.delivered_at <= pd.Timestamp(NOW)).all()


def test_the_weather_is_that_of_the_files_hour_by_hour(ingested: Path, tmp_path: Path) -> None:
    case = build_live(ingested, tmp_path / "case", AREA, NOW)
    weather = weather_known_at(case, NOW)
    assert (weather.time.values[0], weather.time.values[-1]) == (
        np.datetime64("2026-07-01T06:00"),
        np.datetime64("2026-07-03T06:00"),
    )
    middle = weather.isel(latitude=2, longitude=2)
    assert middle.temperature_c.values == pytest.approx(26.85 + np.arange(49.0) / 10, abs=0.02)
    assert middle.wind_direction_deg.values == pytest.approx(225.0) and middle.rain_mm.values[1:] == pytest.approx(2.0)
    assert float(middle.wind_speed_m_s[0]) == pytest.approx(np.hypot(3, 3), abs=1e-3)
    with xr.open_dataset(case.path("weather_forecast")) as forecast:
        assert forecast.attrs["simulated"] in (0, False, "False", "false")


def test_older_data_serve_and_are_called_stale(ingested: Path, tmp_path: Path, asked: Provider) -> None:
    for path in list(asked.answers):
        asked.tell(path, b"<html>maintenance</html>")
    later = NOW + timedelta(hours=30)
    fetched = sources.fetch_all(AREA, ingested, later)
    assert fetched.failed and any(line.startswith("receivers: CelesTrak") and "KEPT" in line for line in fetched.said)
    case = build_live(ingested, tmp_path / "case", AREA, later)
    told = {name: origin.source for name, origin in case.provenance.items()}
    assert "STALE, older than 24 h" in told["incidents"] and "STALE, older than 18 h" in told["weather_forecast"]
    assert "STALE" not in told["receivers"] and not case.provenance["weather_forecast"].simulated
    assert len(incidents_known_at(case, later)) == 2


def test_what_is_too_old_or_absent_is_simulated_or_empty_and_said(ingested: Path, tmp_path: Path) -> None:
    much_later = NOW + timedelta(days=40)
    for kept in (ingested, tmp_path / "nothing"):
        case = build_live(kept, tmp_path / f"case-{kept.name}", AREA, much_later)
        origins = case.provenance
        assert all(origins[name].simulated for name in ("receivers", "transmitters", "weather_forecast"))
        assert "no elements of the last 30 days" in origins["receivers"].source
        assert origins["receivers"].oldest.year == 2025 and case.title.endswith(
            ": nothing real: no fires, the rest simulated"
        )
        assert "the table is empty" in origins["incidents"].source and incidents_known_at(case, much_later).empty
        assert detections_known_at(case, much_later).empty
        assert weather_known_at(case, much_later).time.values[-1] > np.datetime64("2026-08-17")


def test_a_bundle_is_frozen_and_the_next_day_has_its_own(ingested: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    with pytest.raises(MissingArtifactError, match="There is no live case here yet"):
        build_case("live", root)
    begin(root, AREA, ingested, NOW)
    first = add_bundle(root, NOW)
    assert has_bundle(root, NOW + timedelta(hours=23)) and not has_bundle(root, NOW + timedelta(hours=25))
    before = {path.name: path.read_bytes() for path in first.folder.iterdir()}
    add_bundle(root, NOW + timedelta(hours=5))
    assert before == {path.name: path.read_bytes() for path in first.folder.iterdir()}
    second = add_bundle(root, NOW + timedelta(hours=50))  # a day was missed: it goes on with the bundle before it
    case = read_live(root)
    assert (case.name, case.cycles, case.first_cutoff) == ("live", 3, NOW)
    assert [path.name for path in case.bundles] == ["20260701T1210Z", "20260701T1210Z", "20260703T1210Z"]
    assert second.folder == case.bundles[2] and build_case("live", root) == case


def test_a_fire_without_place_or_discovery_is_left_out(tmp_path: Path) -> None:
    whole, placeless, timeless = incident("A"), incident("B"), incident("C", FireDiscoveryDateTime=None)
    placeless["geometry"] = None
    path = tmp_path / "incidents.geojson"
    path.write_bytes(collection([whole, placeless, timeless]))
    assert list(incidents_of([path], AREA, NOW).incident_id) == ["A"]
    assert incidents_of(
        [path], AREA, NOW - timedelta(hours=10)
    ).empty  # changed later, and nobody says when it was made


def test_a_fire_that_is_out_does_not_come_back_from_an_older_page(tmp_path: Path) -> None:
    burning, out = incident("A", 10.0), incident("A", 3.0)
    out["properties"]["FireOutDateTime"] = out["properties"]["ModifiedOnDateTime_dt"]
    pages = []
    for name, feature in (("today", out), ("yesterday", burning)):
        pages.append(tmp_path / f"{name}.geojson")
        pages[-1].write_bytes(collection([feature]))
    assert len(incidents_of(pages[1:], AREA, NOW)) == 1
    assert incidents_of(pages, AREA, NOW).empty


def test_the_shell_builds_it_and_says_what_it_is_made_of(
    ingested: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SMOKEGLINT_CLOCK", NOW.isoformat())
    monkeypatch.setenv("COLUMNS", "200")
    chosen = ["--area", ",".join(map(str, AREA)), "--root", str(tmp_path / "root")]
    assert main(["case", "build", "live", *chosen, "--from", str(ingested)]) == 0
    said = capsys.readouterr().out
    assert "real receivers, transmitters, incidents, detections, weather; the rest simulated" in said
    assert "SIMULATED" in said and "CelesTrak, data of 2026-07-01 06:00 UTC" in said


def test_case_is_a_case(ingested: Path, tmp_path: Path) -> None:
    case: Case = build_live(ingested, tmp_path / "a", AREA, NOW)
    again = build_live(ingested, tmp_path / "b", AREA, NOW)
    for path in sorted(case.folder.iterdir()):
        assert path.read_bytes() == (again.folder / path.name).read_bytes(), path.name
