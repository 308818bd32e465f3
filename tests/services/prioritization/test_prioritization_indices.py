"""Indices against published values, hand-worked ones and whole reference series."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from services.prioritization import indices
from services.prioritization.large_fire import features
from shared.errors import DomainError

THREE_DAYS = {
    "temperature_c": [17.0, 20.0, 8.5],
    "relative_humidity_pct": [42.0, 21.0, 40.0],
    "wind_speed_m_s": np.array([25.0, 25.0, 17.0]) / 3.6,
    "rain_mm": [0.0, 2.4, 0.0],
}
EXPECTED = {  # Van Wagner & Pickett 1985, the standard three days (cffdrs fwi_01)
    "ffmc": [87.65, 86.20, 86.91],
    "dmc": [8.545, 10.40, 11.80],
    "dc": [19.01, 23.57, 26.05],
    "isi": [10.78, 8.771, 6.478],
    "bui": [8.49, 10.36, 11.74],
    "fwi": [10.04, 9.22, 7.517],
}


def test_canadian_indices_of_the_standard_days():
    result = indices.canadian(**THREE_DAYS, latitude_deg=40.0, month=[4, 4, 4])
    for name, values in EXPECTED.items():
        np.testing.assert_allclose(getattr(result, name).ravel(), values, atol=0.006)


def test_canadian_indices_resume_from_yesterday():
    day = {name: np.asarray(values) for name, values in THREE_DAYS.items()}
    whole = indices.canadian(**day, latitude_deg=40.0, month=[4, 4, 4])
    first = indices.canadian(**{k: v[:2] for k, v in day.items()}, latitude_deg=40.0, month=[4, 4])
    rest = indices.canadian(**{k: v[2:] for k, v in day.items()}, latitude_deg=40.0, month=[4], state=first.state)
    np.testing.assert_array_equal(rest.fwi[-1], whole.fwi[-1])


def _ffmc(previous, t, h, wind_km_h, rain, constant):
    """Fine fuel moisture code of Van Wagner & Pickett (1985), with a choice of equation 1's constant."""
    m = constant * (101 - previous) / (59.5 + previous)
    if rain > 0.5:
        r = rain - 0.5
        wetter = 42.5 * r * np.exp(-100 / (251 - m)) * (1 - np.exp(-6.93 / r))
        m = min(m + wetter + (0.0015 * (m - 150) ** 2 * np.sqrt(r) if m > 150 else 0), 250)
    drying = 0.942 * h**0.679 + 11 * np.exp((h - 100) / 10) + 0.18 * (21.1 - t) * (1 - np.exp(-0.115 * h))
    wetting = 0.618 * h**0.753 + 10 * np.exp((h - 100) / 10) + 0.18 * (21.1 - t) * (1 - np.exp(-0.115 * h))
    share = h / 100 if m > drying else 1 - h / 100
    rate = 0.424 * (1 - share**1.7) + 0.0694 * np.sqrt(wind_km_h) * (1 - share**8)
    k = rate * 0.581 * np.exp(0.0365 * t)
    if m > drying:
        m = drying + (m - drying) * 10**-k
    elif m < wetting:
        m = wetting - (wetting - m) * 10**-k
    return 59.5 * (250 - m) / (constant + m)


def test_canadian_series_agree_with_cffdrs(real_data):
    """The file was made with 147.2 in FFMC, the library has 147.27723: one oracle, both constants, both agree."""
    with xr.open_dataset(real_data / "fwi" / "cffdrs_test_fwi.nc") as data:
        t, rh, wind, rain = (data[name].values.astype(float) for name in ("tas", "rh", "ws", "pr"))
        month, latitude = data["time"].dt.month.values, float(data["lat"])
        reference = {name: data[name].isel(test=0).values for name in EXPECTED}
    ours = indices.canadian(t, rh, wind / 3.6, rain, latitude_deg=latitude, month=month)
    for name in ("dmc", "dc", "bui"):
        np.testing.assert_allclose(getattr(ours, name).ravel(), reference[name], atol=1e-9)
    old, new = [85.0], [85.0]
    for day in zip(t, rh, wind, rain, strict=True):
        old.append(_ffmc(old[-1], *day, 147.2))
        new.append(_ffmc(new[-1], *day, 147.27723))
    np.testing.assert_allclose(old[1:], reference["ffmc"], atol=1e-6)
    np.testing.assert_allclose(ours.ffmc.ravel(), new[1:], atol=1e-3)
    assert np.abs(ours.fwi.ravel() - reference["fwi"]).max() < 0.25  # what the constant is worth


def test_canadian_series_agree_with_gfwed(real_data):
    """Four sites, the longest unbroken season of each, from its first day's codes; GFWED has 147.2 and float32."""
    tolerance = {"ffmc": 0.25, "dmc": 0.25, "dc": 0.5, "bui": 0.35, "fwi": 1.5}
    with xr.open_dataset(real_data / "fwi" / "GFWED_sample_2017.nc") as data:
        for site in range(data.sizes["loc"]):
            day = data.isel(loc=site).load()
            valid = np.flatnonzero(np.isfinite(day["FFMC"].values))
            run = max(np.split(valid, np.flatnonzero(np.diff(valid) > 1) + 1), key=len)
            first, rest = run[0], run[1:]
            season = day.isel(time=rest)
            result = indices._fire_library().cffwis(
                season["tas"].values.astype(float),
                season["rh"].values.astype(float),
                season["sfcwind"].values.astype(float) / 3.6,
                season["prbc"].values.astype(float),
                float(day["lat"]),
                season["time"].dt.month.values,
                initial_ffmc=float(day["FFMC"][first]),
                initial_dmc=float(day["DMC"][first]),
                initial_dc=float(day["DC"][first]),
            )
            for name, allowed in tolerance.items():
                error = np.abs(getattr(result, name).ravel() - season[name.upper()].values)
                assert error.max() < allowed, (str(day["loc"].values), name)


def test_overwintering_wets_the_drought_code():
    dry, wet = indices.overwintered_dc([400.0, 400.0], [50.0, 400.0])
    assert 15 <= wet < dry < 400


KBDI_RAIN = [10, 0, 0.1, 6, 0, 0, 0.5, 0.3, 0, 1]
KBDI_TEMPERATURE = [20, 30, 20, 30, 30, 25, 40, 35, 20, 20]


@pytest.mark.parametrize(
    ("start", "annual", "end"), [(0, 1, 7.48131), (10, 1, 12.34965), (0, 100, 8.88848), (203.2, 1, 197.49994)]
)
def test_kbdi_of_ten_days(start, annual, end):
    values, _ = indices.kbdi(KBDI_RAIN, KBDI_TEMPERATURE, annual, start)
    assert values.ravel()[-1] == pytest.approx(end, abs=1e-4)


def test_kbdi_uses_8_30_and_equation_18():
    values, _ = indices.kbdi([0.0], [30.0], 1000.0, 50.0)
    drying = (
        (203.2 - 50) * (0.968 * np.exp(0.0875 * 30 + 1.5552) - 8.30) / (1 + 10.88 * np.exp(-0.001736 * 1000)) * 1e-3
    )
    assert values.ravel()[0] == pytest.approx(50 + drying, abs=1e-9)


def test_kbdi_resumes_within_a_wet_spell():
    whole, _ = indices.kbdi([4.0, 4.0, 0.0], [25.0, 25.0, 25.0], 500.0, 100.0)
    _, state = indices.kbdi([4.0], [25.0], 500.0, 100.0)
    rest, _ = indices.kbdi([4.0, 0.0], [25.0, 25.0], 500.0, state=state)
    np.testing.assert_array_equal(rest.ravel(), whole.ravel()[1:])


def test_fosberg_is_capped_at_zero_moisture_and_30_mph():
    assert indices.fosberg(60.0, 0.0, 30 * 0.44704) == pytest.approx(100, abs=0.6)
    assert indices.fosberg(60.0, 0.0, 60.0) == 100


@pytest.mark.parametrize(
    ("t", "rh", "wind", "value"), [(35, 10, 10, 63.820), (25, 30, 5, 24.735), (10, 80, 3, 6.042), (20, 50, 8, 30.580)]
)
def test_fosberg_by_hand(t, rh, wind, value):
    assert indices.fosberg(t, rh, wind) == pytest.approx(value, abs=1e-3)
    x = indices.equilibrium_moisture_pct(t, rh) / 30
    damping = 1 - 2 * x + 1.5 * x**2 - 0.5 * x**3
    assert damping * np.sqrt(1 + (wind / 0.44704) ** 2) / 0.3002 == pytest.approx(value, abs=1e-3)


def test_haines_of_the_three_bands():
    assert indices.haines(20, 12, 2, "low") == 6
    assert indices.haines(20, 12, 5, "mid") == 5
    assert indices.haines(10, -12, -12, "high") == 6


def test_hot_dry_windy_takes_the_worst_level_within_500_m():
    vpd = indices.vapour_pressure_deficit_hpa(28.0, 20.0)
    value = indices.hot_dry_windy([30.0, 28.0, 20.0], [30.0, 20.0, 5.0], [5.0, 9.0, 30.0], [10.0, 400.0, 900.0])
    assert value == pytest.approx(vpd * 9.0, rel=1e-3)


def test_lfp_takes_mph_and_fahrenheit():
    t, depression_c = 30.0, 50 / 1.8
    humidity = (
        100
        * (6.108 * np.exp(17.27 * (t - depression_c) / (t - depression_c + 237.3)))
        / (6.108 * np.exp(17.27 * t / (t + 237.3)))
    )
    value = indices.large_fire_potential(40 * 0.44704, t, humidity)
    assert value == pytest.approx(80, abs=0.01)
    assert indices.large_fire_potential(40 * 0.44704, t, humidity, 0.5) == pytest.approx(40, abs=0.01)
    assert indices.sawti_category([5.0, 80.0, np.nan], 1).tolist()[:2] == [0.0, 4.0]
    assert np.isnan(indices.sawti_category(np.nan, 2))


def test_unknown_sawti_zone_is_named():
    with pytest.raises(DomainError) as caught:
        indices.sawti_category(10.0, 7)
    assert caught.value.field == "zone"


@settings(max_examples=60, deadline=None)
@given(t=st.floats(-30, 50), rh=st.floats(1, 100))
def test_dew_point_inverts_the_vapour_pressure(t, rh):
    dew = indices.dew_point_c(t, rh)
    assert indices.vapour_pressure_deficit_hpa(dew, 100) == pytest.approx(0, abs=1e-9)
    saturation = 6.108 * np.exp(17.27 * t / (t + 237.3))
    assert 6.108 * np.exp(17.27 * dew / (dew + 237.3)) == pytest.approx(saturation * rh / 100, rel=1e-9)


def test_missing_weather_is_missing_danger():
    for values in (
        indices.fosberg(np.nan, 20, 5),
        indices.fosberg(30, np.nan, 5),
        indices.equilibrium_moisture_pct(30, np.nan),
        indices.forest_fire_danger(30, 20, np.nan, 10),
        indices.large_fire_potential(5, 30, np.nan),
        indices.drought_factor_dry(np.nan),
    ):
        assert np.isnan(values)


def test_forest_fire_danger_agrees_with_the_published_column(real_data):
    table = pd.read_csv(real_data / "large_fire" / "victoria_2008_2018.csv.gz", low_memory=False)
    ours = indices.forest_fire_danger(
        table["T_SFC_historical"],
        table["RH_SFC_historical"],
        table["WindMagKmh_SFC_historical"] / 3.6,
        table["DF_SFC_historical"],
    )
    difference = np.abs(ours - table["FFDI_historical"])
    assert np.median(difference) < 0.05  # the column's own rounding of its inputs
    assert np.corrcoef(ours, table["FFDI_historical"])[0, 1] > 0.95


def test_features_are_the_same_for_training_and_for_rating():
    row = pd.DataFrame({"T_SFC_historical": [30.0], "RH_SFC_historical": [20.0], "WindMagKmh_SFC_historical": [36.0]})
    row = row.assign(KBDI_historical=80.0, Curing_historical=90.0, DF_SFC_historical=9.0)
    trained = features.from_victoria(row.assign(FFDI_historical=30.0, GFDI_historical=10.0))
    served = features.derive(
        pd.DataFrame(
            {"temperature_c": [30.0], "relative_humidity_pct": [20.0], "wind_speed_m_s": [10.0], "kbdi_mm": [80.0]}
        )
    )
    for feature in features.features_of("loop"):
        assert trained[feature.name][0] == served[feature.name][0], feature.name
