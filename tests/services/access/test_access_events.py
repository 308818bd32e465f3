"""Contacts and eclipses: edges refined below the step, against GMAT, and against cases known in closed form."""

from __future__ import annotations

import itertools
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import erfa
import numpy as np
import pytest

from services.access.ellipsoid import SEMI_MAJOR_M, SEMI_MINOR_M, to_cartesian
from services.access.events.azimuth_mask import AzimuthMask
from services.access.events.contacts import (
    Station,
    azimuth_deg,
    find_contacts,
    part_by_duration,
    sine_elevation,
    stations_from,
)
from services.access.events.crossings import maximum_in, positive_intervals
from services.access.events.eclipses import SUN_RADIUS_M, find_eclipses, shadow_depths_rad, sun_curve, sun_position_itrf
from services.access.orbits.ephemeris import Ephemeris, propagate, resample
from services.access.orbits.formats import read_orbits
from services.access.orbits.orientation import J2000_JD, orientation_at
from shared.errors import DomainError
from tests.services.access.orbits import RECEIVERS, START
from tests.services.access.truth import gmat_contact_differences_s, gmat_eclipse_differences_s

STATIONS = (
    Station("hawaii", 19.0, -155.65, 367.0),
    Station("santiago", -33.13, -70.67, 723.0),
    Station("dongara", -29.08, 115.58, 250.0),
)


@pytest.fixture(scope="module")
def orbit() -> Ephemeris:
    return propagate(read_orbits(RECEIVERS), START, 86400.0, 10.0)[0][0]


def test_edges_of_a_sine_are_found_far_below_the_step() -> None:
    found = positive_intervals(lambda t: np.sin(t / 10.0) - 0.5, np.arange(0.0, 121.0, 7.0))
    edges = 10.0 * np.array([np.pi / 6, 5 * np.pi / 6, 2 * np.pi + np.pi / 6, 2 * np.pi + 5 * np.pi / 6])
    assert np.abs(np.ravel(found) - edges).max() < 2e-6


def test_visits_and_gaps_shorter_than_the_step_are_found() -> None:
    t = np.arange(0.0, 100.0, 10.0)
    (visit,) = positive_intervals(lambda s: 1.0 - ((s - 43.0) / 2.0) ** 2, t)
    assert visit == pytest.approx((41.0, 45.0), abs=1e-5)
    before, after = positive_intervals(lambda s: ((s - 43.0) / 2.0) ** 2 - 1.0, t)
    assert (before[1], after[0]) == pytest.approx((41.0, 45.0), abs=1e-5)
    assert positive_intervals(lambda s: -1e-3 - ((s - 43.0) / 2.0) ** 2, t) == []


def test_the_horizon_cuts_intervals() -> None:
    assert positive_intervals(np.ones_like, np.array([0.0, 5.0, 9.0])) == [(0.0, 9.0)]
    assert maximum_in(lambda t: -((t - 3.3) ** 2), 0.0, 9.0) == pytest.approx(0.0, abs=1e-9)


def test_contacts_hold_at_a_tenth_of_a_second_and_nowhere_else(orbit: Ephemeris) -> None:
    """A dense scan of the elevation agrees with every contact, its edges and its peak."""
    dense = np.arange(0.0, 86400.0, 0.5)
    position, _ = orbit.states(dense)
    for station in STATIONS:
        elevation = np.degrees(np.arcsin(sine_elevation(position, station)))
        inside = np.zeros(len(dense), dtype=bool)
        for contact in find_contacts(orbit, [station], 86400.0):
            during = (dense >= contact.start_s) & (dense <= contact.end_s)
            inside |= during
            assert abs(elevation[during].max() - contact.max_elevation_deg) < 0.02
        assert np.array_equal(inside, elevation > station.mask_deg)


def test_edges_do_not_depend_on_the_sampling_of_the_ephemeris(orbit: Ephemeris) -> None:
    fine = resample(orbit, 1.0, 86401)
    for a, b in zip(find_contacts(orbit, STATIONS, 86400.0), find_contacts(fine, STATIONS, 86400.0), strict=True):
        assert (a.start_s, a.end_s) == pytest.approx((b.start_s, b.end_s), abs=1e-3)


def test_up_is_the_ellipsoids_normal_for_both_datums() -> None:
    geodetic = Station("g", 45.0, 10.0, 0.0)
    assert sine_elevation(to_cartesian(np.array([45.0]), np.array([10.0]), 5e5), geodetic)[0] == pytest.approx(1.0)
    spherical = replace(geodetic, datum="spherical")
    assert np.linalg.norm(spherical.position_m()) == pytest.approx(SEMI_MAJOR_M)
    radial = spherical.position_m() / np.linalg.norm(spherical.position_m())
    assert np.degrees(np.arccos(radial @ spherical.axes()[2])) == pytest.approx(0.19, abs=0.01)
    assert np.linalg.norm(spherical.position_m() - geodetic.position_m()) > 10_000.0  # what a mixed-up datum costs


def test_a_station_at_the_pole_needs_no_longitude() -> None:
    """A polar orbit passes it once a revolution whatever longitude is written."""
    rate = 2.0 * np.pi / 5700.0
    t = np.arange(0.0, 22801.0, 10.0)
    zeros = np.zeros_like(t)
    circle = np.stack([np.cos(rate * t), zeros, np.sin(rate * t)], axis=1)
    turn = rate * np.stack([-np.sin(rate * t), zeros, np.cos(rate * t)], axis=1)
    polar = Ephemeris("P", START, 10.0, 6.9e6 * circle, 6.9e6 * turn)
    contacts = [find_contacts(polar, [Station("pole", 90.0, longitude, 0.0)], 22800.0) for longitude in (0.0, 137.0)]
    assert len(contacts[0]) == 4
    assert contacts[0] == contacts[1]
    assert contacts[0][0].max_elevation_deg == pytest.approx(90.0, abs=1e-4)
    half = np.radians(90.0 - 7.0) - np.arcsin(SEMI_MINOR_M * np.cos(np.radians(7.0)) / 6.9e6)
    assert contacts[0][0].end_s - contacts[0][0].start_s == pytest.approx(2.0 * half / rate, abs=0.01)


def test_a_station_that_is_no_place_is_refused() -> None:
    for bad in ({"latitude_deg": 90.5}, {"height_m": float("nan")}, {"mask_deg": 90.0}):
        with pytest.raises(DomainError, match="Station hawaii"):
            replace(STATIONS[0], **bad)


def test_up_may_be_the_direction_from_the_centre() -> None:
    """At 45 degrees the two differ by 0.19 degrees towards the pole; elevations to the north and south by that."""
    normal = Station("s", 45.0, 10.0, 0.0, up="geodetic")
    radial = replace(normal, up="spherical")
    north = to_cartesian(np.array([50.0]), np.array([10.0]), 5e5)
    south = to_cartesian(np.array([40.0]), np.array([10.0]), 5e5)
    for place, sign in ((north, -1.0), (south, 1.0)):
        tilt = np.degrees(np.arcsin(sine_elevation(place, normal)) - np.arcsin(sine_elevation(place, radial)))
        assert tilt[0] == pytest.approx(sign * -0.1924, abs=0.001)
    equator = Station("e", 0.0, 0.0, 0.0, up="spherical")
    assert np.allclose(equator.axes(), replace(equator, up="geodetic").axes())


@pytest.mark.parametrize(
    ("latitude", "longitude", "expected"), [(46, 10, 0), (45, 11, 90), (44, 10, 180), (45, 9, 270)]
)
def test_azimuths_run_from_north_over_east(latitude: float, longitude: float, expected: float) -> None:
    station = Station("s", 45.0, 10.0, 0.0)
    place = to_cartesian(np.array([float(latitude)]), np.array([float(longitude)]), 1e5)
    assert (azimuth_deg(place, station)[0] - expected + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.5)


def test_a_mask_by_azimuth_is_linear_and_goes_around() -> None:
    mask = AzimuthMask.parse("10:5 100:20, 350:9", "s")
    at = np.array([10.0, 55.0, 100.0, 0.0, 350.0, 360.0])
    assert np.allclose(mask.elevation_deg(at), [5.0, 12.5, 20.0, 7.0, 9.0, 7.0])


@pytest.mark.parametrize(
    "text", ["", "0:7 0:8", "0:7 20:-1", "0:7 400:3", "90", "north:7", "0:7 90:95", "90:5 0:5", "0:nan"]
)
def test_a_broken_mask_names_station_and_pair(text: str) -> None:
    with pytest.raises(DomainError, match="station hawaii") as caught:
        AzimuthMask.parse(text, "hawaii")
    assert caught.value.field == "azimuth_mask"


def test_contacts_over_a_horizon_by_azimuth_agree_with_a_dense_scan(orbit: Ephemeris) -> None:
    """A jagged horizon, higher and lower than the plain mask: a scan at 0.05 s finds the same contacts."""
    mask = AzimuthMask.parse("0:3 40:25 41:3 130:10 170:30 190:4 260:15 275:45 300:6", "s")
    for station in (replace(each, azimuth_mask=mask) for each in STATIONS):
        contacts = find_contacts(orbit, [station], 86400.0)
        dense = np.concatenate(
            [
                np.arange(c.start_s + 0.01, c.end_s - 0.01, 0.05)
                for c in find_contacts(orbit, [replace(station, azimuth_mask=None)], 86400.0)
            ]
        )
        position, _ = orbit.states(dense)
        elevation = np.degrees(np.arcsin(sine_elevation(position, station)))
        azimuth = azimuth_deg(position, station)
        over = (elevation > station.mask_deg) & (elevation > mask.elevation_deg(azimuth))
        inside = np.zeros(len(dense), dtype=bool)
        for contact in contacts:
            inside |= (dense >= contact.start_s) & (dense <= contact.end_s)
            assert contact.max_elevation_deg >= station.mask_deg
        assert np.array_equal(inside, over)
        assert 0 < over.sum() < len(over)


def test_a_level_horizon_by_azimuth_is_the_plain_mask(orbit: Ephemeris) -> None:
    plain = Station("s", 19.0, -155.65, 367.0, 12.0)
    level = replace(plain, mask_deg=5.0, azimuth_mask=AzimuthMask((0.0, 180.0), (12.0, 12.0)))
    for a, b in zip(find_contacts(orbit, [plain], 86400.0), find_contacts(orbit, [level], 86400.0), strict=True):
        assert (a.start_s, a.end_s) == pytest.approx((b.start_s, b.end_s), abs=1e-5)


def test_contacts_are_parted_by_their_length(orbit: Ephemeris) -> None:
    every = find_contacts(orbit, STATIONS, 86400.0)
    length = sorted(contact.end_s - contact.start_s for contact in every)[3]
    long, short = part_by_duration(every, length)
    assert len(short) == 3 and len(long) == len(every) - 3
    assert part_by_duration(every, 0.0) == (every, [])


def test_stations_are_made_from_rows_and_the_bad_row_is_named() -> None:
    row = {
        "station": "a",
        "latitude_deg": 1.0,
        "longitude_deg": 2.0,
        "height_m": 3.0,
        "mask_deg": 4.0,
        "datum": "spherical",
    }
    plain, own = stations_from([row, {**row, "station": "b", "up": "spherical", "azimuth_mask": "0:5 90:6"}])
    assert plain == Station("a", 1.0, 2.0, 3.0, 4.0, "spherical") and plain.azimuth_mask is None
    assert own.up == "spherical" and own.azimuth_mask == AzimuthMask((0.0, 90.0), (5.0, 6.0))
    for change in ({"mask_deg": 90.0}, {"azimuth_mask": "0:5 0:6"}):
        with pytest.raises(DomainError, match="row 1 of the stations"):
            stations_from([row, {**row, "station": "b", **change}])


def test_contacts_agree_with_gmat(real_data: Path) -> None:
    differences = gmat_contact_differences_s(real_data / "events/gmat_cygfm01")
    assert differences.shape == (9, 2)
    assert np.abs(differences).max() < 0.02


def test_eclipses_agree_with_gmat(real_data: Path) -> None:
    differences = gmat_eclipse_differences_s(real_data / "events/gmat_cygfm01")
    assert differences.shape == (23, 2)
    assert np.abs(differences).max() < 0.2


@pytest.mark.parametrize(
    ("when", "longitude_deg"),
    [
        (datetime(2024, 12, 21, 9, 20, 30, tzinfo=UTC), 270.0),
        (datetime(2025, 6, 21, 2, 42, 15, tzinfo=UTC), 90.0),
        (datetime(2025, 9, 22, 18, 19, 19, tzinfo=UTC), 180.0),
        (datetime(2026, 3, 20, 14, 46, tzinfo=UTC), 0.0),
    ],
)
def test_the_sun_is_where_equinoxes_and_solstices_put_it(when: datetime, longitude_deg: float) -> None:
    """Published minutes of the seasons: the Sun moves 0.0004 degrees in half of one."""
    orientation = orientation_at(when)
    x, y, z = sun_position_itrf(np.zeros(1), orientation)[0]
    tt, ut1 = orientation.days_tt(np.zeros(1))[0], orientation.days_ut1(np.zeros(1))[0]
    turn = erfa.gst06a(J2000_JD, ut1, J2000_JD, tt)
    obliquity = erfa.obl06(J2000_JD, tt) + erfa.nut06a(J2000_JD, tt)[1]
    inertial_x, inertial_y = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    longitude = np.degrees(np.arctan2(inertial_y * np.cos(obliquity) + z * np.sin(obliquity), inertial_x))
    assert abs((longitude - longitude_deg + 180.0) % 360.0 - 180.0) < 0.0004


def test_the_sun_between_its_nodes_is_the_sun() -> None:
    orientation = orientation_at(START, 86400.0)
    t_s = np.arange(0.0, 86400.0, 977.0)
    exact, curve = sun_position_itrf(t_s, orientation), sun_curve(orientation, 86400.0)(t_s)
    assert np.linalg.norm(exact - curve, axis=1).max() / 1.5e11 < 1e-8  # radians


def test_shadow_of_a_satellite_behind_the_equator_is_the_textbook_cone() -> None:
    """Sun along -x at 1 au, satellite at (r, y, 0): the umbra's edge lies at R - tan(a) r, sin(a) = (Rs - R) / d."""
    distance = 1.496e11
    sun = np.array([[-distance, 0.0, 0.0]])
    for sign, depth in ((-1.0, 1), (1.0, 0)):  # the umbra narrows, the penumbra widens
        slope = np.arcsin((SUN_RADIUS_M + sign * SEMI_MAJOR_M) / distance)
        edge = (SEMI_MAJOR_M + sign * np.sin(slope) * 6.9e6) / np.cos(slope)
        inside, outside = (
            shadow_depths_rad(np.array([[6.9e6, edge + step, 0.0]]), sun)[depth][0] for step in (-50.0, 50.0)
        )
        assert inside > 0.0 > outside


def test_the_flattened_earth_throws_a_flattened_shadow() -> None:
    sun = np.array([[-1.496e11, 0.0, 0.0]])
    over_pole = np.array([[1e6, 0.0, SEMI_MINOR_M + 8e3]])
    over_equator = np.array([[1e6, SEMI_MINOR_M + 8e3, 0.0]])
    assert shadow_depths_rad(over_pole, sun)[0][0] < 0.0 < shadow_depths_rad(over_equator, sun)[1][0]


def test_eclipses_come_in_order_and_do_not_overlap(orbit: Ephemeris) -> None:
    rows = find_eclipses(orbit, 86400.0)
    umbra = [row for row in rows if row.kind == "umbra"]
    assert 14 <= len(umbra) <= 17
    assert all(a.end_s <= b.start_s + 1e-5 for a, b in itertools.pairwise(rows))
    assert all(1500.0 < row.end_s - row.start_s < 2200.0 for row in umbra[1:-1])
    assert all(row.end_s - row.start_s < 60.0 for row in rows if row.kind == "penumbra")
