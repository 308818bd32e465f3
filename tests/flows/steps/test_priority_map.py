"""The priority map: real fires are named first, simulated ones are marked, and what is out of reach is said."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pytest
from PIL import Image

from flows.steps import priority_map_drawing as drawing

TIME = pd.Timestamp("2025-01-08T12:00Z")
PRODUCT = {"simulated": True, "simulated_share": 0.7, "oldest_input": "2001-01-01", "code_version": "t"}


def tables() -> dict[str, Any]:
    places = np.random.default_rng(3).uniform((-124, 26), (-70, 48), (400, 2))
    fires = np.array([(-118.5, 34.05), (-118.1, 34.19), (-95.0, 33.0)])
    kinds = ["prefire"] * 400 + ["active"] * 3
    names = ["A", "B", "SIM001"]
    sources = ["danger"] * 400 + [f"incident:{name}" for name in names]
    points = geopandas.points_from_xy(*np.concatenate([places, fires]).T)
    reward = np.random.default_rng(4).gamma(1.0, 0.1, 403)
    frame = {"target_id": np.arange(403), "kind": kinds, "priority": reward, "source": sources}
    told = {"incident_id": names, "name": ["Alpha", "Beta", "Simulated 1"], "simulated": [False, False, True]}
    return {
        "TARGETS": geopandas.GeoDataFrame(frame, geometry=points, crs=4326),
        "INCIDENTS": geopandas.GeoDataFrame(told, geometry=points[-3:], crs=4326),
        "RATINGS": pd.DataFrame({"incident_id": names, "probability": [0.02, 0.3, 0.9]}),
        "OPPORTUNITIES": pd.DataFrame({"target_id": [*np.flatnonzero(places[:, 1] < 38), 400, 402]}),
    }


@pytest.fixture
def layers() -> drawing.Layers:
    given = tables()
    context = SimpleNamespace(read_table=lambda reference, contract: given[contract])
    names = ("targets", "incidents", "ratings", "opportunities")
    return drawing.read_layers(SimpleNamespace(**dict.fromkeys(names)), context)  # type: ignore[arg-type]


def test_fires_are_ranked_and_reach_is_told(layers: drawing.Layers) -> None:
    fires = layers.fires.set_index("incident_id")
    assert list(fires["rank"]) == [1, 2, 3] and list(fires.index) == ["SIM001", "B", "A"]
    assert fires.reachable.to_dict() == {"SIM001": True, "B": False, "A": True}
    north = layers.prefire.geometry.y >= 38
    assert (layers.prefire.reachable == ~north).all()


def test_real_fires_are_named_before_simulated_ones(layers: drawing.Layers) -> None:
    assert list(drawing.listed(layers.fires).incident_id) == ["B", "A", "SIM001"]
    many = pd.concat([layers.fires.assign(incident_id=f"R{number}") for number in range(20)])
    assert not drawing.listed(many).simulated.any() and len(drawing.listed(many)) == drawing.LISTED


def test_the_picture_is_readable_marked_and_the_same_again(layers: drawing.Layers, tmp_path: Path) -> None:
    inputs = SimpleNamespace(title="Day: real fires; weather simulated", cutoff=TIME)
    for name in ("a.png", "b.png"):
        drawing.draw(layers, inputs, tmp_path / name, PRODUCT)  # type: ignore[arg-type]
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    assert picture.shape[1] >= 1500 and (tmp_path / "a.png").stat().st_size < 300_000
    red = (picture[:, :, 0] > 150) & (picture[:, :, 1] < 40) & (picture[:, :, 2] < 40)
    assert red[:30, -150:].any()  # SIMULATED across the corner


def test_a_day_without_fires_or_reach_is_drawn(layers: drawing.Layers, tmp_path: Path) -> None:
    inputs = SimpleNamespace(title="Day", cutoff=TIME)
    bare = drawing.Layers(layers.prefire.assign(reachable=False), layers.fires.head(0))
    drawing.draw(bare, inputs, tmp_path / "bare.png", {**PRODUCT, "simulated": False})  # type: ignore[arg-type]
    assert (tmp_path / "bare.png").stat().st_size > 10_000
