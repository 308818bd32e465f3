"""Elements are read as published, and every broken line is named."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from services.access.orbits.constellations import transmitter_code
from services.access.orbits.elements import within_age
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from shared.errors import DomainError
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS

OMM_CYGFM05 = {
    "OBJECT_NAME": "CYGFM05",
    "OBJECT_ID": "2016-078A",
    "EPOCH": "2022-12-04T01:28:02.316288",
    "MEAN_MOTION": "15.17438862",
    "ECCENTRICITY": "0.0014167",
    "INCLINATION": "34.9552",
    "RA_OF_ASC_NODE": "224.7531",
    "ARG_OF_PERICENTER": "176.0718",
    "MEAN_ANOMALY": "184.0107",
    "NORAD_CAT_ID": "41884",
    "BSTAR": "0.00014529",
    "MEAN_MOTION_DOT": "0.0000295",
    "MEAN_MOTION_DDOT": "0",
}


def _fault(text: str) -> DomainError:
    with pytest.raises(DomainError) as caught:
        read_orbits(text, "receivers")
    assert caught.value.field == "receivers"
    return caught.value


def test_names_and_epochs_are_read() -> None:
    first, second = read_orbits(RECEIVERS)
    assert (first.name, first.catalogue_number, second.name) == ("CYGFM05", 41884, "CYGFM04")
    assert abs(first.epoch - datetime(2022, 12, 4, 1, 28, 2, 316288, tzinfo=UTC)) < timedelta(milliseconds=1)


def test_names_may_be_missing_and_lines_may_end_as_windows_ends_them() -> None:
    bare = "\r\n".join(line for line in RECEIVERS.splitlines() if line[0] in "12")
    assert [element.name for element in read_orbits(bare)] == ["41884", "41885"]


def test_omm_gives_the_orbit_of_the_tle() -> None:
    (from_omm,) = read_orbits(json.dumps([OMM_CYGFM05]))
    from_tle = read_orbits(RECEIVERS)[0]
    when = from_tle.record.jdsatepoch, from_tle.record.jdsatepochF + 0.5
    for ours, theirs in zip(from_omm.record.sgp4(*when)[1], from_tle.record.sgp4(*when)[1], strict=True):
        assert ours == pytest.approx(theirs, abs=1e-3)


def test_a_wrong_checksum_is_named_with_its_line() -> None:
    lines = RECEIVERS.splitlines()
    lines[4] = lines[4].replace("22337", "22338")
    error = _fault("\n".join(lines))
    assert "line 5" in error.message and "checksum" in error.message


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "no element sets"),
        ("CYGFM05\nnothing here\n", "line 1"),
        ("\n".join(RECEIVERS.splitlines()[:2]), "line 3: expected line 2"),
        ("\n".join(RECEIVERS.splitlines()[2:]), "line 1: a line 2 stands without"),
        (RECEIVERS.replace("15.17438862330651", "15.1743886233065"), "line 3: the line has 68 characters"),
        ("\n".join(RECEIVERS.splitlines()[i] for i in (0, 1, 5)), "catalogue number differs"),
        (RECEIVERS + RECEIVERS, "satellite 41884 is given twice, in line 2 and line 8"),
        ("[{", "malformed JSON"),
        ("[3]", "row 0: not an OMM object"),
        (json.dumps([OMM_CYGFM05, {**OMM_CYGFM05, "EPOCH": "soon"}]), "row 1: unreadable"),
        (json.dumps([{k: v for k, v in OMM_CYGFM05.items() if k != "BSTAR"}]), "row 0: the OMM lacks BSTAR"),
        (json.dumps([OMM_CYGFM05, OMM_CYGFM05]), "given twice, in row 0 and row 1"),
    ],
)
def test_broken_elements_are_named(text: str, what: str) -> None:
    assert what in _fault(text).message


def test_transmitters_take_their_codes() -> None:
    named, dropped = name_transmitters(read_orbits(TRANSMITTERS), START)
    assert [element.name for element in named][:3] == ["G02", "G07", "G12"]
    assert dropped == {}
    with pytest.raises(DomainError, match="not one of 2 satellites has a known ranging code"):
        name_transmitters(read_orbits(RECEIVERS), START)


def test_codes_change_hands() -> None:
    def code(number: int, year: int) -> str | None:
        return transmitter_code("NAVSTAR", number, datetime(year, 6, 1, tzinfo=UTC))

    assert (code(26605, 2020), code(26605, 2021), code(26605, 2022)) == ("G14", None, "G22")  # SVN 41
    assert (code(28129, 2021), code(28129, 2022)) == ("G22", None)  # SVN 47, NANU 2022001
    coded = [number for number in range(24000, 68000) if code(number, 2017) or code(number, 2021) or code(number, 2026)]
    for year in range(2017, 2027):
        given = [name for number in coded if (name := code(number, year))]
        assert len(given) == len(set(given)), f"two satellites share a code in {year}"


def test_old_elements_are_left_out_and_named_when_all_are_old() -> None:
    elements = read_orbits(RECEIVERS)
    near, dropped = within_age(elements, START, 0.2, "receivers")
    assert [element.name for element in near] == ["CYGFM05"]
    assert "line 5" in dropped["CYGFM04"]
    with pytest.raises(DomainError, match=r"CYGFM05 in line 2.*60\.9 days away"):
        within_age(elements, START + timedelta(days=61), 30.0, "receivers")


def test_published_codes_agree_with_the_table(real_data: Path) -> None:
    for constellation in ("gps", "galileo"):
        elements = read_orbits((real_data / f"orbits/tle_20221204/{constellation}.tle").read_text())
        for element in elements:
            if "PRN" in element.name:
                printed = transmitter_code(element.name, 0, START)
                assert transmitter_code("", element.catalogue_number, START) == printed


@pytest.mark.parametrize("path", ["tle_20200730/gps.tle", "tle_20220505/gps.tle", "omm_20250831/galileo.json"])
def test_real_sets_are_named_without_doubles(real_data: Path, path: str) -> None:
    elements = read_orbits((real_data / "orbits" / path).read_text())
    named, dropped = name_transmitters(elements, elements[0].epoch)
    assert len(named) + len(dropped) == len(elements)
    assert len(named) >= 28
