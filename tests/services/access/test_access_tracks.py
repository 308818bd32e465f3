"""Tracks of a real receiver: the same points as pair by pair, four best channels, nothing lost by skipping."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial import cKDTree

from services.access import satellite
from services.access.coverage.grid import even_grid
from services.access.ellipsoid import chord_from_arc_m, to_cartesian
from services.access.orbits.ephemeris import Ephemeris, propagate, resample
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from services.access.prediction import AccessOptions, Horizon, predict
from services.access.satellite import SatelliteAccess
from services.access.specular.antenna import body_axes, shipped_antennas
from services.access.specular.points import specular_points
from services.access.specular.reflection import OCCULTED, SOLVED
from services.access.specular.roll import Roll, read_rolls
from services.access.specular.tracks import Cap, SpecularTrack, specular_track
from shared.errors import DomainError
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS

COUNT = 5400
CYGNSS = shipped_antennas()


@pytest.fixture(scope="module")
def orbits() -> tuple[Ephemeris, list[Ephemeris]]:
    receiver = propagate(read_orbits(RECEIVERS), START, COUNT, 10.0)[0][0]
    named, _ = name_transmitters(read_orbits(TRANSMITTERS), START)
    return resample(receiver, 1.0, COUNT), propagate(named, START, COUNT, 60.0)[0]


@pytest.fixture(scope="module")
def track(orbits: tuple[Ephemeris, list[Ephemeris]]) -> SpecularTrack:
    return specular_track(*orbits, COUNT, 65.0, CYGNSS)


def test_following_a_pair_gives_the_points_of_solving_it_alone(
    orbits: tuple[Ephemeris, list[Ephemeris]], track: SpecularTrack
) -> None:
    receiver, transmitters = orbits
    expected = 0
    for index, transmitter in enumerate(transmitters):
        alone = specular_points(receiver.position_m, transmitter.states(receiver.times_s)[0])
        within = (alone.status == SOLVED) & (alone.incidence_deg <= 65.0)
        mine = track.transmitter == index
        assert np.array_equal(track.time_index[mine], np.flatnonzero(within))
        assert np.abs(track.position_m[mine] - alone.position_m[within]).max(initial=0.0) < 1e-5
        assert np.abs(track.incidence_deg[mine] - alone.incidence_deg[within]).max(initial=0.0) < 1e-9
        expected += int(within.sum())
    assert len(track) == expected > 10_000
    assert track.mismatch_deg.max() < 1e-6


def test_nominal_channels_are_the_four_of_highest_gain(track: SpecularTrack) -> None:
    for step in range(0, COUNT, 61):
        at = np.flatnonzero(track.time_index == step)
        chosen = track.nominal[at]
        assert chosen.sum() == min(4, len(at))
        if chosen.any() and not chosen.all():
            assert track.rx_gain_dbi[at][chosen].min() >= track.rx_gain_dbi[at][~chosen].max()


def test_skipping_what_is_far_from_the_targets_loses_nothing_near_them(
    orbits: tuple[Ephemeris, list[Ephemeris]], track: SpecularTrack
) -> None:
    centre = track.position_m[len(track) // 2]
    cap = Cap.around(centre[np.newaxis], margin_m=300e3)
    part = specular_track(*orbits, COUNT, 65.0, CYGNSS, [cap])

    def near(some: SpecularTrack) -> np.ndarray:
        rows = np.linalg.norm(some.position_m - centre, axis=1) < 300e3
        return np.stack([some.time_index[rows], some.transmitter[rows], some.nominal[rows]])

    assert 0 < len(part) < 0.5 * len(track)
    assert np.array_equal(near(part), near(track))


def test_a_coarse_step_finds_the_same_points(orbits: tuple[Ephemeris, list[Ephemeris]], track: SpecularTrack) -> None:
    coarse = specular_track(resample(orbits[0], 60.0, COUNT // 60), orbits[1], COUNT // 60, 65.0, CYGNSS)
    same = track.time_index % 60 == 0
    assert np.array_equal(coarse.time_index * 60, track.time_index[same])
    assert np.abs(coarse.position_m - track.position_m[same]).max() < 1e-5


def test_a_cap_holds_its_points_and_the_globe_where_it_must() -> None:
    rng = np.random.default_rng(3)
    around_dateline = to_cartesian(rng.uniform(-20, -10, 50), rng.uniform(175, 185, 50))
    cap = Cap.around(around_dateline)
    unit = around_dateline / np.linalg.norm(around_dateline, axis=1, keepdims=True)
    assert np.degrees(cap.radius_rad) < 8.0
    assert (unit @ cap.centre >= np.cos(cap.radius_rad) - 1e-12).all()
    assert Cap.around(np.array([[1.0, 0, 0], [-1.0, 0, 0]])).radius_rad == np.pi


def test_body_axes_are_right_handed_and_look_down_and_forward(orbits: tuple[Ephemeris, list[Ephemeris]]) -> None:
    receiver = orbits[0]
    axes = body_axes(receiver.position_m, receiver.velocity_m_s)
    assert np.allclose(np.einsum("nij,nkj->nik", axes, axes), np.eye(3))
    assert np.allclose(np.cross(axes[:, 0], axes[:, 1]), axes[:, 2])
    speed = np.linalg.norm(receiver.velocity_m_s, axis=1)
    assert (np.einsum("ij,ij->i", axes[:, 0], receiver.velocity_m_s) > 0.99 * speed).all()


def test_every_pair_and_instant_is_accounted_for(
    orbits: tuple[Ephemeris, list[Ephemeris]], track: SpecularTrack
) -> None:
    receiver, transmitters = orbits
    status = np.concatenate(
        [specular_points(receiver.position_m, t.states(receiver.times_s)[0]).status for t in transmitters]
    )
    counts = track.counts
    assert counts.kept == len(track) and counts.skipped == 0 and counts.uncertified == 0
    assert counts.occulted == (status == OCCULTED).sum() > 1000
    assert counts.kept + counts.occulted + counts.beyond_limit == COUNT * len(transmitters)
    part = specular_track(*orbits, COUNT, 65.0, CYGNSS, [Cap.around(track.position_m[:1], margin_m=300e3)]).counts
    total = part.kept + part.occulted + part.beyond_limit + part.uncertified + part.skipped
    assert part.skipped > 0 and total == COUNT * len(transmitters)


def test_a_roll_moves_the_beams_and_not_the_points(
    orbits: tuple[Ephemeris, list[Ephemeris]], track: SpecularTrack
) -> None:
    """Each point's gain under a roll of +20 degrees is that of the antennas mounted 20 degrees further to port."""
    rolled = specular_track(*orbits, COUNT, 65.0, CYGNSS, roll=Roll(np.array([0.0, 60.0]), np.array([20.0, 20.0])))
    assert np.array_equal(rolled.position_m, track.position_m)
    tilted = replace(CYGNSS, antennas=tuple(replace(a, tilt_deg=a.tilt_deg - 20.0) for a in CYGNSS.antennas))
    mounted = specular_track(*orbits, COUNT, 65.0, tilted)
    assert np.abs(mounted.rx_gain_dbi - rolled.rx_gain_dbi).max() < 0.1  # the two tables interpolate apart
    assert np.abs(track.rx_gain_dbi - rolled.rx_gain_dbi).max() > 10.0
    ramp = specular_track(*orbits, COUNT, 65.0, CYGNSS, roll=Roll(np.array([0.0, COUNT]), np.array([0.0, 20.0])))
    early, late = track.time_index < 30, track.time_index > COUNT - 30
    assert np.abs(ramp.rx_gain_dbi[early] - track.rx_gain_dbi[early]).max() < 0.5
    assert np.abs(ramp.rx_gain_dbi[late] - rolled.rx_gain_dbi[late]).max() < 0.5


def test_body_axes_roll_starboard_down(orbits: tuple[Ephemeris, list[Ephemeris]]) -> None:
    receiver = orbits[0]
    level = body_axes(receiver.position_m[:5], receiver.velocity_m_s[:5])
    rolled = body_axes(receiver.position_m[:5], receiver.velocity_m_s[:5], np.full(5, 30.0))
    assert np.allclose(rolled[:, 0], level[:, 0])
    assert np.allclose(np.einsum("ni,ni->n", rolled[:, 1], level[:, 2]), 0.5)
    assert np.allclose(np.cross(rolled[:, 0], rolled[:, 1]), rolled[:, 2])


def test_in_beam_is_a_gain_over_the_floor(track: SpecularTrack) -> None:
    assert np.array_equal(track.in_beam, track.rx_gain_dbi > CYGNSS.floor_dbi)
    assert 0.3 < track.in_beam.mean() < 0.9


def test_rolls_are_read_by_row_and_held_beyond_their_ends() -> None:
    table = pd.DataFrame(
        {
            "satellite": ["CYGFM04"] * 3,
            "time": pd.to_datetime(["2022-12-04T00:01:00Z", "2022-12-04T00:00:00Z", "2022-12-04T00:02:00Z"]),
            "roll_deg": [10.0, 0.0, -10.0],
        }
    )
    roll = read_rolls(table, {"CYGFM04", "CYGFM05"}, START)["CYGFM04"]
    assert roll.at(np.array([-50.0, 30.0, 60.0, 90.0, 500.0])).tolist() == [0.0, 5.0, 10.0, 0.0, -10.0]


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"satellite": ["CYGFM04", "CYGFM99"]}, "row 1: CYGFM99 is not among"),
        ({"roll_deg": [0.0, 91.0]}, "row 1: time"),
        ({"roll_deg": [np.nan, 1.0]}, "row 0: time"),
        ({"time": ["2022-12-04", "2022-12-04"]}, "row 1: a second angle"),
        ({"time": ["yesterday", "never"]}, "cannot be read"),
    ],
)
def test_bad_rolls_are_named_by_row(change: dict[str, list[object]], what: str) -> None:
    rows = {"satellite": ["CYGFM04", "CYGFM04"], "time": ["2022-12-04", "2022-12-05"], "roll_deg": [0.0, 1.0]}
    with pytest.raises(DomainError, match=what) as caught:
        read_rolls(pd.DataFrame({**rows, **change}), {"CYGFM04"}, START)
    assert caught.value.field == "satellite_roll"
    with pytest.raises(DomainError, match="lacks the column roll_deg"):
        read_rolls(pd.DataFrame(rows).drop(columns="roll_deg"), {"CYGFM04"}, START)


def test_stretches_of_the_horizon_make_up_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = tuple(x.ravel() for x in np.meshgrid(np.arange(-30.0, 31.0, 6.0), np.arange(-180.0, 180.0, 6.0)))
    options = AccessOptions(100.0, with_specular_points=True)
    grid = even_grid(5.0, land_only=True)
    roll = {"CYGFM04": Roll(np.array([0.0, 7200.0]), np.array([0.0, 20.0]))}

    def first_receiver() -> SatelliteAccess:
        orbits = read_orbits(RECEIVERS), read_orbits(TRANSMITTERS)
        return predict(*orbits, [], targets, Horizon(START, 7200, 2), options, grid=grid, rolls=roll).satellites[0]

    whole = first_receiver()
    monkeypatch.setattr(satellite, "PART_STEPS", 1000)
    parts = first_receiver()
    assert whole.track is not None and parts.track is not None and len(whole.track) > 5000
    assert np.abs(whole.track.position_m - parts.track.position_m).max() < 1e-4
    assert np.abs(whole.track.rx_gain_dbi - parts.track.rx_gain_dbi).max() < 1e-6
    assert np.array_equal(whole.track.nominal, parts.track.nominal)
    assert whole.counts == parts.counts
    for one, other in ((whole.targets, parts.targets), (whole.cells, parts.cells)):
        assert one is not None and other is not None and one.count > 30
        assert (one.count, one.images) == (other.count, other.images)
        for name in ("time_index", "row", "transmitter"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
        assert np.array_equal(one.visits.end_s, other.visits.end_s)
        assert np.allclose(one.nearest_km, other.nearest_km, atol=1e-3)
    assert whole.targets is not None and parts.targets is not None and whole.targets.ahead is not None
    assert np.array_equal(whole.targets.ahead, parts.targets.ahead)


def test_targets_at_the_poles_lose_nothing_to_skipping() -> None:
    """A polar orbit over targets around both poles and the dateline: with what is far skipped, and with all solved."""
    rows = json.dumps(
        [
            {
                "OBJECT_NAME": "POLAR", "NORAD_CAT_ID": 90001, "EPOCH": START.strftime("%Y-%m-%dT%H:%M:%S"),
                "MEAN_MOTION": 15.2, "ECCENTRICITY": 0.001, "INCLINATION": 88.0, "RA_OF_ASC_NODE": 10.0,
                "ARG_OF_PERICENTER": 0.0, "MEAN_ANOMALY": 0.0, "BSTAR": 0.0, "MEAN_MOTION_DOT": 0.0,
                "MEAN_MOTION_DDOT": 0.0,
            }
        ]
    )  # fmt: skip
    rng = np.random.default_rng(6)
    latitude = np.concatenate([rng.uniform(80, 90, 400), rng.uniform(-90, -80, 400), [90.0, -90.0]])
    longitude = rng.uniform(-180, 180, 802)
    horizon, orbits = Horizon(START, 12_000, 2), (read_orbits(rows), read_orbits(TRANSMITTERS))
    few = predict(*orbits, [], (latitude, longitude), horizon, AccessOptions(25.0)).satellites[0]
    every = predict(
        *orbits, [], (latitude, longitude), horizon, AccessOptions(25.0, with_specular_points=True)
    ).satellites[0]
    assert few.counts.skipped > 0 and every.counts.skipped == 0
    assert few.targets is not None and every.targets is not None and every.track is not None
    assert few.targets.count == every.targets.count > 100
    assert np.array_equal(few.targets.row, every.targets.row)
    used = every.track.where(every.track.in_beam)
    place = to_cartesian(latitude, longitude)
    near = cKDTree(used.position_m).query_ball_point(place, chord_from_arc_m(25_000.0))
    expected = {(int(used.time_index[k]), row) for row, points in enumerate(near) for k in points}
    assert expected == set(zip(every.targets.time_index.tolist(), every.targets.row.tolist(), strict=True))
