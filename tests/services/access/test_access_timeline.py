"""The timeline shows every contact and eclipse where it is, and gives the same bytes twice."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pytest
from matplotlib.collections import PolyCollection
from matplotlib.dates import date2num

from services.access.events.contacts import Contact
from services.access.events.eclipses import Eclipse
from services.access.events.timeline import SatelliteEvents, draw_timeline
from shared import figures
from tests.services.access.orbits import START

ROWS = [
    SatelliteEvents("A", [Contact("A", "x", 100.0, 700.0, 30.0)], [Eclipse("A", "umbra", 300.0, 2000.0)]),
    SatelliteEvents("B", [Contact("B", "y", 0.0, 60.0, 8.0), Contact("B", "x", 900.0, 1300.0, 80.0)], []),
]


def test_bars_lie_at_their_times_and_lanes() -> None:
    (axes,) = draw_timeline(ROWS, ["x", "y"], START, 3600.0).axes
    bars = set()
    for collection in axes.collections:
        assert isinstance(collection, PolyCollection)
        for path in collection.get_paths():
            box = path.get_extents()
            start_s = (box.x0 - date2num(START)) * 86400.0
            bars.add((round((box.y0 + box.y1) / 2), round(start_s), round((box.x1 - box.x0) * 86400.0)))
    assert bars == {(0, 100, 600), (0, 300, 1700), (1, 0, 60), (1, 900, 400)}
    assert [label.get_text() for label in axes.get_yticklabels()] == ["A", "B"]
    assert axes.get_xlim() == pytest.approx((date2num(START), date2num(START + timedelta(hours=1))))


def test_a_timeline_of_nothing_is_a_picture_too(tmp_path: Path) -> None:
    empty = [SatelliteEvents(f"S{number}", [], []) for number in range(40)]
    for attempt in ("a.png", "b.png"):
        figures.save(draw_timeline(empty, [], START, 86400.0), tmp_path / attempt, {"simulated": True})
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
