"""Dead fuel moisture: the time-lag law, rain, and a filter that beats the model alone on a synthetic truth."""

from __future__ import annotations

from dataclasses import replace

import geopandas
import numpy as np
import pandas as pd
import pytest

from services.prioritization import fuel_moisture, indices, weather
from services.prioritization.fuel_moisture_grid import to_dataset
from services.prioritization.fuel_moisture_stations import FilterNoise, StationObservations

ONE = np.array([0.0])


def _synthetic_weather(hours: int = 24 * 30, seed: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hours, equilibrium moisture and rain (t, 1): diurnal cycle with slow noise and three showers."""
    rng = np.random.default_rng(seed)
    hour = np.arange(hours, dtype=float)
    slow = np.convolve(rng.normal(0, 1, hours + 48), np.ones(49) / 7, mode="valid")[:hours]
    temperature = 20 + 8 * np.cos((hour % 24 - 15) * np.pi / 12) + slow
    humidity = np.clip(45 - 22 * np.cos((hour % 24 - 15) * np.pi / 12) - 3 * slow, 5, 100)
    rain = np.zeros(hours)
    for when, amount in ((200, 2.0), (201, 4.0), (410, 1.0), (520, 6.0), (521, 3.0), (522, 1.0)):
        rain[when : when + 1] = amount
    return hour, indices.equilibrium_moisture_pct(temperature, humidity)[:, None], rain[:, None]


def _truth(hour: np.ndarray, equilibrium: np.ndarray, rain: np.ndarray, bias: float = 3.0) -> np.ndarray:
    """10-h moisture of another world: wetter equilibrium and a slower lag (12 h) than the model's."""
    moisture = np.empty(len(hour))
    value = float(equilibrium[:24].mean() + bias)
    for t in range(len(hour)):
        if rain[t, 0] > 0.05:
            rate = (1 - np.exp(-(rain[t, 0] - 0.05) / 6.0)) / 16.0
            value = 250 + (value - 250) * np.exp(-rate)
        else:
            target = equilibrium[t, 0] + bias
            value = target + (value - target) * np.exp(-1 / 12.0)
        moisture[t] = value
    return moisture


def _stations(hour: np.ndarray, values: np.ndarray) -> StationObservations:
    n = len(hour)
    return StationObservations(hour.astype(np.int64), np.zeros(n), np.zeros(n), values, np.full(n, 1.5))


def test_each_class_covers_63_per_cent_of_the_way_in_its_lag():
    for index, lag in enumerate(fuel_moisture.LAG_H):
        moved, _, _ = fuel_moisture.step(np.full((3, 1), 20.0), np.array([5.0]), ONE, hours=lag)
        assert moved[index, 0] == pytest.approx(5 + 15 * np.exp(-1))


def test_a_long_step_equals_many_short_ones():
    many = np.full((3, 1), 20.0)
    for _ in range(12):
        many, _, _ = fuel_moisture.step(many, np.array([6.0]), ONE, hours=1)
    once, _, _ = fuel_moisture.step(np.full((3, 1), 20.0), np.array([6.0]), ONE, hours=12)
    np.testing.assert_allclose(many, once)


def test_rain_wets_and_drizzle_below_the_threshold_does_not():
    start = np.full((3, 1), 8.0)
    wet, _, gain = fuel_moisture.step(start, np.array([8.0]), np.array([5.0]), 1)
    assert (wet[:, 0] > start[:, 0]).all() and wet[0] > wet[1] > wet[2]
    assert (gain == 0).all()
    np.testing.assert_array_equal(fuel_moisture.step(start, np.array([8.0]), np.array([0.04]), 1)[0], start)


def test_unknown_air_leaves_moisture_and_raises_variance():
    hour, equilibrium, rain = _synthetic_weather(96)
    gap = equilibrium.copy()
    gap[30:60] = np.nan
    result = fuel_moisture.run(hour, gap, rain, ONE, ONE)
    assert np.isfinite(result.moisture_pct).all()
    assert result.variance[59, 1, 0] > result.variance[30, 1, 0]


def _experiment(values: np.ndarray, hour: np.ndarray, equilibrium: np.ndarray, rain: np.ndarray, kept: np.ndarray):
    plain = fuel_moisture.run(hour, equilibrium, rain, ONE, ONE)
    corrected = fuel_moisture.run(hour, equilibrium, rain, ONE, ONE, _stations(hour[kept], values[kept]))
    return plain, corrected


def test_filter_beats_the_model_and_knows_its_error():
    hour, equilibrium, rain = _synthetic_weather()
    truth = _truth(hour, equilibrium, rain)
    rng = np.random.default_rng(1)
    observed = truth + rng.normal(0, 1.5, len(truth))
    kept = (rng.random(len(truth)) < 0.5) & ((hour < 250) | (hour > 320))  # noisy, gappy, and silent for three days
    plain, corrected = _experiment(observed, hour, equilibrium, rain, kept)
    later = hour > 48
    error_plain = plain.moisture_pct[later, 1, 0] - truth[later]
    error = corrected.moisture_pct[later, 1, 0] - truth[later]
    assert np.sqrt(np.mean(error**2)) < 0.6 * np.sqrt(np.mean(error_plain**2))
    dry = later & (rain[:, 0] == 0) & (truth < 40)
    within = np.abs(corrected.moisture_pct[dry, 1, 0] - truth[dry]) < 2 * np.sqrt(corrected.variance[dry, 1, 0])
    assert within.mean() > 0.8


def test_what_stations_taught_lasts_two_days_and_reaches_other_classes():
    hour, equilibrium, rain = _synthetic_weather(24 * 20)
    rain[:] = 0
    truth = _truth(hour, equilibrium, rain)
    plain, corrected = _experiment(truth, hour, equilibrium, rain, hour < 24 * 16)
    ahead = (hour >= 24 * 16) & (hour < 24 * 18)
    rms = [np.sqrt(np.mean((r.moisture_pct[ahead, 1, 0] - truth[ahead]) ** 2)) for r in (plain, corrected)]
    assert rms[1] < 0.5 * rms[0]
    assert (corrected.moisture_pct[ahead, 0, 0] - plain.moisture_pct[ahead, 0, 0]).mean() > 1
    assert (np.diff(corrected.variance[ahead, 2, 0]) > 0).all()  # unobserved, the slow class grows less certain


def test_mad_and_stuck_stations_are_refused():
    hour, equilibrium, rain = _synthetic_weather(24 * 10)
    rain[:] = 0
    truth = _truth(hour, equilibrium, rain)
    bad = truth.copy()
    bad[60:80] = 500.0
    bad[100:130] = 77.0
    bad[150] = truth[150] + 60
    plain, corrected = _experiment(bad, hour, equilibrium, rain, hour >= 0)
    assert corrected.refused["impossible"] == 20
    assert corrected.refused["stuck sensor"] == 30
    assert corrected.refused["beyond the gate"] >= 1
    assert (
        np.abs(corrected.moisture_pct[48:, 1, 0] - truth[48:]).max()
        < np.abs(plain.moisture_pct[48:, 1, 0] - truth[48:]).max()
    )


def test_a_station_that_jumps_must_behave_before_it_is_believed_again():
    hour, equilibrium, rain = _synthetic_weather(24 * 12)
    rain[:] = 0
    truth = _truth(hour, equilibrium, rain)
    rng = np.random.default_rng(0)
    mad = truth + np.where((hour >= 150) & (hour < 200), rng.normal(0, 30, len(hour)), 0.0)
    mad = np.clip(mad, 1.5, 110)
    believing = FilterNoise(probation=0)
    errors = {}
    for name, noise in (("believing", believing), ("probation", FilterNoise())):
        result = fuel_moisture.run(hour, equilibrium, rain, ONE, ONE, _stations(hour, mad), noise)
        errors[name] = np.abs(result.moisture_pct[150:206, 1, 0] - truth[150:206]).max()
        assert (np.abs(result.moisture_pct[230:, 1, 0] - truth[230:]) < 1.5).all()  # believed again
    assert errors["probation"] < 0.6 * errors["believing"]


def test_stations_out_of_reach_change_nothing():
    hour, equilibrium, rain = _synthetic_weather(72)
    far = fuel_moisture.run(
        hour, equilibrium, rain, np.array([3.0]), ONE, _stations(hour, np.full(72, 15.0) + hour / 50)
    )
    plain = fuel_moisture.run(hour, equilibrium, rain, np.array([3.0]), ONE)
    np.testing.assert_array_equal(far.moisture_pct, plain.moisture_pct)
    assert far.used == 0


def test_nearer_cells_learn_more():
    hour, equilibrium, rain = _synthetic_weather(48)
    cells = np.array([0.0, 0.3, 0.6])
    stations = _stations(hour, equilibrium[:, 0] + 5 + 0.001 * hour)
    spread = np.repeat(equilibrium, 3, axis=1), np.repeat(rain, 3, axis=1)
    result = fuel_moisture.run(hour, *spread, cells, np.zeros(3), stations, FilterNoise(km_sd_pct=2.0))
    plain = fuel_moisture.run(hour, *spread, cells, np.zeros(3))
    gain = (result.moisture_pct - plain.moisture_pct)[-1, 1]
    assert gain[0] > gain[1] > gain[2] > 0


def test_filter_on_a_year_of_a_real_station(real_data):
    """Real weather, synthetic truth and sensor (noisy, gappy, mad at times): better now and 48 h ahead, and honest."""
    from tests.bench.prioritization import fuel_moisture_trial as trial

    station = trial.read_station(real_data / "weather" / "raws_260402_hourly_2012_2016.csv.gz")
    year = trial.Weather(station.time[:8760], station.equilibrium_pct[:8760], station.rain_mm[:8760])
    assert np.isnan(year.equilibrium_pct).any()
    figures = {name: value for name, value, _, _ in trial.metrics(trial.run(year))}
    assert figures["fuel_moisture_rmse_pct"] < 0.5 * figures["fuel_moisture_rmse_without_filter_pct"]
    assert figures["fuel_moisture_rmse_48h_pct"] < 0.6 * figures["fuel_moisture_rmse_48h_without_filter_pct"]
    assert 80 < figures["fuel_moisture_covered_by_90_pct_interval"] < 98
    assert 80 < figures["fuel_moisture_48h_covered_by_90_pct_interval"] < 98


def test_a_run_resumed_is_the_run_uninterrupted():
    hour, equilibrium, rain = _synthetic_weather(96)
    stations = _stations(hour, np.full(96, 12.0) + 0.01 * hour)
    whole = fuel_moisture.run(hour, equilibrium, rain, ONE, ONE, stations)
    first = fuel_moisture.run(hour[:50], equilibrium[:50], rain[:50], ONE, ONE, _part(stations, 0, 50))
    rest = fuel_moisture.run(
        hour[50:], equilibrium[50:], rain[50:], ONE, ONE, _part(stations, 50, 96), initial=first.state
    )
    np.testing.assert_allclose(rest.moisture_pct, whole.moisture_pct[50:], rtol=1e-12)
    np.testing.assert_allclose(rest.variance, whole.variance[50:], rtol=1e-12)


def _part(stations: StationObservations, begin: int, end: int) -> StationObservations:
    chosen = (stations.hour >= begin) & (stations.hour < end)
    values = {name: getattr(stations, name)[chosen] for name in StationObservations.__dataclass_fields__}
    return StationObservations(**(values | {"hour": values["hour"] - begin}))


def _grid(time, hours=72) -> weather.WeatherGrid:
    """Steady dry air on 3 x 4 cells; the hours reach 48 h beyond ``time``."""
    times = pd.date_range(time - pd.Timedelta(hours=hours - 49), periods=hours, freq="h").tz_localize(None)
    shape = (hours, 3, 4)
    fields = {"temperature_c": 30.0, "relative_humidity_pct": 20.0, "wind_speed_m_s": 3.0, "rain_mm": 0.0}
    return weather.WeatherGrid(
        times.to_numpy().astype("datetime64[ns]"),
        np.array([33.0, 33.5, 34.0]),
        np.array([-109.0, -108.5, -108.0, -107.5]),
        {name: np.full(shape, value) for name, value in fields.items()},
    )


def _reports(time, places, hours_ago=(1, 2, 3)) -> geopandas.GeoDataFrame:
    rows = [(time - pd.Timedelta(hours=h), x, y, 9.0 + h / 10) for x, y in places for h in hours_ago]
    frame = pd.DataFrame(rows, columns=["time", "x", "y", "fuel_moisture_10h_pct"])
    return geopandas.GeoDataFrame(frame, geometry=geopandas.points_from_xy(frame.x, frame.y), crs="EPSG:4326")


def test_stations_outside_the_grid_and_after_the_cut_off_are_counted_and_change_nothing(time):
    grid = _grid(time)
    plain = fuel_moisture.forecast(grid, None, time)
    outside = fuel_moisture.forecast(grid, _reports(time, [(-100.0, 33.5), (-108.5, 60.0)]), time)
    np.testing.assert_array_equal(outside.moisture_pct, plain.moisture_pct)
    assert outside.used == 0 and outside.refused["outside the grid"] == 6
    later = fuel_moisture.forecast(grid, _reports(time, [(-108.5, 33.5)], hours_ago=(-5, 1)), time)
    assert later.used == 1 and later.refused["after the cut-off"] == 1
    assert later.moisture_pct[-1, 1].max() > plain.moisture_pct[-1, 1].max()  # still felt 48 h ahead


def test_a_block_without_weather_has_no_value_and_is_flagged(time):
    grid = _grid(time)
    temperature = grid.fields["temperature_c"].copy()
    temperature[:, 0, :2] = np.nan
    temperature[10:20, 2, 3] = np.nan
    holed = replace(grid, fields=grid.fields | {"temperature_c": temperature})
    result = fuel_moisture.forecast(holed, _reports(time, [(-108.5, 33.5)]), time)
    dataset = to_dataset(result, holed)
    assert np.isnan(dataset["fuel_moisture_10h_pct"].to_numpy()[:, 0, :2]).all()
    assert dataset["hours_without_weather"].to_numpy()[0].tolist() == [72, 72, 0, 0]
    assert dataset["hours_without_weather"].to_numpy()[2, 3] == 10
    assert np.isfinite(dataset["fuel_moisture_10h_pct"].to_numpy()[:, 1:]).all()
