"""FPI and WFPI: published forms by hand, limits, neutrality, masks."""

from __future__ import annotations

import geopandas
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Point

from services.prioritization import weather
from services.prioritization.prefire import fire_potential, legend
from shared.errors import DomainError

TERMS = fire_potential.WeatherTerms()


def test_relative_greenness_is_the_place_between_its_own_extremes():
    ndvi, low, high = np.array([0.2, 0.35, 0.8, 0.1, 0.4]), np.full(5, 0.2), np.array([0.5, 0.5, 0.5, 0.5, 0.2])
    found = fire_potential.relative_greenness(ndvi, low, high)
    np.testing.assert_allclose(found, [0, 0.5, 1, 0, np.nan])


def test_fpi_of_1998_spans_0_to_100():
    dead, driest = np.array(0.0), np.array(2.0)
    assert fire_potential.fpi_1998(dead, 0.5, 1.0, driest, 25.0) == pytest.approx(100)
    assert fire_potential.fpi_1998(dead, 0.5, 1.0, np.array(0.5), 25.0) == 100
    assert fire_potential.fpi_1998(np.array(1.0), 1.0, 0.0, np.array(25.0), 25.0) == pytest.approx(0)
    assert fire_potential.fpi_1998(dead, 1.0, 1.0, np.array(30.0), 25.0) == pytest.approx(0)  # beyond extinction


@pytest.mark.parametrize(
    ("greenness", "live", "dead", "moisture", "extinction", "expected"),
    [
        # lf = LL RG / (LL + DL); TN = FM10 / MXd; FPIu = 100 - 100 (RG lf + TN (1 - lf)); FPI = FPIu MXd / (MXd - 2)
        (0.5, 1.0, 1.0, 10.0, 25.0, 62.5),  # lf 0.25, TN 0.4: FPIu 57.5, times 25/23
        (0.8, 2.0, 1.0, 6.0, 20.0, 100 * (1 - (0.8 * 1.6 / 3 + 0.3 * 1.4 / 3)) * 20 / 18),  # lf 1.6/3: 48.148
        (0.0, 0.7, 1.3, 5.0, 30.0, 100 * 25 / 28),  # nothing live: 100 (1 - 5/30) 30/28
    ],
)
def test_fpi_of_1998_by_hand(greenness, live, dead, moisture, extinction, expected):
    found = fire_potential.fpi_1998(np.array(greenness), live, dead, np.array(moisture), extinction)
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("greenness", "ndvi_max", "largest", "moisture", "extinction", "expected"),
    [
        # LR = RG (0.25 + 0.5 NDVImax / NDVIabs); TN = (FM10 - 2) / (MXd - 2); FPI = 100 (1 - LR) (1 - TN)
        (0.5, 0.6, 0.8, 8.0, 26.0, 100 * 0.6875 * 0.75),
        (1.0, 0.8, 0.8, 2.0, 26.0, 25.0),  # the greenest place fully green: a quarter of the fuel is dead
        (1.0, 0.0, 0.8, 2.0, 26.0, 75.0),
        (0.0, 0.5, 0.8, 14.0, 26.0, 50.0),
        (0.0, 0.5, 0.8, 1.0, 26.0, 100.0),  # below 2 per cent: as dry as it gets
        (0.0, 0.5, 0.8, 40.0, 26.0, 0.0),
    ],
)
def test_fpi_of_2000_by_hand(greenness, ndvi_max, largest, moisture, extinction, expected):
    share = fire_potential.live_ratio(np.array(greenness), np.array(ndvi_max), largest)
    assert fire_potential.fpi_2000(share, np.array(moisture), np.array(extinction)) == pytest.approx(expected)


def test_wfpi_is_fpi_in_neutral_weather():
    fpi = np.array([0.0, 40.0, 100.0])
    factor = TERMS.factor(np.full(3, 15 / 3.6), np.full(3, 25.0), np.full(3, 0.5))
    np.testing.assert_array_equal(fire_potential.wfpi(fpi, factor), fpi)


@settings(max_examples=50, deadline=None)
@given(wind=st.floats(0, 19), t=st.floats(1, 44), rain=st.floats(0.5, 40))
def test_wfpi_rises_with_wind_and_heat_and_falls_with_rain(wind, t, rain):
    base = TERMS.factor(np.array(wind), np.array(t), np.array(rain))
    assert TERMS.factor(np.array(wind + 1), np.array(t), np.array(rain)) > base
    assert TERMS.factor(np.array(wind), np.array(t + 1), np.array(rain)) > base
    assert TERMS.factor(np.array(wind), np.array(t), np.array(rain + 1)) < base


def test_wfpi_may_exceed_150_and_ends_below_the_codes():
    factor = TERMS.factor(np.array([14.0, 20.0]), np.array([38.0, 45.0]), np.zeros(2))
    values = fire_potential.wfpi(np.array([95.0, 100.0]), factor)
    assert 150 < values[0] < 248 and values[1] <= 247


def test_codes_keep_masks_and_large_values():
    mask = np.array([[0, 254], [251, 0]], dtype=np.uint8)
    values = np.array([[180.4, 20.0], [20.0, np.nan]])
    assert fire_potential.coded(values, mask).tolist() == [[180, 254], [251, 255]]
    assert fire_potential.coded_tenths(values, mask).tolist() == [[1804, 2540], [2510, 2550]]


def test_every_byte_has_a_colour_and_the_top_class_starts_at_141():
    colours = legend.colormap()
    assert set(colours) == set(range(256))
    assert colours[141] == colours[247] != colours[140]
    assert legend.class_label(4) == "extreme 141–247"


def test_unknown_mask_codes_are_named():
    with pytest.raises(DomainError) as caught:
        fire_potential.checked_mask(np.array([0, 3]))
    assert caught.value.field == "mask_code"


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
