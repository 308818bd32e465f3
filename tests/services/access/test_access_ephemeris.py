"""Orbits between their nodes, at their ends, against IGS, and when SGP4 gives up."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from services.access.ellipsoid import to_cartesian, to_geodetic
from services.access.orbits.ephemeris import RECEIVER_NODE_S, TRANSMITTER_NODE_S, propagate, resample
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from shared.errors import DomainError
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS
from tests.services.access.truth import gps_sp3_distances_km


@pytest.mark.parametrize(
    ("text", "node_s", "bound_m"), [(RECEIVERS, RECEIVER_NODE_S, 0.05), (TRANSMITTERS, TRANSMITTER_NODE_S, 0.25)]
)
def test_interpolation_stays_far_below_a_metre(text: str, node_s: float, bound_m: float) -> None:
    elements = read_orbits(text)
    coarse, _ = propagate(elements, START, 86400.0, node_s)
    fine, _ = propagate(elements, START, 86400.0, node_s / 4)
    for a, b in zip(coarse, fine, strict=True):
        between = b.times_s < 86400.0
        position, velocity = a.states(b.times_s[between])
        assert np.linalg.norm(position - b.position_m[between], axis=1).max() < bound_m
        assert np.linalg.norm(velocity - b.velocity_m_s[between], axis=1).max() < 0.1


def test_the_orbit_does_not_depend_on_where_the_horizon_starts() -> None:
    """Earth orientation is held over a horizon: a day later the same instant moves by less than a metre."""
    elements = read_orbits(RECEIVERS)
    early, _ = propagate(elements, START, 86400.0, 10.0)
    late, _ = propagate(elements, START + timedelta(hours=12), 43200.0, 10.0)
    at = np.arange(0.0, 43200.0, 97.0)
    assert np.linalg.norm(early[0].states(at + 43200.0)[0] - late[0].states(at)[0], axis=1).max() < 1.0


def test_time_beyond_the_ephemeris_is_refused() -> None:
    orbit = propagate(read_orbits(RECEIVERS), START, 600.0, 10.0)[0][0]
    with pytest.raises(DomainError, match="beyond the ephemeris"):
        orbit.states(np.array([5.0, 700.0]))
    assert np.allclose(resample(orbit, 20.0, 31).position_m, orbit.position_m[:62:2])


def test_a_decayed_satellite_is_left_out_with_the_reason() -> None:
    elements = read_orbits(RECEIVERS)
    elements[0].record.sgp4init(  # the same orbit with a drag that brings it down within the day
        0, "i", 41884, elements[0].record.jdsatepoch + elements[0].record.jdsatepochF - 2433281.5,
        0.1, 0.0, 0.0, 0.0014, 3.07, 0.61, 3.2, 0.0718, 3.92,
    )  # fmt: skip
    kept, dropped = propagate(elements, START, 86400.0, 10.0)
    assert [orbit.name for orbit in kept] == ["CYGFM04"]
    assert "SGP4 fails" in dropped["CYGFM05"]


def test_gps_lies_where_igs_says_within_what_elements_give(real_data: Path) -> None:
    distances = np.concatenate(list(gps_sp3_distances_km(real_data).values()))
    assert len(distances) == 31 * 96
    assert np.median(distances) < 1.5
    assert distances.max() < 5.0


def test_geodetic_coordinates_return() -> None:
    rng = np.random.default_rng(7)
    latitude, longitude = np.degrees(np.arcsin(rng.uniform(-1, 1, 2000))), rng.uniform(-180, 180, 2000)
    latitude[:4], height = [90.0, -90.0, 0.0, 89.9999999], rng.uniform(-400, 2.1e7, 2000)
    back = to_geodetic(to_cartesian(latitude, longitude, height))
    assert np.abs(back[0] - latitude).max() < 1e-9
    assert np.abs((back[1] - longitude)[2:]).max() < 1e-7
    assert np.abs(back[2] - height).max() < 1e-6


def test_all_transmitters_stay_at_their_height() -> None:
    orbits, _ = propagate(name_transmitters(read_orbits(TRANSMITTERS), START)[0], START, 43200.0, 60.0)
    for orbit in orbits:
        radius = np.linalg.norm(orbit.position_m, axis=1)
        assert radius.min() > 25.9e6 and radius.max() < 27.2e6
