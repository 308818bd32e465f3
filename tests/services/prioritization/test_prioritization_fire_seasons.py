"""Years of the Canadian indices: seasons by temperature, drought code over winter, resumed anywhere."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from services.prioritization.fire_weather import seasons
from shared.errors import DomainError

FACTOR = [-1.6, -1.6, -1.6, 0.9, 3.8, 5.8, 6.4, 5.0, 2.4, 0.4, -1.6, -1.6]


def _drought_code(previous: float, temperature: float, rain: float, month: int) -> float:
    """Drought code of Van Wagner & Pickett (1985), a day."""
    if rain > 2.8:
        effective = 0.83 * rain - 1.27
        moisture = 800 * np.exp(-previous / 400) + 3.937 * effective
        previous = max(400 * np.log(800 / moisture), 0.0)
    return previous + 0.5 * max(0.36 * (max(temperature, -2.8) + 2.8) + FACTOR[month - 1], 0.0)


def _oracle(weather: pd.DataFrame) -> np.ndarray:
    """DC day by day, seasons and winters by hand."""
    out, code, autumn, winter, open_now, row = [], np.nan, np.nan, 0.0, False, 0
    for day, w in weather.iterrows():
        row = row + 1 if (w.temperature_max_c < 5 if open_now else w.temperature_max_c > 12) else 0
        if row == 3:
            open_now, row = not open_now, 0
            if open_now:
                code = 15.0
                if not np.isnan(autumn):
                    moisture = 0.75 * 800 * np.exp(-autumn / 400) + 0.75 * 3.94 * winter
                    code = max(400 * np.log(800 / moisture), 15.0)
            else:
                autumn, winter = code, 0.0
        if open_now:
            code = _drought_code(code, w.temperature_c, w.rain_mm, day.month)
        else:
            winter += w.rain_mm
        out.append(code if open_now else np.nan)
    return np.array(out)


@pytest.fixture(scope="module")
def places(real_data) -> list[pd.DataFrame]:
    data = xr.open_dataset(real_data / "fwi" / "cffdrs_test_wDC.nc").to_dataframe()
    named = data.rename(columns={"tas": "temperature_c", "rh": "relative_humidity_pct", "pr": "rain_mm"})
    named = named.assign(wind_speed_m_s=named["ws"] / 3.6, temperature_max_c=named["tasmax"])
    return [group.sort_index() for _, group in named.groupby("id")]


def test_whole_series_with_winters_agree_with_a_scalar_drought_code(places):
    for weather in places:
        ours, _ = seasons.canadian_years(weather, 49.4625)
        reference = _oracle(weather)
        assert np.isfinite(reference).sum() > 200
        np.testing.assert_allclose(ours["dc"], reference, atol=0.02)
        winter = np.isnan(reference)
        assert ours.loc[winter].isna().all().all() and ours.loc[~winter].notna().all().all()


def test_a_dry_winter_is_remembered(places):
    weather = places[0]
    dry = weather.assign(rain_mm=weather["rain_mm"].where(weather.index.month.isin(range(4, 11)), 0.0))
    spring = weather.index.year == weather.index.year.max()
    codes = [seasons.canadian_years(frame, 49.5)[0]["dc"][spring].dropna().iloc[0] for frame in (dry, weather)]
    assert codes[0] > codes[1] > 15


@pytest.mark.parametrize("cut", [40, 95, 130, 250, 320, 401])
def test_resumed_from_yesterday_gives_the_same(places, cut):
    weather = places[1]
    whole, _ = seasons.canadian_years(weather, 49.5)
    first, carried = seasons.canadian_years(weather.iloc[:cut], 49.5)
    rest, _ = seasons.canadian_years(weather.iloc[cut:], 49.5, carried)
    np.testing.assert_allclose(np.concatenate([first, rest]), whole.to_numpy(), equal_nan=True)


def test_every_day_can_be_the_one_resumed_from(places):
    weather = places[2].iloc[60:200]
    whole, _ = seasons.canadian_years(weather, 49.5)
    carried, parts = None, []
    for day in range(len(weather)):
        part, carried = seasons.canadian_years(weather.iloc[[day]], 49.5, carried)
        parts.append(part)
    np.testing.assert_allclose(pd.concat(parts).to_numpy(), whole.to_numpy(), equal_nan=True)


def test_seasons_open_and_close_after_three_days():
    warm = [13, 13, 11, 13, 13, 13, 20, 4, 4, 20, 4, 4, 4, 0, 13]
    expected = [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0]
    assert seasons.fire_season(warm).astype(int).tolist() == expected


def test_gaps_and_missing_columns_are_named(places):
    with pytest.raises(DomainError) as caught:
        seasons.canadian_years(places[0].drop(places[0].index[5]), 49.5)
    assert caught.value.field == "weather"
    with pytest.raises(DomainError) as caught:
        seasons.canadian_years(places[0].drop(columns="rain_mm"), 49.5)
    assert caught.value.field == "rain_mm"


def _warm_years() -> pd.DataFrame:
    day = np.arange(900)
    warmth = 15 + 15 * np.sin((day - 100) * 2 * np.pi / 365.25)
    air = {"temperature_c": warmth, "temperature_max_c": warmth, "relative_humidity_pct": 30.0}
    index = pd.date_range("2015-01-01", periods=len(day))
    return pd.DataFrame({**air, "wind_speed_m_s": 4.0, "rain_mm": 0.0}, index=index)


def test_a_missing_day_ends_neither_the_season_nor_the_drought():
    weather = _warm_years()
    whole, _ = seasons.canadian_years(weather, 45.0)
    gappy = weather.copy()
    gappy.loc["2015-07-01", ["relative_humidity_pct", "temperature_c"]] = np.nan
    ours, _ = seasons.canadian_years(gappy, 45.0)
    assert ours.loc["2015-07-01"].isna().any()
    assert ours.loc["2015-07-02":"2015-09-30"].notna().all(axis=None)
    # A day of drying is all that is lost.
    assert 0 < whole.loc["2015-09-01", "dc"] - ours.loc["2015-09-01", "dc"] < 12
    assert ours.loc["2015-09-01", "fwi"] == pytest.approx(whole.loc["2015-09-01", "fwi"], abs=0.2)


def test_a_long_gap_is_not_a_winter_that_wets_everything():
    weather = _warm_years()
    whole, _ = seasons.canadian_years(weather, 45.0)
    gappy = weather.copy()
    gappy.loc["2015-09-01":, "temperature_c"] = gappy.loc["2015-09-01":, "temperature_c"].where(
        gappy.loc["2015-09-01":].index >= pd.Timestamp("2016-03-01")
    )
    ours, _ = seasons.canadian_years(gappy, 45.0)
    assert ours.loc["2015-09-10":"2015-12-01", "dc"].isna().all()  # too many days are missing to go on
    assert ours.loc["2016-06-01", "dc"] > 0.7 * whole.loc["2016-06-01", "dc"]  # from autumn's last DC, not from 15


def test_resuming_within_a_gap_gives_what_one_run_gives():
    weather = _warm_years()
    weather.loc["2015-07-01":"2015-07-03", "relative_humidity_pct"] = np.nan
    whole, _ = seasons.canadian_years(weather, 45.0)
    first, carried = seasons.canadian_years(weather.loc[:"2015-07-02"], 45.0)
    second, _ = seasons.canadian_years(weather.loc["2015-07-03":], 45.0, carried)
    pd.testing.assert_frame_equal(pd.concat([first, second]), whole, check_freq=False)
