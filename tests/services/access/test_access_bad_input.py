"""Bad input of every kind has one clear answer, in the core and over HTTP: field, line or row, and what is right."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pytest
from fastapi.testclient import TestClient

from services.access.orbits.elements import ElementSet
from services.access.orbits.ephemeris import propagate
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from services.access.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.errors import DomainError
from shared.process.app import create_app
from shared.process.execution import resolve_step, run_step, validate_inputs
from shared.settings import ServiceSettings
from tests.services.access.orbit_files import OMM, oem_kvn, omm_kvn, omm_xml, sp3
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS

EXECUTE = "/processes/predict-access/execution"
STATION = {
    "station": ["hawaii"],
    "latitude_deg": [19.0],
    "longitude_deg": [-155.65],
    "height_m": [367.0],
    "mask_deg": [7.0],
    "datum": ["geodetic"],
}
Edit = Callable[[Path], dict[str, Any]]


def _sets(text: str) -> list[ElementSet]:
    return [orbit for orbit in read_orbits(text) if isinstance(orbit, ElementSet)]


def _write_stations(path: Path, **changes: list[Any]) -> None:
    pd.DataFrame({**STATION, **changes}).to_parquet(path)  # unchecked: some tests want it wrong


def _write_targets(path: Path, count: int) -> None:
    longitude = np.linspace(-180.0, 179.0, count)
    frame = {
        "target_id": np.arange(count, dtype=np.int64),
        "kind": ["prefire"] * count,
        "priority": np.full(count, 0.1),
    }
    latitude = np.linspace(-34.0, 34.0, count)
    places = geopandas.points_from_xy(longitude, latitude)
    write_table(path, geopandas.GeoDataFrame(frame, geometry=places, crs="EPSG:4326"), tables.TARGETS)


def _inputs(folder: Path, edit: Edit) -> dict[str, Any]:
    """Good inputs in ``folder``, then what ``edit`` makes of them; its answer changes the request."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "receivers.tle").write_text(RECEIVERS)
    (folder / "transmitters.tle").write_text(TRANSMITTERS)
    _write_stations(folder / "stations.parquet")
    _write_targets(folder / "targets.parquet", 400)
    names = ("receivers.tle", "transmitters.tle", "stations.parquet", "targets.parquet")
    files = {name.split(".")[0]: {"href": (folder / name).as_uri()} for name in names}
    return {**files, "start": START.isoformat(), "duration_s": 1200, "step_s": 10, **edit(folder)}


def _replaced(name: str, text: str, suffix: str = "tle") -> Edit:
    def edit(folder: Path) -> dict[str, Any]:
        path = folder / f"{name}.other.{suffix}"
        path.write_text(text)
        return {name: {"href": path.as_uri()}}

    return edit


def _changed(**changes: Any) -> Edit:
    return lambda folder: changes


def _stations(**changes: list[Any]) -> Edit:
    def edit(folder: Path) -> dict[str, Any]:
        _write_stations(folder / "stations.parquet", **changes)
        return {}

    return edit


def _two_files(folder: Path) -> dict[str, Any]:
    other = _replaced("receivers", omm_xml([OMM]), "xml")(folder)["receivers"]
    return {"receivers": [{"href": (folder / "receivers.tle").as_uri()}, other]}


def _no_targets(folder: Path) -> dict[str, Any]:
    _write_targets(folder / "targets.parquet", 0)
    return {}


def _fleet(document: Any) -> Edit:
    def edit(folder: Path) -> dict[str, Any]:
        (folder / "fleet.json").write_text(json.dumps(document))
        return {"fleet": {"href": (folder / "fleet.json").as_uri()}}

    return edit


def _oem(hours: float, start_s: float = 0.0) -> str:
    """CYGFM05 as an ephemeris in ITRF, a state a minute."""
    begin = START + timedelta(seconds=start_s)
    (orbit,), _ = propagate(_sets(RECEIVERS)[:1], begin, hours * 3600.0, 60.0)
    inertial = orbit.velocity_m_s / 1000.0
    return oem_kvn("CYGFM05", begin, orbit.times_s, orbit.position_m / 1000.0, inertial, REF_FRAME="ITRF2014")


def _sp3(missing: dict[str, range]) -> str:
    """The GPS of the test as SP3 over six hours before and after the start; GPS time is 18 s ahead."""
    begin = START - timedelta(hours=6)
    named, _ = name_transmitters(_sets(TRANSMITTERS), START)
    orbits, _ = propagate([each for each in named if isinstance(each, ElementSet)], begin, 43200.0, 900.0)
    positions = {orbit.name: orbit.position_m / 1000.0 for orbit in orbits}
    return sp3(begin + timedelta(seconds=18), orbits[0].times_s, positions, missing=missing)


def _checksum() -> str:
    lines = RECEIVERS.splitlines()
    lines[4] = lines[4].replace("22337", "22338")
    return "\n".join(lines)


def _decayed(rows: int) -> str:
    """The receivers as OMM, the first ``rows`` marked as decayed."""
    other = {"NORAD_CAT_ID": "41885", "OBJECT_NAME": "CYGFM04", "RA_OF_ASC_NODE": "215.1241"}
    listed = [OMM, {**OMM, **other}]
    return json.dumps([{**row, "DECAYED": "1" if number < rows else "0"} for number, row in enumerate(listed)])


REFUSED: dict[str, tuple[Edit, str, str]] = {
    "checksum": (_replaced("receivers", _checksum()), "receivers", "line 5: checksum"),
    "cut line": (_replaced("receivers", RECEIVERS[:-30]), "receivers", "line 6"),
    "no orbits": (_replaced("receivers", "\n"), "receivers", "holds no element sets"),
    "other text": (_replaced("transmitters", "<html>\n<body>no data</body></html>"), "transmitters", "no element sets"),
    "omm line": (_replaced("receivers", omm_kvn([{**OMM, "EPOCH": "soon"}])), "receivers", "line 9: unreadable OMM"),
    "omm row": (_replaced("receivers", json.dumps([OMM, {**OMM, "BSTAR": "x"}])), "receivers", "row 1: unreadable"),
    "xml entity": (_replaced("receivers", "<!DOCTYPE a [<!ENTITY b 'c'>]>\n<omm/>"), "receivers", "line 1: XML with"),
    "oem line": (_replaced("receivers", _oem(1).replace("ITRF2014", "B1950")), "receivers", "line 8: REF_FRAME B1950"),
    "duplicate in a file": (_replaced("receivers", RECEIVERS * 2), "receivers", "given twice, in line 2 and line 8"),
    "duplicate over files": (
        _two_files,
        "receivers",
        "41884 is given twice, in line 2 of receivers.tle and line 3 of receivers.other.xml",
    ),
    "duplicate code": (_replaced("transmitters", TRANSMITTERS.replace("PRN 20", "PRN 13")), "transmitters", "G13"),
    "epochs far before": (_changed(start="2023-03-04T00:00:00Z"), "receivers", "89.9 days away (before it)"),
    "epochs far after": (_changed(start="2022-10-01T00:00:00Z"), "receivers", "63.7 days away (after it)"),
    "all decayed": (_replaced("receivers", _decayed(2), "json"), "receivers", "came down (row 0)"),
    "horizon beyond an oem": (_replaced("receivers", _oem(0.25)), "receivers", "holds from 2022-12-04T00:00:00Z to"),
    "horizon before an oem": (_replaced("receivers", _oem(1, 300.0)), "receivers", "beyond the ephemeris in lines 14"),
    "sp3 gap of all": (
        _replaced("transmitters", _sp3({f"G{n:02d}": range(24, 26) for n in range(1, 33)}), "sp3"),
        "transmitters",
        "a gap from 2022-12-03T23:45:00Z",
    ),
    "no such constellation": (_changed(constellations=["QZSS"]), "constellations", "no satellite of QZSS"),
    "receivers as transmitters": (_replaced("transmitters", RECEIVERS), "transmitters", "not one of 2 satellites"),
    "step": (_changed(step_s=7), "step_s", "step_s 7 does not divide duration_s 1200"),
    "half a second": (_changed(start="2022-12-04T00:00:00.5Z"), "start", "not a whole second"),
    "no targets": (_no_targets, "targets", "empty"),
    "station off the earth": (_stations(latitude_deg=[95.0]), "latitude_deg", "row 0"),
    "station mask": (_stations(mask_deg=[90.0]), "stations", "row 0 of the stations"),
    "azimuth mask": (_stations(azimuth_mask=["0:7 350"]), "azimuth_mask", "'350' (row 0 of the stations)"),
    "fleet of others": (_fleet({"satellites": [{"satellite": "A", "catalogue_number": 5}]}), "receivers", "not one of"),
    "fleet row": (_fleet({"satellites": [{"satellite": "A"}, {}]}), "fleet", "row 1 names no satellite"),
}  # fmt: skip


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, Path]]:
    """The access service behind its HTTP face, with one worker, and its artifact root."""
    root = tmp_path_factory.mktemp("http")
    app = create_app("access", "Access", PROCESSES, settings=ServiceSettings(artifact_root=str(root), workers=1))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client, root


@pytest.mark.parametrize("case", REFUSED)
def test_the_core_refuses_and_names_the_fault(case: str, tmp_path: Path) -> None:
    edit, field, words = REFUSED[case]
    with pytest.raises(DomainError) as caught:
        _run(tmp_path, edit)
    assert (caught.value.field, words in caught.value.message) == (field, True), caught.value.message
    assert caught.value.accepted
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.parent.name != "in"]


@pytest.mark.parametrize("case", REFUSED)
def test_http_refuses_in_the_same_words(case: str, service: tuple[TestClient, Path]) -> None:
    client, root = service
    edit, field, words = REFUSED[case]
    answer = client.post(EXECUTE, json={"inputs": _inputs(root / "in" / case.replace(" ", "-"), edit)})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert (problem["field"], words in problem["detail"]) == (field, True), problem
    assert "Traceback" not in answer.text
    assert not [path for path in root.rglob("*.parquet") if "predict-access" in path.parts]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"fleet": "spire"}, "fleet"),
        ({"constellations": ["GLONASS"]}, "constellations"),
        ({"constellations": []}, "constellations"),
        ({"receivers": []}, "receivers"),
        ({"min_contact_s": -1}, "min_contact_s"),
        ({"start": "2022-12-04T00:00:00"}, "start"),
        ({"duration_s": 0}, "duration_s"),
        ({"receiver": "x"}, "receiver"),
    ],
)
def test_what_the_process_does_not_know_is_named(
    change: dict[str, Any], field: str, service: tuple[TestClient, Path]
) -> None:
    client, root = service
    answer = client.post(EXECUTE, json={"inputs": _inputs(root / "in" / "misfit", _changed(**change))})
    assert answer.status_code == 422, answer.text
    faults = answer.json()["errors"]
    assert faults and all(fault["field"].split(".")[0] == field and fault["detail"] for fault in faults)


def _run(root: Path, edit: Edit) -> dict[str, Any]:
    store = ArtifactStore(Roots(str(root)))
    inputs = validate_inputs(PROCESSES[0], _inputs(root / "in", edit))
    step = resolve_step(PROCESSES[0], inputs, store, "test")
    return run_step(step, store, "test", "job", lambda percent, message: None)


def _report(outputs: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path(outputs["report"]["href"].removeprefix("file://")).read_text())
    return found


def test_good_and_doubtful_input_is_answered_over_http(service: tuple[TestClient, Path]) -> None:
    """One receiver decayed, one transmitter with a gap, contacts too short, a station at the pole: warned."""
    client, root = service

    def edit(folder: Path) -> dict[str, Any]:
        polar = {key: [*values, *values] for key, values in STATION.items()}
        polar |= {"station": ["pole", "hawaii"], "latitude_deg": [90.0, 19.0], "longitude_deg": [0.0, -155.65]}
        polar |= {"up": ["spherical", "geodetic"], "azimuth_mask": [None, "0:8 180:9"]}
        _write_stations(folder / "stations.parquet", **polar)
        gap = _sp3({"G13": range(24, 26)})
        return _replaced("receivers", _decayed(1), "json")(folder) | _replaced("transmitters", gap, "sp3")(folder) | {
            "min_contact_s": 3600, "with_figures": True, "duration_s": 18000, "step_s": 60, "constellations": ["g"],
        }  # fmt: skip

    answer = client.post(EXECUTE, json={"inputs": _inputs(root / "in" / "doubtful", edit)})
    assert answer.status_code == 200, answer.text
    outputs = answer.json()
    report = _report(outputs)
    assert outputs["warnings"] == report["warnings"]
    assert "came down" in report["dropped"]["CYGFM05"]
    assert "a gap from 2022-12-03T23:45:00Z (lines" in report["dropped"]["G13"]
    assert outputs["contact_count"] == 0 < report["counts"]["contacts_too_short"]
    assert any("with hawaii" in line and "shorter than the 3600 s" in line for line in outputs["warnings"])
    assert report["stations"] == [
        {"station": "pole", "datum": "geodetic", "up": "spherical", "mask_deg": 7.0, "azimuth_mask_deg": None},
        {
            "station": "hawaii",
            "datum": "geodetic",
            "up": "geodetic",
            "mask_deg": 7.0,
            "azimuth_mask_deg": [[0, 8], [180, 9]],
        },
    ]
    assert {row["source"] for row in report["transmitters"]} == {"sp3"}
    assert all(row["newer_than_start"] and row["interpolation_error_m"] < 1.0 for row in report["transmitters"])
    picture = Path(outputs["timeline"]["href"].removeprefix("file://"))
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_an_ephemeris_gives_the_contacts_of_its_elements(tmp_path: Path) -> None:
    """CYGFM05 by SGP4, and the same states as an OEM file: the same contacts and eclipses to a millisecond or two."""
    day = {"duration_s": 43200, "step_s": 60}
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    by_sgp4 = _run(
        tmp_path / "a", lambda folder: {**day, **_replaced("receivers", RECEIVERS.split("CYGFM04")[0])(folder)}
    )
    by_table = _run(tmp_path / "b", lambda folder: {**day, **_replaced("receivers", _oem(12.0), "oem")(folder)})
    for name, contract in (("contacts", tables.CONTACTS), ("eclipses", tables.ECLIPSES)):
        ours, theirs = (
            read_table(outputs[name]["href"].removeprefix("file://"), contract) for outputs in (by_table, by_sgp4)
        )
        assert len(ours) == len(theirs) > 0
        for edge in ("start", "end"):
            assert (ours[edge] - theirs[edge]).abs().max() <= pd.Timedelta("3ms")
    assert _report(by_table)["receivers"][0]["source"] == "oem"


def test_the_example_fleet_is_marked_as_simulated(tmp_path: Path) -> None:
    omm = Path(__file__).parents[3] / "services/access/fleets/example_commercial.omm"
    day = {"start": "2025-08-31T06:00:00Z", "fleet": "example_commercial"}
    gps = {"max_element_age_days": 365, "constellations": ["GPS"]}

    def edit(folder: Path) -> dict[str, Any]:
        orbits = _replaced("receivers", omm.read_text(), "omm")(folder)
        elements = TRANSMITTERS.splitlines()
        return {**day, **gps, **orbits, "start": "2025-08-31T06:00:00Z"} | _moved(folder, elements)

    outputs = _run(tmp_path, edit)
    report = _report(outputs)
    assert report["product"]["simulated"] is True
    assert [row["satellite"] for row in report["receivers"]] == [f"EXAMPLE-{n:02d}" for n in range(1, 7)]


def _moved(folder: Path, lines: list[str]) -> dict[str, Any]:
    """The transmitters with an epoch of the example's day, checksums made anew."""
    moved = []
    for line in lines:
        if line.startswith("1 "):
            line = line[:18] + "25243.00000000" + line[32:68]
            line += str(sum(int(c) if c.isdigit() else c == "-" for c in line) % 10)
        moved.append(line)
    return _replaced("transmitters", "\n".join(moved))(folder)
