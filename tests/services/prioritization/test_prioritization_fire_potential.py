"""FPI and WFPI: limits, neutrality, masks; what soil moisture and scars change, and nothing without them."""

from __future__ import annotations

import geopandas
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer
from shapely.geometry import Point

from services.prioritization import weather
from services.prioritization.prefire import danger, fire_potential, large_fire_probability, observed_land
from shared.errors import DomainError

TERMS = fire_potential.WeatherTerms()


def test_fpi_of_1998_spans_0_to_100():
    dead, driest = np.array(0.0), np.array(2.0)
    assert fire_potential.fpi_1998(dead, 0.5, 1.0, driest, 25.0) == pytest.approx(100)
    assert fire_potential.fpi_1998(np.array(1.0), 1.0, 0.0, np.array(25.0), 25.0) == pytest.approx(0)
    # by hand: RG 0.5, loads 1:1 -> lf 0.25; TN 10/25 = 0.4; 100 - 100 (0.125 + 0.3) = 57.5; x (1 + 0.08 / 0.92)
    assert fire_potential.fpi_1998(np.array(0.5), 1.0, 1.0, np.array(10.0), 25.0) == pytest.approx(62.5)


def test_fpi_of_2000_by_hand():
    share = fire_potential.live_ratio(np.array(0.5), np.array(0.6), 0.8)
    assert share == pytest.approx(0.3125)
    assert fire_potential.fpi_2000(share, np.array(8.0), np.array(26.0)) == pytest.approx(100 * 0.6875 * 0.75)
    assert fire_potential.fpi_2000(np.array(0.0), np.array(2.0), np.array(25.0)) == 100


def test_wfpi_is_fpi_in_neutral_weather():
    fpi = np.array([0.0, 40.0, 100.0])
    neutral = fire_potential.wfpi(fpi, np.full(3, 15 / 3.6), np.full(3, 25.0), np.full(3, 0.5))
    np.testing.assert_array_equal(neutral, fpi)


@settings(max_examples=50, deadline=None)
@given(wind=st.floats(0, 19), t=st.floats(1, 44), rain=st.floats(0, 40))
def test_wfpi_rises_with_wind_and_heat_and_falls_with_rain(wind, t, rain):
    base = TERMS.factor(np.array(wind), np.array(t), np.array(rain))
    assert TERMS.factor(np.array(wind + 1), np.array(t), np.array(rain)) > base
    assert TERMS.factor(np.array(wind), np.array(t + 1), np.array(rain)) > base
    assert TERMS.factor(np.array(wind), np.array(t), np.array(rain + 1)) < base


def test_codes_keep_masks_and_large_values():
    mask = np.array([[0, 254], [251, 0]], dtype=np.uint8)
    code = fire_potential.coded(np.array([[180.4, 20.0], [20.0, np.nan]]), mask)
    assert code.tolist() == [[180, 254], [251, 255]]


def test_wrong_scales_are_named():
    with pytest.raises(DomainError) as caught:
        fire_potential.relative_greenness(np.array([5200.0]), np.array([0.1]), np.array([0.8]))
    assert caught.value.field == "ndvi"
    with pytest.raises(DomainError) as caught:
        fire_potential.checked_mask(np.array([0, 3]))
    assert caught.value.field == "mask_code"


def test_probabilities_span_the_published_bins():
    season = np.array(0.0)
    low, high = (large_fire_probability.wfsp_pct(np.array(v), season) for v in (0.0, 160.0))
    assert low < 0.5 and high > 30
    low, high = (large_fire_probability.wlfp_per_million_km2_day(np.array(v), season) for v in (0.0, 140.0))
    assert low < 0.1 and high > 7


def test_season_is_opposite_in_the_south():
    north, south = large_fire_probability.season_term(210, np.array([40.0, -40.0]))
    assert north == pytest.approx(1) and south == pytest.approx(-1)


def test_ease_grid_cells_agree_with_their_definition():
    row, column = observed_land.ease_cells(np.array([-179.999, 0.01]), np.array([85.0, -0.01]))
    assert (row[0], column[0]) == (0, 0)
    assert (row[1], column[1]) == (812, 1928)  # 1624 x 3856 cells: the equator and Greenwich split them evenly
    x, _ = Transformer.from_crs(4326, 6933, always_xy=True).transform(-107.3, 33.3)
    assert observed_land.ease_cells(np.array([-107.3]), np.array([33.3]), 36)[1] == int((x + 17367530.445) // 36032.22)


EFFECT = observed_land.SoilMoistureEffect()


@settings(max_examples=80, deadline=None)
@given(rg=st.floats(0, 1), w=st.floats(0, 1), a=st.floats(-0.5, 1), s=st.floats(0, 1))
def test_greenness_is_untouched_without_weight_or_at_the_middle(rg, w, a, s):
    assert observed_land.greenness_with_soil_moisture(np.array(rg), np.array(0.0), np.array(a), np.array(s)) == rg
    assert observed_land.greenness_with_soil_moisture(np.array(rg), np.array(w), np.array(a), np.array(0.5)) == rg
    changed = observed_land.greenness_with_soil_moisture(np.array(rg), np.array(w), np.array(a), np.array(s))
    assert 0 <= changed <= 1
    if a > 0:
        assert (changed - rg) * (s - 0.5) >= 0  # wetter is greener in the growing season


def test_alpha_changes_sign_with_the_season():
    summer, winter = (observed_land.growing_season(d, np.array(35.0)) for d in (180.0, 362.6))
    assert observed_land.alpha(summer, np.array(1.0), np.array(1.0), EFFECT) > 0
    assert observed_land.alpha(winter, np.array(1.0), np.array(1.0), EFFECT) < 0
    assert observed_land.growing_season(180.0, np.array(-35.0)) == pytest.approx(0, abs=1e-6)


def _soil(latitude: float, time: pd.Timestamp, moisture: float = 0.05) -> pd.DataFrame:
    row, column = observed_land.ease_cells(np.array([-107.0]), np.array([latitude]))
    return pd.DataFrame(
        {
            "time": [time],
            "row": row,
            "column": column,
            "soil_moisture": [moisture],
            "soil_moisture_sd": [0.03],
            "count": [3],
        }
    )


def test_soil_moisture_weight_fades_ends_at_the_latitude_limit_and_at_the_cut_off(time):
    def weight(latitude: float, age_h: float) -> float:
        table = _soil(latitude, time - pd.Timedelta(hours=age_h))
        place = (np.array([[-107.0]]), np.array([[latitude]]))
        return float(observed_land.soil_moisture_on_grid([table], *place, time, EFFECT).weight[0, 0])

    assert weight(33.0, 1) > weight(33.0, 48) > 0
    assert weight(33.0, 96) / weight(33.0, 0) == pytest.approx(np.exp(-1), rel=1e-6)
    assert weight(41.0, 1) == 0
    assert weight(33.0, -1) == 0  # not known yet


def test_latest_soil_moisture_counts(time):
    tables = [_soil(33.0, time - pd.Timedelta(hours=h), m) for h, m in ((30, 0.3), (2, 0.1), (60, 0.4))]
    place = (np.array([[-107.0]]), np.array([[33.0]]))
    assert observed_land.soil_moisture_on_grid(tables, *place, time, EFFECT).soil_moisture[0, 0] == 0.1


def test_burn_scar_is_local_and_heals(make, time):
    axis_y, axis_x = np.arange(33, 34, 0.05), np.arange(-108, -107, 0.05)
    latitude, longitude = np.meshgrid(axis_y, axis_x, indexing="ij")

    def scar(hours_ago: float) -> np.ndarray:
        table = make["burned_area"](-107.5, 33.5, hours_ago)
        return observed_land.burn_scar([table], longitude, latitude, time, (0.05, 0.05), observed_land.BurnScarEffect())

    fresh = scar(10)
    assert 0.5 < fresh.max() <= 0.9
    assert 1 <= (fresh > 0).sum() <= 6
    assert scar(24 * 365).max() == pytest.approx(fresh.max() / np.e, rel=0.01)
    assert scar(-5).max() == 0


def _danger(make, time, seen_kwargs, version="2000"):
    fuels = danger.fuels_from_dataset(make["fuels"](0.1))
    grid = weather.weather_from_dataset(make["weather"](hours=48))
    conditions = danger.conditions_on_fuels(grid, None, time, fuels)
    effects = danger.DangerEffects()
    seen = danger.seen_land(fuels, seen_kwargs.get("soil", []), seen_kwargs.get("burned", []), time, effects)
    return danger.danger(fuels, conditions, seen, time, version, effects)


@pytest.mark.parametrize("version", ["1998", "2000"])
def test_scar_lowers_all_three_and_nothing_seen_changes_nothing(make, time, version):
    plain = _danger(make, time, {}, version)
    burned = _danger(make, time, {"burned": [make["burned_area"](-107.4, 34.1, 10)]}, version)
    for name in ("wfpi", "wlfp", "wfsp"):
        np.testing.assert_array_equal(plain[name].to_numpy(), plain[name + "_x"].to_numpy())
        change = (burned[name + "_x"] - burned[name]).isel(lead_day=0).fillna(0)
        assert float(change.min()) < 0 and float(change.max()) == 0


def test_greener_land_is_less_dangerous_and_windier_more(make, time):
    day = _danger(make, time, {})["wfpi"].isel(lead_day=0)
    row = day.sel(latitude=33.5, method="nearest").to_numpy()
    assert (np.diff(row[np.isfinite(row)]) < 0.5).all() and row[0] > row[-1]  # greenness rises eastwards
    column = day.sel(longitude=-108.5, method="nearest").to_numpy()
    column = column[np.isfinite(column)]
    assert column[-1] > column[0]  # wind rises northwards


def test_daily_conditions_take_the_hottest_hour(make, time):
    grid = weather.weather_from_dataset(make["weather"](hours=48))
    daily = weather.daily_burning_conditions(grid, time, days=3)
    assert daily.temperature_max_c[0].max() == pytest.approx(33, abs=0.01)
    assert daily.relative_humidity_min_pct[0].min() == pytest.approx(12, abs=0.01)
    assert daily.wind_speed_m_s[0, 0, 0] == pytest.approx(6, abs=0.01)
    assert np.isnan(daily.temperature_max_c[2]).all()  # no hours left there


def test_resampling_is_linear_and_stops_at_the_edge():
    y, x = np.arange(30.0, 35.0), np.arange(-110.0, -105.0)
    plane = 2 * y[:, None] + 3 * x[None, :]
    to_y, to_x = np.array([30.0, 31.3, 34.0, 34.4, 36.0]), np.array([-109.9, -106.2])
    values = weather.resample(plane, y, x, to_y, to_x)
    np.testing.assert_allclose(values[:3], 2 * to_y[:3, None] + 3 * to_x[None, :])
    assert np.isfinite(values[3]).all() and np.isnan(values[4]).all()


def test_few_bad_values_are_taken_out_many_refused():
    values = np.full(1000, 20.0)
    values[3] = 300.0
    checked, count = weather.check_weather(values, "temperature_c", "weather")
    assert count == 1 and np.isnan(checked[3])
    with pytest.raises(DomainError, match="unit") as caught:
        weather.check_weather(np.full(24, 300.0), "temperature_c", "weather")
    assert caught.value.field == "temperature_c"
    with pytest.raises(DomainError):
        weather.check_weather(np.full(24, np.nan), "relative_humidity_pct", "weather")


def test_stations_speak_for_places_in_reach(time):
    table = geopandas.GeoDataFrame(
        {
            "time": [time],
            "temperature_c": [30.0],
            "relative_humidity_pct": [20.0],
            "wind_speed_m_s": [5.0],
            "rain_mm": [0.0],
        },
        geometry=[Point(-107.0, 33.0)],
        crs="EPSG:4326",
    )
    assert len(weather.series_at_stations(table, -107.5, 33.0, 100)) == 1
    assert len(weather.series_at_stations(table, -105.0, 33.0, 100)) == 0
