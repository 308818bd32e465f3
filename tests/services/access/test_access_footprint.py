"""Footprints against the path itself and against finite differences; robustness against solving a late satellite."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pytest

from services.access.coverage.robustness import AlongTrackError, along_track_error_km, expected_error
from services.access.ellipsoid import arc_from_chord_m, to_cartesian, to_geodetic, up_vector
from services.access.orbits.elements import ElementSet
from services.access.orbits.ephemeris import Ephemeris, propagate, resample
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from services.access.prediction import AccessOptions, Horizon, predict, prepare_access
from services.access.satellite import satellite_access
from services.access.specular.antenna import shipped_antennas
from services.access.specular.footprint import WAVELENGTH_M, footprints
from services.access.specular.points import specular_points
from services.access.specular.tracks import SpecularTrack, specular_track
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS

Orbits = tuple[Ephemeris, list[Ephemeris]]
COUNT = 1800


@pytest.fixture(scope="module")
def orbits() -> Orbits:
    receiver = propagate(read_orbits(RECEIVERS), START, COUNT, 10.0)[0][0]
    named, _ = name_transmitters(read_orbits(TRANSMITTERS), START)
    return resample(receiver, 1.0, COUNT), propagate(named, START, COUNT, 60.0)[0]


@pytest.fixture(scope="module")
def track(orbits: Orbits) -> SpecularTrack:
    found = specular_track(*orbits, COUNT, 65.0, shipped_antennas())
    rows = np.zeros(len(found), dtype=bool)
    rows[:: max(len(found) // 300, 1)] = True
    return found.where(rows & (found.time_index < COUNT - 2))


def _states(orbits: Orbits, track: SpecularTrack, delay_s: float = 0.0) -> tuple[tuple, tuple]:
    t_s = track.time_index + delay_s
    r = orbits[0].states(t_s)
    t = [orbits[1][j].states(np.array([s])) for j, s in zip(track.transmitter, t_s, strict=True)]
    return r, (np.concatenate([a for a, _ in t]), np.concatenate([b for _, b in t]))


def _frame(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    latitude, longitude, _ = to_geodetic(point)
    up = up_vector(latitude, longitude)
    east = np.stack([-np.sin(np.radians(longitude)), np.cos(np.radians(longitude)), 0 * longitude], axis=-1)
    return east, np.cross(up, east)


def test_the_rim_of_the_fresnel_zone_is_half_a_wavelength_longer(orbits: Orbits, track: SpecularTrack) -> None:
    receiver, transmitter = _states(orbits, track)
    zones = footprints(track.position_m, receiver, transmitter)
    east, north = _frame(track.position_m)
    for angle in np.linspace(0, 2 * np.pi, 9)[:-1]:
        circle = np.array([np.cos(angle), np.sin(angle)])
        n = circle[1] / zones.shape[:, 2]
        e = (circle[0] - zones.shape[:, 1] * n) / zones.shape[:, 0]
        rim = track.position_m + e[:, None] * east + n[:, None] * north
        latitude, longitude, _ = to_geodetic(rim)
        rim = to_cartesian(latitude, longitude)  # back down on the ellipsoid
        path = np.linalg.norm(rim - receiver[0], axis=1) + np.linalg.norm(rim - transmitter[0], axis=1)
        longer = path - track.rx_range_m - track.tx_range_m
        assert np.abs(longer / (WAVELENGTH_M / 2) - 1.0).max() < 0.03


def test_the_zone_stretches_with_incidence(orbits: Orbits, track: SpecularTrack) -> None:
    zones = footprints(track.position_m, *_states(orbits, track))
    axes = zones.semi_axes_m()
    plane = np.sqrt(WAVELENGTH_M * track.rx_range_m * track.tx_range_m / (track.rx_range_m + track.tx_range_m))
    cosine = np.cos(np.radians(track.incidence_deg))
    assert (axes[:, 1] <= plane).all() and (axes[:, 1] > 0.85 * plane).all()  # the curved Earth narrows it
    assert np.abs(axes[:, 0] / axes[:, 1] * cosine - 1.0).max() < 0.2
    assert 250 < axes[:, 1].min() < axes[:, 1].max() < 500


def test_the_motion_is_where_the_point_lies_a_second_later(orbits: Orbits, track: SpecularTrack) -> None:
    zones = footprints(track.position_m, *_states(orbits, track))
    before, after = (_states(orbits, track, delay) for delay in (0.0, 1.0))
    start = specular_points(before[0][0], before[1][0]).position_m
    end = specular_points(after[0][0], after[1][0]).position_m
    east, north = _frame(start)
    moved = np.stack([((end - start) * east).sum(axis=1), ((end - start) * north).sum(axis=1)], axis=1)
    assert np.abs(zones.shape[:, 3:] - moved).max() < 15.0
    assert 4000 < np.linalg.norm(moved, axis=1).min() < np.linalg.norm(moved, axis=1).max() < 9000


def test_footprints_at_a_height_keep_the_half_wavelength(orbits: Orbits, track: SpecularTrack) -> None:
    receiver, transmitter = _states(orbits, track)
    found = specular_points(receiver[0], transmitter[0], 3000.0)
    high = footprints(found.position_m, receiver, transmitter, 3000.0).semi_axes_m()[:, 1]
    low = footprints(track.position_m, receiver, transmitter).semi_axes_m()[:, 1]
    assert (high < low).all() and (high > 0.99 * low).all()  # nearer to the receiver by 3 of 520 km


def test_the_error_grows_with_age_and_drag() -> None:
    ages = np.array([0.0, 1.0, 7.0, -7.0])
    calm = along_track_error_km(ages, 15.17, 0.0)
    assert calm.tolist() == pytest.approx([1.0, 2.0, 8.0, 8.0])
    # n'/2 of 3e-5 rev/day^2 moves a satellite by 2 pi 6892 km x 3e-5 = 1.3 km in a day, 63.7 km in seven
    dragged = along_track_error_km(ages, 15.17, 3e-5)
    assert (dragged - calm).tolist() == pytest.approx([0.0, 0.26, 12.7, 12.7], rel=0.01)


def test_the_error_law_reads_the_elements() -> None:
    element = read_orbits(RECEIVERS)[1]
    assert isinstance(element, ElementSet)
    law = expected_error(element, START, None)
    assert law is not None
    assert law.mean_motion_rev_day == pytest.approx(15.1799, abs=0.01)
    assert law.half_rate_rev_day2 == pytest.approx(0.00003008, rel=1e-3)
    assert law.age_days == pytest.approx(0.2763, abs=1e-3)
    given = expected_error(element, START, 12.5)
    assert given is not None and given.at(np.zeros(2)).tolist() == [12.5, 12.5]
    later = expected_error(element, START + timedelta(days=5), None)
    assert later is not None and later.at(np.zeros(1))[0] > law.at(np.zeros(1))[0]
    assert AlongTrackError().at(np.array([86400.0]))[0] == pytest.approx(2.0)


@pytest.mark.parametrize("mode", ["raw-if", "nominal"])
def test_robust_rows_are_those_that_a_late_satellite_still_covers(mode: str) -> None:
    """Ahead by e: the receiver as it is e/v seconds later, turned back by the Earth's rotation; solved pair by pair."""
    error_km, radius_km = 12.0, 40.0
    rng = np.random.default_rng(4)
    latitude, longitude = rng.uniform(-34, 34, 4000), rng.uniform(-180, 180, 4000)
    options = AccessOptions(radius_km, mode=mode, along_track_error_km=error_km)  # type: ignore[arg-type]
    receivers, transmitters = read_orbits(RECEIVERS), read_orbits(TRANSMITTERS)
    horizon = Horizon(START, COUNT)
    found = predict(receivers, transmitters, [], (latitude, longitude), horizon, options).satellites[0]
    seen = found.targets
    assert seen is not None and seen.ahead is not None and seen.behind is not None
    assert np.allclose(seen.error_km, error_km)
    orbit = next(o for o in propagate(receivers, START, COUNT + 60, 10.0)[0] if o.name == found.satellite)
    named, _ = name_transmitters(transmitters, START)
    others = propagate(named, START, COUNT, 60.0)[0]
    place = to_cartesian(latitude, longitude)
    middle = np.flatnonzero((seen.time_index > 10) & (seen.time_index < COUNT - 10))
    sample = rng.choice(middle, 150, replace=False)
    agree = []
    for sign, flags in ((1.0, seen.ahead), (-1.0, seen.behind)):
        for row in sample:
            t = float(seen.time_index[row])
            _, velocity = orbit.states(np.array([t]))
            delay = sign * error_km * 1000.0 / (np.linalg.norm(velocity) * 1.065)  # inertial speed, prograde at 35 deg
            moved, speed = orbit.states(np.array([t + delay]))
            turn = 7.2921159e-5 * delay
            spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
            late = Ephemeris("late", START, 1.0, moved @ spin.T, speed @ spin.T)
            fixed = [Ephemeris(o.name, START, 1.0, *o.states(np.full(2, t))) for o in others]
            track = specular_track(late, fixed, 1, 65.0, shipped_antennas())
            use = track.nominal if mode == "nominal" else track.in_beam
            chord = np.linalg.norm(track.position_m[use] - place[seen.row[row]], axis=1)
            nearest = arc_from_chord_m(chord).min(initial=np.inf) / 1000.0
            if abs(nearest - radius_km) > 1.0:  # the delay is the error only to some per cent
                agree.append((nearest <= radius_km) == flags[row])
    assert len(agree) > 200 and np.mean(agree) > 0.97
    assert 0.3 < seen.ahead.mean() < 0.95 and 0.3 < seen.behind.mean() < 0.95


def test_an_error_of_nothing_loses_nothing_and_an_unknown_one_says_nothing() -> None:
    receivers, transmitters = read_orbits(RECEIVERS), read_orbits(TRANSMITTERS)
    targets = tuple(x.ravel() for x in np.meshgrid(np.arange(-30.0, 31.0, 10.0), np.arange(-180.0, 180.0, 20.0)))
    options = AccessOptions(200.0, along_track_error_km=0.0)
    access = predict(receivers, transmitters, [], targets, Horizon(START, 7200), options)
    rows = 0
    for found in access.satellites:
        assert found.targets is not None and found.targets.ahead is not None and found.targets.behind is not None
        assert found.targets.ahead.all() and found.targets.behind.all()
        rows += len(found.targets.row)
    assert rows > 50
    scene = prepare_access(receivers, transmitters, [], targets, Horizon(START, 7200), options)[1][0]
    unknown = satellite_access(scene[0], None, None, scene[3]).targets
    assert unknown is not None and unknown.ahead is None and unknown.error_km is None
