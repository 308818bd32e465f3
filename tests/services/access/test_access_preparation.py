"""Which orbits a prediction uses, what it says of those it leaves out, and how old the others are."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from services.access.orbits.constellations import letters_of, transmitter_code
from services.access.orbits.elements import ElementSet
from services.access.orbits.ephemeris import Ephemeris, propagate
from services.access.orbits.formats import Orbit, read_orbits
from services.access.orbits.preparation import (
    choose_constellations,
    missing_constellations,
    name_transmitters,
    prepare,
)
from services.access.orbits.statement import expected_error_km, orbit_row, orbit_warnings
from services.access.orbits.tabulated import Segment, TabulatedOrbit, interpolate
from shared.errors import DomainError
from tests.services.access.orbit_files import sp3
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS
from tests.services.access.truth import sp3_orbits

DAY_S = 86400.0


def _sets(text: str) -> list[ElementSet]:
    return [orbit for orbit in read_orbits(text) if isinstance(orbit, ElementSet)]


def _table(ephemeris: Ephemeris, source: str = "oem", **changes: object) -> TabulatedOrbit:
    times = ephemeris.times_s
    segment = Segment(times, ephemeris.position_m, 0.0, float(times[-1]), "lines 1 to 9")
    orbit = TabulatedOrbit(ephemeris.name, source, None, ephemeris.start, (segment,), "lines 1 to 9")  # type: ignore[arg-type]
    return replace(orbit, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "step_s", "bound_m"), [(TRANSMITTERS, 900.0, 0.02), (RECEIVERS, 60.0, 0.01), (RECEIVERS, 180.0, 0.05)]
)
def test_tables_are_interpolated_far_below_a_metre(text: str, step_s: float, bound_m: float) -> None:
    """SGP4 written every 15 minutes (SP3) or every minute or three (OEM) against SGP4 itself, ends included."""
    coarse, _ = propagate(_sets(text), START, DAY_S, step_s)
    fine, _ = propagate(_sets(text), START, DAY_S, 30.0)
    found, dropped, bounds = interpolate([_table(orbit) for orbit in coarse], START, DAY_S, 30.0)
    assert not dropped
    for ours, truth in zip(found, fine, strict=True):
        errors = np.linalg.norm(ours.position_m - truth.position_m, axis=1)
        assert errors.max() < bound_m
        assert np.linalg.norm(ours.velocity_m_s - truth.velocity_m_s, axis=1).max() < 0.05
        assert bounds[ours.name] < 1.0


def test_real_sp3_orbits_leave_every_other_epoch_to_be_guessed(real_data: Path) -> None:
    """IGS positions at 30 minutes give those between them to centimetres; at 15 minutes the bound says below 0.5 m."""
    name = "IGS0OPSRAP_20223380000_01D_15M_ORB.SP3"
    orbits = list(sp3_orbits(real_data, name).values())
    middle_s = 43200.0
    for orbit in orbits:
        whole = orbit.segments[0]
        half = Segment(whole.times_s[::2], whole.position_m[::2], 0.0, float(whole.times_s[-2]), "")
        sparse = replace(orbit, segments=(half,))
        start = orbit.reference + timedelta(seconds=middle_s)
        (found,), _, _ = interpolate([sparse], start, 1800.0, 900.0)
        given = whole.position_m[np.searchsorted(whole.times_s, middle_s + 900.0)]
        assert np.linalg.norm(found.position_m[1] - given) < 0.05
    _, dropped, bounds = interpolate(orbits, orbits[0].first, 85500.0, 60.0)
    assert not dropped and max(bounds.values()) < 0.5


def test_a_table_is_not_used_beyond_its_ends_nor_over_a_gap() -> None:
    (orbit,) = propagate(_sets(RECEIVERS)[:1], START, DAY_S, 60.0)[0]
    table = _table(orbit)
    late = interpolate([table], START + timedelta(hours=1), DAY_S, 60.0)
    assert "reaches beyond the ephemeris in lines 1 to 9" in late[1]["CYGFM05"]
    assert "2022-12-05T00:00:00Z" in late[1]["CYGFM05"]
    t, p = orbit.times_s, orbit.position_m
    halves = (
        Segment(t[:600], p[:600], 0.0, t[599], "lines 1 to 600"),
        Segment(t[660:], p[660:], t[660], t[-1], "lines 661 to 9"),
    )
    holed = replace(table, segments=halves)
    gap = interpolate([holed], START, DAY_S, 60.0)[1]["CYGFM05"]
    assert "a gap from 2022-12-04T09:59:00Z (lines 1 to 600) to 2022-12-04T11:00:00Z (lines 661 to 9)" in gap
    before, _, _ = interpolate([holed], START, 30000.0, 60.0)
    after, _, _ = interpolate([holed], START + timedelta(hours=11), 30000.0, 60.0)
    assert len(before) == len(after) == 1


def test_nothing_is_interpolated_across_two_segments() -> None:
    """A manoeuvre parts two segments: each side keeps its own orbit."""
    first, second = (propagate(_sets(RECEIVERS)[i : i + 1], START, 7200.0, 60.0)[0][0] for i in (0, 1))
    t = first.times_s
    segments = (
        Segment(t[:61], first.position_m[:61], 0.0, 3600.0, ""),
        Segment(t[60:], second.position_m[60:], 3600.0, 7200.0, ""),
    )
    (found,), _, _ = interpolate([replace(_table(first), segments=segments)], START, 7200.0, 60.0)
    assert np.abs(found.position_m[:60] - first.position_m[:60]).max() < 0.01
    assert np.abs(found.position_m[60:] - second.position_m[60:]).max() < 0.01


def test_states_too_far_apart_are_refused() -> None:
    (orbit,) = propagate(_sets(RECEIVERS)[:1], START, DAY_S, 900.0)[0]
    _, dropped, _ = interpolate([_table(orbit)], START, DAY_S, 60.0)
    assert "lie too far apart" in dropped["CYGFM05"]


def test_satellites_that_have_come_down_are_left_out() -> None:
    sets = _sets(RECEIVERS)
    down = replace(sets[0], decayed=START - timedelta(days=3))
    later = replace(sets[1], decayed=START + timedelta(days=500))
    prepared = prepare([down, later], START, 600.0, 10.0, 30.0, "receivers")
    assert [orbit.name for orbit in prepared.used] == ["CYGFM04"]
    assert "came down on 2022-12-01" in prepared.dropped["CYGFM05"]
    with pytest.raises(DomainError, match=r"no satellite can be used .*CYGFM05: .*came down.*line 2"):
        prepare([down], START, 600.0, 10.0, 30.0, "receivers")


def test_old_elements_beside_a_table_are_left_out_not_refused() -> None:
    start = START + timedelta(days=100)
    (ephemeris,) = propagate(_sets(RECEIVERS)[:1], start, DAY_S, 60.0)[0]
    prepared = prepare([_table(ephemeris), _sets(RECEIVERS)[1]], start, 3600.0, 10.0, 30.0, "receivers")
    assert [orbit.name for orbit in prepared.used] == ["CYGFM05"]
    assert "100.3 days before the start" in prepared.dropped["CYGFM04"]


def test_an_sp3_satellite_without_positions_is_left_out() -> None:
    orbits, _ = propagate(_sets(TRANSMITTERS)[:2], START, DAY_S, 900.0)
    positions = {code: orbit.position_m / 1000.0 for code, orbit in zip(("G01", "G02"), orbits, strict=True)}
    text = sp3(START, orbits[0].times_s, positions, missing={"G02": range(97)})
    prepared = prepare(read_orbits(text), START, 3600.0, 60.0, 30.0, "transmitters")
    assert [orbit.name for orbit in prepared.used] == ["G01"]
    assert prepared.dropped["G02"] == "the file (line 26) gives it too few positions in a row"


def test_of_many_reasons_a_few_are_told() -> None:
    old = START + timedelta(days=1)
    far = [replace(each, decayed=START) for each in _sets(TRANSMITTERS)]
    with pytest.raises(DomainError, match="and so on for 7 more"):
        prepare(far, old, 3600.0, 60.0, 30.0, "transmitters")


def test_two_receivers_of_one_name_are_refused_with_both_lines() -> None:
    same = read_orbits(RECEIVERS.replace("CYGFM04", "CYGFM05"))
    with pytest.raises(DomainError, match="name CYGFM05 is given twice, in line 2 and line 5"):
        prepare(same, START, 600.0, 10.0, 30.0, "receivers")


def test_elements_and_tables_are_used_side_by_side_in_order_of_name() -> None:
    sets = _sets(RECEIVERS)
    table = _table(propagate(sets[:1], START, DAY_S, 60.0)[0][0])
    prepared = prepare([table, sets[1]], START, 3600.0, 10.0, 30.0, "receivers")
    assert [state.name for state in prepared.ephemerides] == ["CYGFM04", "CYGFM05"]
    assert list(prepared.interpolation_m) == ["CYGFM05"]
    assert {state.step_s for state in prepared.ephemerides} == {10.0}


def test_ages_are_signed_and_warn_on_both_sides() -> None:
    old, new = _sets(RECEIVERS)
    start = new.epoch + timedelta(days=0.5)  # CYGFM04 half a day old
    assert orbit_warnings([new], start) == []
    (week,) = orbit_warnings([new], new.epoch + timedelta(days=7.1))
    assert week.startswith("CYGFM04") and "(line 5) is 7.1 days old at the start" in week
    (ahead,) = orbit_warnings([old], old.epoch - timedelta(days=0.25))
    assert "newer than the start" in ahead and "age -0.250 days" in ahead and "line 2" in ahead
    row = orbit_row(old, old.epoch - timedelta(days=0.25), {})
    assert (row["age_days"], row["newer_than_start"]) == (-0.25, True)


def test_an_ephemeris_ages_from_its_making() -> None:
    (ephemeris,) = propagate(_sets(RECEIVERS)[:1], START, DAY_S, 60.0)[0]
    unsaid = orbit_row(_table(ephemeris), START, {"CYGFM05": 0.00123})
    assert (unsaid["age_days"], unsaid["newer_than_start"], unsaid["interpolation_error_m"]) == (None, False, 0.0012)
    assert unsaid["ephemeris_end"] == "2022-12-05T00:00:00+00:00"
    made = _table(ephemeris, epoch=START - timedelta(days=9))
    assert (
        "the ephemeris made at 2022-11-25T00:00:00Z (lines 1 to 9) is 9.0 days old" in orbit_warnings([made], START)[0]
    )
    observed = _table(ephemeris, "sp3", epoch=START + timedelta(days=1))
    assert "the orbit observed until 2022-12-05T00:00:00Z" in orbit_warnings([observed], START)[0]


def test_the_position_error_is_stated_where_it_was_measured() -> None:
    gps = name_transmitters(read_orbits(TRANSMITTERS), START)[0][0]
    assert expected_error_km(gps, START) == expected_error_km(gps, START + timedelta(days=1))
    assert expected_error_km(gps, START + timedelta(days=20)) is None
    assert expected_error_km(read_orbits(RECEIVERS)[0], START) is None


@pytest.mark.parametrize(
    ("name", "number", "code"),
    [
        ("GPS BIIF-1  (PRN 25)", 0, "G25"),
        ("GSAT0210 (PRN E01)", 0, "E01"),
        ("GSAT0210 (GALILEO 13)", 41550, "E01"),
        ("BEIDOU-3 M1 (C19)", 43001, "C19"),
        ("BEIDOU-2 G8 (C01)", 44231, "C01"),
        ("QZS-2 (QZSS/PRN 194)", 42738, "J02"),
        ("QZS-2 (QZSS/PRN 184)", 42738, "J02"),
        ("QZS-3 (QZSS/PRN 199)", 42917, "J07"),
        ("QZS-1R (QZSS/PRN 196)", 49336, "J04"),
        ("MICHIBIKI", 49336, "J04"),
        ("C19", None, "C19"),
        ("COSMOS 2456 (730)", 36111, None),
        ("CYGFM05", 41884, None),
    ],
)
def test_codes_of_all_four_constellations(name: str, number: int | None, code: str | None) -> None:
    assert transmitter_code(name, number, START) == code


def test_constellations_are_chosen_by_letter(real_data: Path) -> None:
    folder = real_data / "orbits/tle_20221204"
    orbits: list[Orbit] = [
        *read_orbits((folder / "gps.tle").read_text()),
        *read_orbits((folder / "galileo.tle").read_text()),
    ]
    named, _ = name_transmitters(orbits, START)
    assert {orbit.name[0] for orbit in choose_constellations(named, None)} == {"G", "E"}
    galileo = choose_constellations(named, letters_of(["Galileo", "BeiDou"]))
    assert {orbit.name[0] for orbit in galileo} == {"E"} and len(galileo) >= 24
    assert missing_constellations(galileo, letters_of(["Galileo", "BeiDou"])) == [
        "constellations: BeiDou is asked for, but no satellite of it is used"
    ]
    with pytest.raises(DomainError, match="no satellite of QZSS") as caught:
        choose_constellations(named, letters_of(["QZSS"]))
    assert caught.value.field == "constellations" and caught.value.accepted == "GPS, Galileo"
