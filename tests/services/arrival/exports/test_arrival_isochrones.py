"""Isochrones: levels on round UTC hours, closed lines, nothing across the antimeridian."""

import numpy as np
import pandas as pd

from services.arrival.exports.isochrones import isochrone_features, levels, split_at_antimeridian, step_hours
from services.arrival.extent import gather
from services.arrival.grid import FireGrid
from services.arrival.inference import ArrivalMap
from services.arrival.looks import FIRE, Looks

REFERENCE = pd.Timestamp("2022-06-01T05:00Z")


def _cone(x0_m: float, epsg: int) -> ArrivalMap:
    """Arrival grows by an hour a kilometre around the centre, burned within 6 km."""
    x, y = x0_m + 250 * (np.arange(80) + 0.5), 7_350_000 + 250 * (np.arange(80) + 0.5)
    grid = FireGrid(epsg, x, y, 250.0)
    gx, gy = grid.cell_centres_km()
    radius = np.hypot(gx, gy)
    hours = np.where(radius <= 6, radius, np.nan)
    one = np.array([0.0])
    looks = Looks(one, one, one, np.array([FIRE], np.int8), np.zeros(1, np.int8), one + 1, one + 0.2, one + 0.2)
    return ArrivalMap(grid, gather(grid, looks), hours, hours, hours, hours, np.ones(hours.shape), (), 0, 0)


def test_isochrones_of_a_cone_are_circles_of_the_right_size() -> None:
    features = isochrone_features(_cone(490_000, 32613), REFERENCE, "cone")
    three = next(f for f in features if f["properties"]["time"] == "2022-06-01T08:00:00Z")
    assert abs(three["properties"]["area_km2"] - np.pi * 9) < 1.0
    ring = np.array(three["geometry"]["coordinates"][0])
    assert (ring[0] == ring[-1]).all()
    height_km = np.ptp(ring[:, 1]) * 111.5
    assert abs(height_km - 6) < 0.15


def test_levels_are_round_hours_of_utc() -> None:
    hours = levels(np.linspace(0, 100, 50), REFERENCE, most=24)
    clock = [(REFERENCE + pd.Timedelta(hours=h)).hour for h in hours[:-1]]
    assert set(clock) <= {0, 6, 12, 18} and hours[-1] == 100
    assert step_hours(23) == 1 and step_hours(10_000) == 168


def test_lines_are_cut_at_the_antimeridian() -> None:
    parts = split_at_antimeridian(np.array([[179.9, 66.0], [-179.9, 66.2], [-179.8, 66.2]]))
    assert len(parts) == 2
    assert parts[0][-1] == [180.0, 66.1] and parts[1][0] == [-180.0, 66.1]
    features = isochrone_features(_cone(626_000, 32660), REFERENCE, "bering")
    longitudes = [lon for f in features for part in f["geometry"]["coordinates"] for lon, _ in part]
    jumps = [np.abs(np.diff([p[0] for p in part])).max() for f in features for part in f["geometry"]["coordinates"]]
    assert min(longitudes) < -179 and max(longitudes) > 179 and max(jumps) < 1
