"""The same orbit in every format: told apart by content, read alike, and every fault named by its line."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from xml.sax.saxutils import escape

import numpy as np
import pytest

from services.access.orbits.elements import ElementSet
from services.access.orbits.formats import read_files, read_orbits
from services.access.orbits.tabulated import TabulatedOrbit
from services.access.orbits.time_scales import tai_minus_utc_s, to_utc
from shared.errors import DomainError
from tests.services.access.orbit_files import KEYWORDS, OMM, oem_kvn, oem_xml, omm_kvn, omm_xml, sp3
from tests.services.access.orbits import RECEIVERS, START

WHEN_S = np.arange(0.0, 7200.0, 60.0)


def _states(orbit: object) -> np.ndarray:
    assert isinstance(orbit, ElementSet)
    day = orbit.record.jdsatepoch, orbit.record.jdsatepochF + 0.25
    return np.array(orbit.record.sgp4(*day)[1])


def _fault(text: str) -> DomainError:
    with pytest.raises(DomainError) as caught:
        read_orbits(text, "receivers")
    return caught.value


@pytest.mark.parametrize("text", [json.dumps([OMM]), json.dumps(OMM), omm_xml([OMM]), omm_kvn([OMM])])
def test_every_omm_is_the_orbit_of_the_tle(text: str) -> None:
    (orbit,) = read_orbits(text)
    tle = read_orbits(RECEIVERS)[0]
    assert (orbit.name, orbit.catalogue_number, orbit.source) == ("CYGFM05", 41884, "omm")
    assert abs(orbit.epoch - tle.epoch) < timedelta(milliseconds=1)
    assert np.abs(_states(orbit) - _states(tle)).max() < 1e-3


def test_numbers_as_texts_or_numbers_and_units_in_brackets_are_the_same() -> None:
    numbers = {key: float(value) if key in KEYWORDS else value for key, value in OMM.items()} | {"NORAD_CAT_ID": 41884}
    with_units = omm_kvn([OMM]).replace("INCLINATION = 34.9552", "INCLINATION = 34.9552 [deg]")
    for text in (json.dumps([numbers]), with_units):
        assert np.array_equal(_states(read_orbits(text)[0]), _states(read_orbits(json.dumps([OMM]))[0]))


def test_an_epoch_by_day_of_year_is_the_same_day() -> None:
    counted = omm_kvn([{**OMM, "EPOCH": "2022-338T01:28:02.316288"}])
    assert read_orbits(counted)[0].epoch == datetime(2022, 12, 4, 1, 28, 2, 316288, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (omm_kvn([OMM, {**OMM, "NORAD_CAT_ID": "5", "ECCENTRICITY": "1.2"}]), "line 18: eccentricity 1.2"),
        (omm_kvn([{**OMM, "INCLINATION": "steep"}]), "line 12: unreadable OMM"),
        (omm_kvn([{**OMM, "MEAN_MOTION": "nan"}]), "line 10: unreadable OMM"),
        (omm_kvn([OMM]) + "what is this\n", "line 18: neither a keyword line"),
        (omm_kvn([{**OMM, "REF_FRAME": "EME2000"}]), "line 6: REF_FRAME EME2000"),
        (omm_kvn([{**OMM, "MEAN_ELEMENT_THEORY": "DSST"}]), "line 8: MEAN_ELEMENT_THEORY DSST"),
        (omm_kvn([{k: v for k, v in OMM.items() if k != "BSTAR"}]), "line 1: the OMM lacks BSTAR"),
        (omm_xml([{**OMM, "EPOCH": "soon"}]), "line 10: unreadable OMM .EPOCH 'soon'"),
        (omm_xml([OMM]).replace("</omm>", ""), "line 20: malformed XML"),
        ('<?xml version="1.0"?>\n<!DOCTYPE omm>\n<omm></omm>', "line 2: XML with a document type"),
        ("<ndm></ndm>", "no element sets"),
        (json.dumps([OMM, {**OMM, "NORAD_CAT_ID": "x"}]), "row 1: unreadable OMM .NORAD_CAT_ID 'x'"),
        (omm_kvn([OMM, OMM]), "satellite 41884 is given twice, in line 1 and line 18"),
        (RECEIVERS + "CYGFM09\n", "line 7: a name without elements"),
    ],
)
def test_broken_elements_are_named_by_line_or_row(text: str, what: str) -> None:
    with pytest.raises(DomainError, match=what) as caught:
        read_orbits(text, "receivers")
    assert caught.value.field == "receivers"


def test_comments_stand_between_elements() -> None:
    assert len(read_orbits("# from a catalogue\n" + RECEIVERS.replace("CYGFM04", "# another\nCYGFM04"))) == 2


def _circle(t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A circular orbit in inertial axes, km and km/s."""
    radius, rate = 6900.0, np.sqrt(398600.4418 / 6900.0**3)
    zero = np.zeros_like(t_s)
    cosine, sine = np.cos(rate * t_s), np.sin(rate * t_s)
    return radius * np.stack([cosine, 0.8 * sine, 0.6 * sine], 1), radius * rate * np.stack(
        [-sine, 0.8 * cosine, 0.6 * cosine], 1
    ) + zero[:, None]


@pytest.mark.parametrize("writer", [oem_kvn, oem_xml])
def test_an_oem_is_the_orbit_that_was_written(writer: object) -> None:
    """States between the written ones, in KVN and XML, in GPS time and UTC: the same circle in ITRF."""
    position, velocity = _circle(WHEN_S)
    (orbit,) = read_orbits(writer("SAT", START, WHEN_S, position, velocity))  # type: ignore[operator]
    assert isinstance(orbit, TabulatedOrbit)
    assert (orbit.name, orbit.source, orbit.first, len(orbit.segments)) == ("SAT", "oem", START, 1)
    radius = np.linalg.norm(orbit.segments[0].position_m, axis=1)
    assert np.abs(radius - 6.9e6).max() < 1.0  # KVN and XML carry six decimals of a kilometre
    gps = writer("SAT", START + timedelta(seconds=18), WHEN_S, position, velocity, TIME_SYSTEM="GPS")  # type: ignore[operator]
    (same,) = read_orbits(gps)
    assert isinstance(same, TabulatedOrbit) and same.first == START
    assert np.abs(same.segments[0].position_m - orbit.segments[0].position_m).max() < 1e-6


def test_frames_of_an_oem_differ_by_what_they_should() -> None:
    """EME2000 and ICRF by 0.02 arcsec, TEME by precession since 2000, and ITRF is taken as it stands."""
    position, velocity = _circle(WHEN_S)

    def first(frame: str) -> np.ndarray:
        (orbit,) = read_orbits(oem_kvn("SAT", START, WHEN_S, position, velocity, REF_FRAME=frame))
        assert isinstance(orbit, TabulatedOrbit)
        return orbit.segments[0].position_m

    assert np.linalg.norm(first("EME2000") - first("ICRF"), axis=1).max() == pytest.approx(0.77, abs=0.05)
    years = (START - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=365.25)
    moved = np.linalg.norm(first("TEME") - first("ICRF"), axis=1).max()
    assert moved == pytest.approx(6.9e6 * np.radians(50.29 * years / 3600.0), rel=0.1)
    assert np.array_equal(first("EarthMJ2000Eq"), first("EME2000"))
    for name in ("ITRF2014", "ITRF-93", "WGS84", "IGS20"):
        assert np.allclose(first(name), position * 1000.0, atol=1e-3)


def _oem_lines(*, change: dict[int, str] | None = None, **meta: str) -> str:
    position, velocity = _circle(WHEN_S)
    lines = oem_kvn("SAT", START, WHEN_S, position, velocity, **meta).splitlines()
    for number, line in (change or {}).items():
        lines[number - 1] = line
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (_oem_lines(REF_FRAME="MARSIAU"), "line 8: REF_FRAME MARSIAU is not known"),
        (_oem_lines(TIME_SYSTEM="LOCAL"), "line 9: TIME_SYSTEM LOCAL is not known"),
        (_oem_lines(CENTER_NAME="MOON"), "line 7: the centre is not the Earth"),
        (_oem_lines(change={20: "2022-12-04T00:06:00.000000 1 2 3"}), "line 20: a state of 4 columns"),
        (_oem_lines(change={20: "2022-12-04T00:06:00.000000 1 2 3 4 5 x"}), "line 20: a state that is no numbers"),
        (_oem_lines(change={20: "yesterday 1 2 3 4 5 6"}), "line 20: 'yesterday' is not an epoch"),
        (_oem_lines(change={20: _oem_lines().splitlines()[18]}), "line 20: the epoch does not lie after"),
        (_oem_lines(change={20: "2022-12-04T00:06:00.000000 1 2 3 4 5 6"}), "line 20: the satellite moves"),
        (_oem_lines(change={5: "OBJECT = SAT"}), "line 4: the segment lacks OBJECT_NAME"),
        ("CCSDS_OEM_VERS = 2.0\n", "line 1: an OEM without a segment"),
        (_oem_lines() + _oem_lines().split("\n", 3)[3], "overlap those of lines 14 to 133"),
    ],
)
def test_broken_ephemerides_are_named_by_line(text: str, what: str) -> None:
    with pytest.raises(DomainError, match=what):
        read_orbits(text, "receivers")


def test_metres_in_place_of_kilometres_are_found_out() -> None:
    position, velocity = _circle(WHEN_S)
    assert "kilometres" in _fault(oem_kvn("SAT", START, WHEN_S, position * 1000.0, velocity * 1000.0)).accepted
    assert "velocities say" in _fault(oem_kvn("SAT", START, WHEN_S, position, velocity * 1000.0)).message


def test_sp3_is_read_with_its_gaps_and_its_time_scale() -> None:
    t_s = np.arange(0.0, 86400.0, 900.0)
    position = 4.0 * _circle(t_s / 8.0)[0]
    text = sp3(START, t_s, {"G01": position, "E05": position}, missing={"G01": range(40, 45)})
    galileo, gps = read_orbits(text, "transmitters")
    assert isinstance(gps, TabulatedOrbit) and isinstance(galileo, TabulatedOrbit)
    assert (galileo.name, gps.name, len(galileo.segments), len(gps.segments)) == ("E05", "G01", 1, 2)
    assert gps.first == START - timedelta(seconds=18)  # GPS time runs ahead of UTC by 18 s
    assert gps.segments[0].last_s == 39 * 900.0 and gps.segments[1].first_s == 45 * 900.0
    assert np.abs(galileo.segments[0].position_m / 1000.0 - position).max() < 1e-5
    assert galileo.epoch == galileo.last


def test_predicted_sp3_positions_do_not_count_as_observed() -> None:
    t_s = np.arange(0.0, 86400.0, 900.0)
    text = sp3(START, t_s, {"G01": 4.0 * _circle(t_s / 8.0)[0]}, predicted_from=48)
    (orbit,) = read_orbits(text)
    assert orbit.epoch == START + timedelta(seconds=47 * 900 - 18)


def test_days_of_sp3_one_after_the_other_are_one_orbit() -> None:
    t_s = np.arange(0.0, 86401.0, 900.0)
    days = [4.0 * _circle((t_s + day * 86400.0) / 8.0)[0] for day in (0, 1)]
    text = "".join(sp3(START + timedelta(days=day), t_s, {"G01": days[day]}) for day in (0, 1))
    (orbit,) = read_orbits(text)
    assert isinstance(orbit, TabulatedOrbit)
    assert len(orbit.segments) == 1 and len(orbit.segments[0].times_s) == 193  # midnight stands in both


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (("*  2022 12  4  2", "*  2022 12 44  2"), "line 32: not an epoch"),
        (("PG01  ", "PG01 x"), "line 25: not a position"),
        (("*  2022 12  4  2  0", "*  2022 12  3  2  0"), "line 32: an epoch before the one above"),
        (("%c M  cc GPS", "%c M  cc XYZ"), "line 13: time scale XYZ is not known"),
    ],
)
def test_broken_sp3_is_named_by_line(change: tuple[str, str], what: str) -> None:
    t_s = np.arange(0.0, 86400.0, 1800.0)
    text = sp3(START, t_s, {"G01": 4.0 * _circle(t_s / 8.0)[0]})
    assert change[0] in text
    with pytest.raises(DomainError, match=what):
        read_orbits(text.replace(change[0], change[1], 1), "transmitters")


def test_a_satellite_twice_at_one_sp3_epoch_is_named() -> None:
    t_s = np.arange(0.0, 86400.0, 900.0)
    lines = sp3(START, t_s, {"G01": 4.0 * _circle(t_s / 8.0)[0]}).splitlines()
    with pytest.raises(DomainError, match=r"line 26: G01 is given twice at one epoch, first in line 25"):
        read_orbits("\n".join([*lines[:25], lines[24], *lines[25:]]))


def test_files_of_several_formats_make_one_list() -> None:
    t_s = np.arange(0.0, 86400.0, 900.0)
    gps = sp3(START, t_s, {"G01": 4.0 * _circle(t_s / 8.0)[0]})
    names = [orbit.name for orbit in read_files([("a.sp3", gps), ("b.tle", RECEIVERS)], "transmitters")]
    assert names == ["G01", "CYGFM05", "CYGFM04"]
    with pytest.raises(DomainError, match=r"41884 is given twice, in line 2 of b.tle and row 0 of c.json"):
        read_files([("b.tle", RECEIVERS), ("c.json", json.dumps([OMM]))], "receivers")
    with pytest.raises(DomainError, match=r"receivers \(c.json\): row 0: unreadable"):
        read_files([("b.tle", RECEIVERS), ("c.json", json.dumps([{**OMM, "EPOCH": "?"}]))], "receivers")


def test_leap_seconds_are_those_of_iers() -> None:
    assert tai_minus_utc_s(datetime(2016, 12, 31, 23, tzinfo=UTC)) == 36.0
    assert tai_minus_utc_s(datetime(2017, 1, 1, tzinfo=UTC)) == 37.0
    gps = np.array(["2017-01-01T00:00:18", "2016-12-31T00:00:17"], dtype="datetime64[us]")
    expected = np.array(["2017-01-01T00:00:00", "2016-12-31T00:00:00"], dtype="datetime64[us]")
    assert np.array_equal(to_utc(gps, "GPS"), expected)
    assert to_utc(gps[:1], "TT")[0] == np.datetime64("2016-12-31T23:59:09.816", "us")


@pytest.mark.parametrize("writer", [omm_xml, omm_kvn])
def test_decay_is_read_from_a_users_own_keywords(writer: object) -> None:
    row = {**OMM, "USER_DEFINED_DECAY_DATE": "2022-11-30"}
    text = writer([row])  # type: ignore[operator]
    for end in ("", "/"):
        tag = f'<{end}USER_DEFINED parameter="DECAY_DATE">' if not end else "</USER_DEFINED>"
        text = text.replace(f"<{end}USER_DEFINED_DECAY_DATE>", tag)
    (orbit,) = read_orbits(text)
    assert isinstance(orbit, ElementSet) and orbit.decayed == datetime(2022, 11, 30, tzinfo=UTC)


def test_names_with_signs_of_xml_survive() -> None:
    (orbit,) = read_orbits(omm_xml([{**OMM, "OBJECT_NAME": escape("A & B <1>")}]))
    assert orbit.name == "A & B <1>"
