"""The next 24 hours: marching against a known solution, rates of a known fire, weather that turns it, skill."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from services.arrival.extent import Evidence
from services.arrival.field import FieldSettings
from services.arrival.front.forecast import constant_rate, forecast_front, march, persistence
from services.arrival.front.rates import front_rates, rate_of_spread_km_h
from services.arrival.front.weather import (
    HourlyWeather,
    eccentricity,
    equilibrium_moisture,
    moisture_damping,
    run_by_direction,
    weather_at,
    wind_factor,
)
from services.arrival.grid import FireGrid
from services.arrival.inference import ArrivalMap
from services.arrival.metrics import sorensen
from shared.errors import DomainError
from tests.services.arrival.front.forecast_cases import score_front
from tests.services.arrival.seeds import TESTS
from tests.services.arrival.synthetic_fires import make_fire

SIZE, CELL_KM = 121, 0.5
AXIS_M = (np.arange(SIZE) - SIZE // 2) * CELL_KM * 1e3
GRID = FireGrid(32613, 500_000 + AXIS_M, 3_700_000 + AXIS_M, CELL_KM * 1e3)
X_KM, Y_KM = np.meshgrid(AXIS_M / 1e3, AXIS_M / 1e3)


def _map(arrival_h: np.ndarray, flags: tuple[str, ...] = ()) -> ArrivalMap:
    nothing = np.zeros(arrival_h.shape)
    evidence = Evidence(nothing.astype(np.uint8), nothing, nothing, nothing.astype(bool), nothing)
    burned = np.isfinite(arrival_h).astype(float)
    return ArrivalMap(GRID, evidence, arrival_h, nothing, arrival_h, arrival_h, burned, flags, 0, 0)


def _ellipse_fire(end_h: float, head_km_h: float, shape: float, heading_rad: float) -> np.ndarray:
    """Arrival, h, of a fire from the middle of the grid that spreads as an ellipse around its rear focus."""
    distance, angle = np.hypot(X_KM, Y_KM), np.arctan2(Y_KM, X_KM)
    speed = head_km_h * (1 - shape) / (1 - shape * np.cos(angle - heading_rad))
    arrival = distance / speed
    return np.where(arrival <= end_h, arrival, np.nan)


def test_marching_from_a_disc_at_constant_speed_is_the_distance_to_it() -> None:
    radius = np.hypot(X_KM, Y_KM)
    hours = march(radius <= 5.0, np.full(radius.shape, 0.5), CELL_KM)
    ring = (radius > 6) & (radius < 25)
    expected = (radius - 5.0) / 0.5
    assert np.abs(hours - expected)[ring].mean() < 1.0  # half a cell is an hour here
    assert (hours[radius <= 5.0] == 0).all()


def test_marching_goes_round_what_does_not_burn() -> None:
    speed = np.full(X_KM.shape, 1.0)
    wall = (np.abs(X_KM - 5.0) < 0.3) & (Y_KM < 20.0)
    hours = march(np.hypot(X_KM, Y_KM) <= 1.0, np.where(wall, 1e-4, speed), CELL_KM)
    behind = hours[SIZE // 2, np.argmin(np.abs(AXIS_M / 1e3 - 10.0))]
    around = np.hypot(5, 20) + np.hypot(5, 20) - 1.0
    assert behind == pytest.approx(around, rel=0.1)


def test_several_fires_each_march_from_their_own_edge() -> None:
    burned = (np.hypot(X_KM + 15, Y_KM) <= 2) | (np.hypot(X_KM - 15, Y_KM) <= 2)
    hours = march(burned, np.full(burned.shape, 1.0), CELL_KM)
    assert np.abs(hours - hours[:, ::-1]).max() < 0.6
    assert hours[SIZE // 2, SIZE // 2] == pytest.approx(13.0, abs=0.8)


def test_rate_of_spread_is_that_of_the_field() -> None:
    rate = rate_of_spread_km_h(_ellipse_fire(48.0, 0.4, 0.0, 0.0), CELL_KM)
    inner = (np.hypot(X_KM, Y_KM) > 2) & np.isfinite(rate)
    assert np.median(rate[inner]) == pytest.approx(0.4, rel=0.02)


def test_rates_find_the_heading_and_the_size_of_the_last_day() -> None:
    arrival = _ellipse_fire(48.0, 0.35, 0.6, 2.0)
    rates = front_rates(arrival, 48.0, CELL_KM)
    assert rates.window_h == 24.0 and rates.heading_rad == pytest.approx(2.0, abs=0.15)
    assert 0.35 * 24 * 0.25 < rates.mean_km < 0.35 * 24
    head, back = rates.towards(np.array([2.0, 2.0 - np.pi]))
    assert head > 2 * back > 0


def test_forecast_follows_the_fire_and_spares_what_has_burned() -> None:
    arrival = _ellipse_fire(48.0, 0.3, 0.7, 0.0)
    made = _map(arrival)
    front = forecast_front(made, 48.0)
    burned = np.isfinite(arrival)
    assert front.basis == "spread" and (front.probability[burned] == 0).all()
    assert front.probability.min() >= 0 and front.probability.max() <= 1
    ahead, behind = front.probability[(X_KM > 0) & ~burned].sum(), front.probability[(X_KM < 0) & ~burned].sum()
    assert ahead > 2 * behind
    truth = np.isfinite(_ellipse_fire(72.0, 0.3, 0.7, 0.0))
    assert sorensen(front.burned_by_then(made), truth) > sorensen(persistence(made), truth) + 0.05


def test_a_constant_rate_moves_the_outline_by_the_last_day() -> None:
    made = _map(_ellipse_fire(48.0, 0.3, 0.0, 0.0))
    moved = constant_rate(made, 48.0)
    assert sorensen(moved, np.hypot(X_KM, Y_KM) <= 21.6) > 0.98


def test_chances_fall_with_the_distance_from_the_front() -> None:
    front = forecast_front(_map(_ellipse_fire(48.0, 0.3, 0.0, 0.0)), 48.0)
    line = front.probability[SIZE // 2, SIZE // 2 :]
    outside = line[line > 0]
    assert (np.diff(outside) <= 1e-9).all() and outside[0] > 0.7


@pytest.mark.parametrize("flag", ["one-detection", "one-instant", "burned-area-only"])
def test_without_a_known_spread_the_forecast_is_wide_and_says_so(flag: str) -> None:
    arrival = np.full(X_KM.shape, np.nan)
    arrival[SIZE // 2, SIZE // 2] = 3.0
    front = forecast_front(_map(arrival, (flag,)), 12.0)
    assert front.basis == "climatology"
    near, far = front.probability[SIZE // 2, SIZE // 2 + 2], front.probability[SIZE // 2, SIZE // 2 + 10]
    assert 0.3 < near < 0.7 and 0.01 < far < 0.3


def test_no_fire_gives_no_front() -> None:
    front = forecast_front(_map(np.full(X_KM.shape, np.nan)), 12.0)
    assert front.basis == "none" and not front.probability.any()


def _weather(hours: np.ndarray, wind_m_s: float, wind_from_deg: float, humidity: float = 20.0) -> HourlyWeather:
    full = [np.full(hours.size, value) for value in (30.0, humidity, wind_m_s, wind_from_deg)]
    return HourlyWeather(hours, *full)


def _joined(past: HourlyWeather, coming: HourlyWeather) -> HourlyWeather:
    return HourlyWeather(
        *(np.concatenate([getattr(past, n), getattr(coming, n)]) for n in HourlyWeather.__dataclass_fields__)
    )


def test_wind_that_turns_takes_the_front_along() -> None:
    made = _map(_ellipse_fire(48.0, 0.2, 0.6, 0.0))  # ran east under a west wind
    past = _weather(np.arange(0.0, 49.0), 8.0, 270.0)
    turned = forecast_front(made, 48.0, _joined(past, _weather(np.arange(49.0, 73.0), 8.0, 180.0)))
    assert turned.basis == "spread+weather"
    open_land = ~np.isfinite(made.arrival_h)
    north = turned.probability[(np.abs(X_KM) < Y_KM) & open_land].sum()
    south = turned.probability[(np.abs(X_KM) < -Y_KM) & open_land].sum()
    assert north > 3 * south
    plain = forecast_front(made, 48.0).probability
    assert north > 1.5 * plain[(np.abs(X_KM) < Y_KM) & open_land].sum()


def test_rain_soaked_fuel_stops_and_a_gale_speeds_the_front() -> None:
    made = _map(_ellipse_fire(48.0, 0.2, 0.4, 0.0))
    past = _weather(np.arange(0.0, 49.0), 4.0, 270.0)
    hours = np.arange(49.0, 73.0)
    same, wet, gale = (
        forecast_front(made, 48.0, _joined(past, coming)).probability.sum()
        for coming in (_weather(hours, 4.0, 270.0), _weather(hours, 4.0, 270.0, 98.0), _weather(hours, 12.0, 270.0))
    )
    assert wet < 0.3 * same < same < 0.8 * gale


def test_weather_that_does_not_cover_the_day_is_not_used() -> None:
    made = _map(_ellipse_fire(48.0, 0.2, 0.4, 0.0))
    assert forecast_front(made, 48.0, _weather(np.arange(0.0, 50.0), 4.0, 270.0)).basis == "spread"


def test_fuel_and_wind_agree_with_published_values() -> None:
    # Equilibrium moisture at 80 F and 50 %: 2.22749 + 0.160107 x 50 - 0.014784 x 80 = 9.05 %.
    assert equilibrium_moisture(np.array([26.6667]), np.array([50.0]))[0] == pytest.approx(0.0905, abs=2e-4)
    assert moisture_damping(np.array([0.0, 0.25, 0.4])).tolist() == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert moisture_damping(np.array([0.125]))[0] == pytest.approx(1 - 2.59 * 0.5 + 5.11 * 0.25 - 3.52 * 0.125)
    # Rothermel's constants at 1500 per foot: C = 7.47 exp(-0.133 x 1500^0.55), B = 0.02526 x 1500^0.54.
    per_minute = 100.0
    b = 0.02526 * 1500**0.54
    assert wind_factor(np.array([per_minute / 196.85]))[0] == pytest.approx(
        7.47 * np.exp(-0.133 * 1500**0.55) * per_minute**b
    )
    assert eccentricity(np.array([0.0]))[0] == 0.0 and eccentricity(np.array([5.0]))[0] > 0.9


def test_run_is_longest_down_the_wind() -> None:
    angles = np.linspace(-np.pi, np.pi, 73)
    run = run_by_direction(_weather(np.arange(3.0), 6.0, 225.0), angles)  # from the south-west
    assert angles[run.argmax()] == pytest.approx(np.pi / 4, abs=0.1)


def _grid_weather() -> xr.Dataset:
    times = pd.date_range("2022-06-01T00:00", periods=48, freq="h")
    shape = (48, 3, 3)
    dims = ("time", "latitude", "longitude")
    values = {"temperature_c": 30, "relative_humidity_pct": 20, "wind_speed_m_s": 5, "wind_direction_deg": 270}
    data = {name: (dims, np.full(shape, float(value))) for name, value in values.items()}
    issued = np.where(np.arange(48) < 24, times[0], times[23])
    coordinates = {"time": times, "latitude": [33.0, 33.5, 34.0], "longitude": [-106.0, -105.5, -105.0]}
    return xr.Dataset({**data, "issued_at": ("time", issued)}, coordinates)


def test_weather_issued_after_the_end_is_not_known() -> None:
    reference = pd.Timestamp("2022-06-01T00:00Z")
    whole = weather_at(_grid_weather(), -105.4, 33.4, reference, pd.Timestamp("2022-06-02T00:00Z"))
    early = weather_at(_grid_weather(), -105.4, 33.4, reference, pd.Timestamp("2022-06-01T12:00Z"))
    assert len(whole) == 48 and len(early) == 24
    with pytest.raises(DomainError) as caught:
        weather_at(_grid_weather(), -100.0, 33.4, reference, pd.Timestamp("2022-06-02T00:00Z"))
    assert caught.value.field == "weather"


def test_on_synthetic_fires_the_forecast_beats_persistence_and_a_constant_rate() -> None:
    quick = FieldSettings(steps=60, members=2)
    scores = [score_front(make_fire(seed), 96.0, settings=quick) for seed in TESTS[10:14]]
    ours, plain, steady = (
        np.mean([getattr(score, name) for score in scores]) for name in ("f1", "f1_persistence", "f1_constant_rate")
    )
    assert ours > plain + 0.02 and ours > steady - 0.01  # four fires; the benchmark has more


def test_the_same_map_gives_the_same_front() -> None:
    made = _map(_ellipse_fire(48.0, 0.3, 0.7, 1.0))
    again = forecast_front(replace(made), 48.0)
    np.testing.assert_array_equal(forecast_front(made, 48.0).probability, again.probability)
