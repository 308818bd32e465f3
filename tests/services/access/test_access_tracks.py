"""Tracks of a real receiver: the same points as pair by pair, four best channels, nothing lost by skipping."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from services.access.ellipsoid import to_cartesian
from services.access.orbits.ephemeris import Ephemeris, propagate, resample
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from services.access.specular.antenna import CYGNSS_BEAMS, BeamPair, body_axes
from services.access.specular.points import specular_points
from services.access.specular.reflection import SOLVED, beam_gain_dbi
from services.access.specular.tracks import Cap, SpecularTrack, specular_track
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS

COUNT = 5400


@pytest.fixture(scope="module")
def orbits() -> tuple[Ephemeris, list[Ephemeris]]:
    receiver = propagate(read_orbits(RECEIVERS), START, COUNT, 10.0)[0][0]
    named, _ = name_transmitters(read_orbits(TRANSMITTERS), START)
    return resample(receiver, 1.0, COUNT), propagate(named, START, COUNT, 60.0)[0]


@pytest.fixture(scope="module")
def track(orbits: tuple[Ephemeris, list[Ephemeris]]) -> SpecularTrack:
    return specular_track(*orbits, COUNT, 65.0, CYGNSS_BEAMS)


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
    part = specular_track(*orbits, COUNT, 65.0, CYGNSS_BEAMS, [cap])

    def near(some: SpecularTrack) -> np.ndarray:
        rows = np.linalg.norm(some.position_m - centre, axis=1) < 300e3
        return np.stack([some.time_index[rows], some.transmitter[rows], some.nominal[rows]])

    assert 0 < len(part) < 0.5 * len(track)
    assert np.array_equal(near(part), near(track))


def test_a_coarse_step_finds_the_same_points(orbits: tuple[Ephemeris, list[Ephemeris]], track: SpecularTrack) -> None:
    coarse = specular_track(resample(orbits[0], 60.0, COUNT // 60), orbits[1], COUNT // 60, 65.0, CYGNSS_BEAMS)
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


def test_beams_mirror_each_other_and_peak_where_they_point() -> None:
    parameters = BeamPair(floor_dbi=-30.0).parameters()
    lobe = parameters[2]

    def gain(across_rad: float, along_rad: float = 0.0) -> float:
        down = np.cos(across_rad) * np.cos(along_rad)
        return float(beam_gain_dbi(np.sin(along_rad), np.sin(across_rad) * np.cos(along_rad), down, parameters))

    assert gain(lobe) == pytest.approx(CYGNSS_BEAMS.peak_dbi)
    assert gain(-lobe) == pytest.approx(gain(lobe))
    for off in (-0.5, 0.5):
        assert gain(lobe + off * parameters[3]) == pytest.approx(CYGNSS_BEAMS.peak_dbi - 3.0)
    assert gain(0.3, 0.2) == pytest.approx(gain(0.3, -0.2))
    assert gain(0.3, 0.2) < gain(0.3)


def test_the_modelled_beam_follows_the_cygnss_map(real_data: Path) -> None:
    table = np.loadtxt(real_data / "gnssr/antenna/ddmi_starboard_gain.agm", delimiter=",")
    off_nadir, azimuth = np.radians(np.arange(18) * 5 + 2.5), np.radians(np.arange(24) * 15 + 7.5)
    differences = [
        beam_gain_dbi(np.sin(e) * np.cos(a), abs(np.sin(e) * np.sin(a)), np.cos(e), CYGNSS_BEAMS.parameters())
        - table[i, j]
        for i, e in enumerate(off_nadir)
        for j, a in enumerate(azimuth)
        if table[i, j] >= 10 and a > np.pi
    ]
    assert len(differences) > 40
    assert np.sqrt(np.mean(np.square(differences))) < 0.6
    assert np.abs(differences).max() < 1.5
