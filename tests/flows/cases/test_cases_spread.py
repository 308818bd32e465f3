"""Fire spread against the analytic ellipse, a slow independent solver, and properties of wind, slope and barriers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.cases.nature.spread import (
    NEIGHBOURS,
    dead_fuel_moisture_pct,
    effective_distances,
    head_rate_m_h,
    length_to_breadth,
    minimum_arrival_h,
    travelled_by_direction,
)

CELL_M = 250.0
SIZE = 61
MIDDLE = SIZE // 2


def _spread(wind: np.ndarray, origin_deg: np.ndarray, fuel: np.ndarray | None = None, height: np.ndarray | None = None):
    level = np.zeros((SIZE, SIZE))
    fuel = np.ones((SIZE, SIZE)) if fuel is None else fuel
    distances = effective_distances(fuel, level if height is None else height, CELL_M)
    travelled = travelled_by_direction(wind, origin_deg, np.full(len(wind), 6.0))
    return minimum_arrival_h(distances, travelled, (MIDDLE, MIDDLE), 0.0)


def test_steady_wind_gives_the_ellipse() -> None:
    hours, wind = 40, 6.0
    arrival = _spread(np.full(hours, wind), np.full(hours, 270.0))  # from the west: the head runs east
    head = head_rate_m_h(np.array(wind), np.array(6.0))
    ratio = length_to_breadth(np.array(wind))
    eccentricity = np.sqrt(1 - 1 / ratio**2)
    back = head * (1 - eccentricity) / (1 + eccentricity)
    assert arrival[MIDDLE, MIDDLE + 20] == pytest.approx(20 * CELL_M / head, rel=1e-9)
    assert arrival[MIDDLE, MIDDLE - 4] == pytest.approx(4 * CELL_M / back, rel=1e-9)
    # Half width of the ellipse at its centre: (head + back) / 2 / LB metres an hour, reached at the time the head is at
    # centre + semi-major axis. Sixteen directions make the polygon lie inside the ellipse by a few per cent.
    time = 20 * CELL_M / head
    burned = arrival <= time
    width = CELL_M * burned.any(axis=1).sum()
    assert width == pytest.approx((head + back) * time / ratio, rel=0.2)


@settings(max_examples=25, deadline=None)
@given(st.floats(2.0, 12.0), st.integers(0, 15))
def test_fire_runs_fastest_downwind(speed: float, direction: int) -> None:
    row, column = NEIGHBOURS[direction]
    origin = np.degrees(np.arctan2(column, row)) + 180.0  # blowing exactly towards this neighbour
    arrival = _spread(np.full(60, speed), np.full(60, origin))
    ring = {n: arrival[MIDDLE + 4 * n[0], MIDDLE + 4 * n[1]] / np.hypot(*n) for n in NEIGHBOURS}
    known = {n: hours for n, hours in ring.items() if np.isfinite(hours)}
    assert min(known, key=known.__getitem__) == (row, column)
    assert (-row, -column) not in known or known[(-row, -column)] > 1.5 * known[(row, column)]


def test_a_wind_shift_turns_the_head() -> None:
    turned = np.where(np.arange(24) < 8, 270.0, 180.0)
    arrival = _spread(np.full(24, 6.0), turned)
    steady = _spread(np.full(24, 6.0), np.full(24, 270.0))
    assert np.isfinite(arrival[MIDDLE + 20, MIDDLE + 6]) and np.isnan(steady[MIDDLE + 20, MIDDLE + 6])
    early = steady <= 8
    np.testing.assert_array_equal(arrival[early], steady[early])


def test_matches_a_slow_solver_with_changing_wind() -> None:
    rng = np.random.default_rng(4)
    size, hours = 9, 60
    fuel, height = rng.uniform(0.3, 1.5, (size, size)), rng.uniform(0, 300, (size, size))
    fuel[2, 5] = 0.0
    wind, origin = rng.uniform(0.5, 8, hours), rng.uniform(0, 360, hours)
    distances = effective_distances(fuel, height, CELL_M)
    travelled = travelled_by_direction(wind, origin, rng.uniform(3, 12, hours))
    fast = minimum_arrival_h(distances, travelled, (4, 4), 1.25)
    slow = np.full((size, size), np.inf)
    slow[4, 4] = 1.25
    for _ in range(size * size):  # Bellman-Ford, edges integrated by interpolation of the travel curve
        before = slow.copy()
        for number, (down, right) in enumerate(NEIGHBOURS):
            clock = np.arange(hours + 1.0)
            for row in range(size):
                for column in range(size):
                    to = (row + down, column + right)
                    if not (0 <= to[0] < size and 0 <= to[1] < size) or not np.isfinite(before[row, column]):
                        continue
                    gone = np.interp(before[row, column], clock, travelled[number])
                    goal = gone + distances[number, row, column]
                    if goal < travelled[number, -1]:
                        slow[to] = min(slow[to], np.interp(goal, travelled[number], clock))
        if np.array_equal(before, slow):
            break
    np.testing.assert_allclose(fast, np.where(np.isfinite(slow), slow, np.nan), rtol=1e-12)
    assert np.isnan(fast[2, 5])


def test_uphill_is_faster_and_ten_degrees_double_it() -> None:
    rise = np.tan(np.radians(10.0)) * CELL_M
    slope = np.repeat(np.arange(SIZE)[:, None] * rise, SIZE, axis=1)
    distances = effective_distances(np.ones((SIZE, SIZE)), slope, CELL_M)
    up, down = NEIGHBOURS.index((1, 0)), NEIGHBOURS.index((-1, 0))
    assert distances[up, 5, 5] == pytest.approx(CELL_M / np.exp(0.69), rel=1e-9)
    assert distances[down, 5, 5] == pytest.approx(CELL_M * np.exp(0.69), rel=1e-9)


def test_water_stops_fire() -> None:
    fuel = np.ones((SIZE, SIZE))
    fuel[:, MIDDLE + 5 : MIDDLE + 8] = 0.0
    arrival = _spread(np.full(80, 8.0), np.full(80, 270.0), fuel)
    assert np.isfinite(arrival[MIDDLE, MIDDLE + 4])
    assert np.isnan(arrival[:, MIDDLE + 5 :]).all()


def test_fuel_moisture_matches_the_published_equilibrium() -> None:
    # Fosberg's table as the fire-danger notes give it: 35 C and 10 % -> 2.22749 etc. computed by hand in Fahrenheit.
    assert dead_fuel_moisture_pct(np.array(35.0), np.array(30.0)) == pytest.approx(
        2.22749 + 0.160107 * 30 - 0.014784 * 95.0
    )
    assert dead_fuel_moisture_pct(np.array(10.0), np.array(90.0)) > dead_fuel_moisture_pct(
        np.array(10.0), np.array(60.0)
    )
