"""Pictures of one fire: frames that follow the fire, words that tell no look from no fire, the same bytes again."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from services.arrival.exports.isochrones import levels
from services.arrival.figures.animation import draw_animation
from services.arrival.figures.axes import place_of, solar_clock
from services.arrival.figures.front_map import draw_front
from services.arrival.figures.information_map import _title, draw_information
from services.arrival.fires import FireCase
from services.arrival.front.forecast import forecast_front
from services.arrival.looks import FIRE, VIIRS, Ignition, Looks
from services.arrival.sight import Passes, sight_of
from tests.services.arrival.exports.made_maps import REFERENCE, round_fire

ATTRIBUTES = {"simulated": True, "simulated_share": 1.0, "oldest_input": "2022-06-01", "code_version": "x"}


def _case(longitude_deg: float = -106.0) -> FireCase:
    made = round_fire(longitude_deg)
    values = np.array([-1.0, 0.5, 2.0]), np.array([0.0, 1.0, -1.0]), np.array([4.0, 8.0, 12.0])
    kinds = np.full(3, FIRE, np.int8), np.full(3, VIIRS, np.int8)
    looks = Looks(*values, *kinds, np.ones(3), np.full(3, 0.2), np.full(3, 0.2))
    return FireCase("a", "Round", REFERENCE, made.grid, looks, Ignition(0.0), 24.0)


def test_a_film_has_a_frame_an_isochrone_and_grows(tmp_path: Path) -> None:
    made, case = round_fire(), _case()
    for name in ("a.gif", "b.gif"):
        assert draw_animation(tmp_path / name, made, case.looks, REFERENCE, "Round", ATTRIBUTES)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == levels(made.arrival_h, REFERENCE).size
        painted = []
        for index in range(film.n_frames):
            film.seek(index)
            rgb = np.asarray(film.convert("RGB")).astype(int)
            painted.append(int((rgb[..., 0] - rgb[..., 2] > 60).sum()))  # yellow to red
    assert painted[-1] > 3 * painted[2] > 0
    assert all(later >= earlier - 30 for earlier, later in pairwise(painted))


def test_nothing_burned_makes_no_film(tmp_path: Path) -> None:
    made = replace(round_fire(), arrival_h=np.full(round_fire().arrival_h.shape, np.nan))
    assert not draw_animation(tmp_path / "a.gif", made, _case().looks, REFERENCE, "Round", ATTRIBUTES)
    assert not (tmp_path / "a.gif").exists()


def test_title_says_how_old_the_latest_look_is_and_the_local_time() -> None:
    made, case = round_fire(), _case()
    title = _title(case, sight_of(made), -106.0)
    assert "02 Jun 18:00 UTC (02 Jun 10:56 local solar time)" in title and "3.0 h before" in title
    blind = sight_of(replace(made, evidence=replace(made.evidence, information=np.zeros(made.grid.shape, np.uint8))))
    assert "nothing is known" in _title(case, blind, -106.0)


def test_local_solar_time() -> None:
    noon = pd.Timestamp("2022-06-01T12:00Z")
    assert solar_clock(noon, 0.0) == "01 Jun 12:00" and solar_clock(noon, 180.0) == "02 Jun 00:00"
    assert solar_clock(noon, -105.0) == "01 Jun 05:00"


@pytest.mark.parametrize("longitude", [-106.0, 180.0])
def test_maps_are_drawn_in_one_piece_with_distinct_colours(tmp_path: Path, longitude: float) -> None:
    made, case = round_fire(longitude), _case(longitude)
    span = place_of(made).longitude
    assert np.ptp(span) < 0.5, "continuous across the antimeridian"
    x, _ = made.grid.cell_centres_km()
    sight = sight_of(made, Passes(np.full(x.shape, np.nan), np.where(x > 9.0, 20.0, np.nan)))
    draw_information(tmp_path / "i.png", case, made, sight, ATTRIBUTES)
    draw_front(tmp_path / "f.png", case, made, forecast_front(made, 24.0), ATTRIBUTES)
    with Image.open(tmp_path / "i.png") as picture:
        colours = {tuple(rgb) for rgb in np.asarray(picture.convert("RGB")).reshape(-1, 3)[::7]}
    for wanted in ((214, 84, 46), (154, 169, 196), (219, 219, 219)):  # fire, hidden, no look
        assert wanted in colours
    assert (tmp_path / "f.png").stat().st_size > 20_000
