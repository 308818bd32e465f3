"""Antennas: the shipped table against its formula and CYGNSS's own map, mirrored beams, documents that are none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.access.specular.antenna import SHIPPED, antenna_system, elliptical_gain_dbi, shipped_antennas
from services.access.specular.reflection import gain_dbi
from shared.errors import DomainError

CYGNSS = shipped_antennas()


def _directions(count: int) -> np.ndarray:
    unit = np.random.default_rng(3).normal(size=(count, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return unit


def test_two_antennas_look_28_degrees_to_either_side_and_mirror_each_other() -> None:
    starboard, port = CYGNSS.antennas
    assert (starboard.tilt_deg, port.tilt_deg, CYGNSS.channels) == (28.0, -28.0, 4)
    forward, across, nadir = _directions(500).T
    left = port.gain_towards(forward, -across, nadir, -20.0)
    assert np.allclose(left, starboard.gain_towards(forward, across, nadir, -20.0))
    off = np.radians(np.arange(0, 70, 0.1))
    lobe = starboard.gain_towards(0 * off, np.sin(off), np.cos(off), 0.0)
    assert np.degrees(off[np.argmax(lobe)]) == pytest.approx(22.2, abs=1.0)  # the lobe leans back from the tilt
    assert lobe.max() == pytest.approx(15.2, abs=0.05)


def test_the_shipped_table_is_the_fitted_lobe() -> None:
    antenna = CYGNSS.antennas[0]
    formula = elliptical_gain_dbi(antenna.off_boresight_deg, antenna.azimuth_deg, 15.2, 5.8, 40.4, 27.2)
    assert np.abs(antenna.gain_dbi - np.maximum(formula, -20.0)).max() <= 0.005 + 1e-9


def test_the_compiled_lookup_is_the_better_antenna() -> None:
    unit = _directions(3000)
    down = unit[unit[:, 2] > 0.02]
    found = np.array([gain_dbi(*row, CYGNSS.table) for row in down])
    best = np.max([a.gain_towards(*down.T, CYGNSS.floor_dbi) for a in CYGNSS.antennas], axis=0)
    assert np.abs(found - best).max() < 0.15
    up = np.array([gain_dbi(*row, CYGNSS.table) for row in unit[unit[:, 2] < 0]])
    assert (up == CYGNSS.floor_dbi).all()


def test_the_shipped_beam_follows_the_cygnss_map(real_data: Path) -> None:
    table = np.loadtxt(real_data / "gnssr/antenna/ddmi_starboard_gain.agm", delimiter=",")
    off_nadir, azimuth = np.radians(np.arange(18) * 5 + 2.5), np.radians(np.arange(24) * 15 + 7.5)
    e, a = np.meshgrid(off_nadir, azimuth, indexing="ij")
    ours = CYGNSS.antennas[0].gain_towards(np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e), 0.0)
    strong = table >= 10
    difference = ours - table
    assert strong.sum() > 80
    assert np.sqrt(np.mean(difference[strong] ** 2)) < 0.5 and np.abs(difference[strong]).max() < 1.1
    seen = table >= 1
    assert np.sqrt(np.mean(difference[seen] ** 2)) < 0.8
    assert ((ours > 0) != (table > 0)).mean() < 0.03  # what is in the beam


@pytest.mark.parametrize(
    "change",
    [
        {"antennas": []},
        {"channels": 0},
        {"antennas": [{"name": "a", "tilt_deg": 0, "off_boresight_deg": [0, 5], "azimuth_deg": [0], "gain_dbi": [[1]]}]}
        | {"floor_dbi": -5.0},
        {"antennas": [{"name": "a", "tilt_deg": 0, "mirror_of": "nobody"}]},
        {"antennas": "none"},
        {"floor_dbi": None},
    ],
)
def test_documents_that_are_no_antenna_are_refused(change: dict[str, Any]) -> None:
    document = json.loads((SHIPPED / "cygnss.json").read_text())
    with pytest.raises(DomainError) as caught:
        antenna_system({**document, **change})
    assert caught.value.field == "antenna"
