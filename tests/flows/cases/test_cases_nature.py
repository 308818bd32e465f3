"""Weather, soil and land of the nature run: cycles, growing forecast error, rain that wets the soil."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from flows.cases.bundle import Case
from flows.cases.nature.fields import random_field
from flows.cases.nature.land import make_land
from flows.cases.nature.soil import daily_soil_moisture, ease_cells
from flows.cases.nature.weather import make_weather, relative_humidity
from flows.cases.simulated import setting_of
from shared.contracts.grids import FUELS, read_netcdf


def test_random_field_has_unit_variance_and_the_length_asked_for() -> None:
    values, apart = [], []
    for seed in range(60):
        field = random_field(np.random.default_rng(seed), 20.0)
        latitude = np.linspace(30, 40, 200)
        values.append(field.at(-110.0, latitude))
        apart.append(field.at(-110.0, latitude + 20.0 / 111.195))
    one, other = np.concatenate(values), np.concatenate(apart)
    assert np.std(one) == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(np.exp(-0.5), abs=0.05)


def test_relative_humidity_matches_saturation_tables() -> None:
    # e_s(20 C) = 23.39 hPa and e_s(10 C) = 12.28 hPa (WMO tables): 52.5 %.
    assert relative_humidity(np.array(20.0), np.array(10.0)) == pytest.approx(52.5, abs=0.3)


def test_weather_is_warm_dry_and_windy_in_the_afternoon(tiny: Case) -> None:
    with xr.open_dataset(tiny.path("weather_analysis")) as weather:
        local = (weather.time.dt.hour - 7) % 24
        mean = weather.mean(("latitude", "longitude")).groupby(local).mean()
        for name in ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "wind_direction_deg", "rain_mm"):
            assert weather[name].dims == ("time", "latitude", "longitude")
            assert np.isfinite(weather[name]).all()
        assert (weather.wind_direction_deg >= 0).all() and (weather.wind_direction_deg < 360).all()
        issued = weather.issued_at.values - weather.time.values
        assert (issued == np.timedelta64(1, "h")).all()
    assert float(mean.temperature_c[15] - mean.temperature_c[4]) > 10
    assert float(mean.relative_humidity_pct[4] - mean.relative_humidity_pct[15]) > 10
    assert float(mean.wind_speed_m_s[16]) > 1.5 * float(mean.wind_speed_m_s[3])


def test_the_wind_changes_on_the_first_night(tiny: Case) -> None:
    with xr.open_dataset(tiny.path("weather_analysis")) as weather:
        angle = np.radians(weather.wind_direction_deg)
        vector = np.exp(1j * angle).mean(("latitude", "longitude"))
        before = np.angle(vector.sel(time=slice("2025-08-31T18", "2025-09-01T02")).mean().item(), deg=True) % 360
        after = np.angle(vector.sel(time=slice("2025-09-02T00", "2025-09-02T20")).mean().item(), deg=True) % 360
    assert 30 < (after - before) % 360 < 150


def test_forecast_error_grows_with_lead(tiny: Case) -> None:
    setting = setting_of("tiny")
    weather = make_weather(setting, make_land(setting))
    with xr.open_dataset(tiny.path("weather_forecast")) as forecast:
        assert forecast.temperature_c.dims == ("issue", "lead", "latitude", "longitude")
        assert forecast.sizes["lead"] == 193
        assert (forecast.valid_at.values[:, 24] - forecast.issue.values == np.timedelta64(24, "h")).all()
        hours = (forecast.valid_at.values - np.datetime64(setting.start.replace(tzinfo=None))) / np.timedelta64(1, "h")
        truth = weather.at(
            forecast.longitude.values, forecast.latitude.values[:, None], hours[:, :, None, None].astype(float)
        )
        error = np.abs(forecast.temperature_c.values - truth["temperature_c"])
    early, late = error[:, 1:13].mean(), error[:, 168:].mean()
    assert 0.2 < early < 1.0
    assert late > 3 * early


def test_issues_every_six_hours_cover_short_cycles(tiny: Case) -> None:
    with xr.open_dataset(tiny.path("weather_forecast")) as forecast:
        assert forecast.issue.values[0] == np.datetime64("2025-09-01T12:00")
        assert set(np.diff(forecast.issue.values)) == {np.timedelta64(6, "h")}
        assert forecast.issue.values[-1] == np.datetime64("2025-09-03T12:00")


def test_rain_wets_the_soil_and_drought_dries_it() -> None:
    setting = setting_of("tiny")
    weather = make_weather(setting, make_land(setting))
    across, up = setting.mesh(0.1)
    moisture, hours = daily_soil_moisture(setting, weather.land, weather, across, up)
    rain = np.stack([weather.storms.rain_mm(across, up, hour, hour + 24) for hour in hours[:-1]])
    change = np.diff(moisture, axis=0)
    assert rain.sum() > 0
    unsaturated = moisture[:-1] < 0.15
    assert ((rain > 15) & unsaturated).any()
    assert (change[(rain > 15) & unsaturated] > 0).all()
    assert (change[rain < 0.01] < 0).mean() > 0.95
    assert moisture.min() >= 0.02 and moisture.max() < 0.5
    neighbours = np.corrcoef(moisture[5][:, :-1].ravel(), moisture[5][:, 1:].ravel())[0, 1]
    assert neighbours > 0.5  # correlated in space


def test_surface_covers_the_weeks_before_and_both_cycles(tiny: Case) -> None:
    with xr.open_dataset(tiny.path("surface")) as surface:
        assert surface.soil_moisture.dims == ("time", "latitude", "longitude")
        assert surface.burn_time.dims == ("latitude_burn", "longitude_burn")
        assert surface.time.values[0] == np.datetime64("2025-08-11T12:00")
        assert surface.time.values[-1] >= np.datetime64("2025-09-03")
        burned = surface.burn_time.values[np.isfinite(surface.burn_time.values)]
        reference = pd.Timestamp(surface.burn_time.attrs["reference_time"])
        first = reference + pd.Timedelta(seconds=float(burned.min()))
        assert first >= pd.Timestamp("2025-08-30T20:00Z")
        for name in ("vod", "roughness_cm", "clay_fraction", "water_fraction"):
            assert surface[name].dims == ("latitude", "longitude")
            assert np.isfinite(surface[name]).all()


def test_fuels_obey_their_contract(tiny: Case) -> None:
    fuels = read_netcdf(tiny.path("fuels"), FUELS)
    assert fuels.attrs["state_time"] == "2025-09-01T12:00:00Z"
    assert ((fuels.ndvi >= fuels.ndvi_min) & (fuels.ndvi <= fuels.ndvi_max)).all()
    assert ((fuels.kbdi >= 0) & (fuels.kbdi <= 203.2)).all()
    assert fuels.mask_code.dtype == np.uint8


def test_ease_cells_follow_the_projection_formula() -> None:
    cells = ease_cells(setting_of("tiny"))
    # Cylindrical equal-area on the WGS 84 ellipsoid, true at 30 degrees (Snyder 1987, eqs. 10-14 to 10-18, 3-12).
    a, e = 6378137.0, 0.0818191908426
    k0 = np.cos(np.radians(30)) / np.sqrt(1 - e**2 * np.sin(np.radians(30)) ** 2)
    sine = np.sin(np.radians(cells.latitude_deg))
    q = (1 - e**2) * (sine / (1 - e**2 * sine**2) - np.log((1 - e * sine) / (1 + e * sine)) / (2 * e))
    row = (7314540.83 - a * q / (2 * k0)) / 9008.055210146 - 0.5
    column = (cells.longitude_deg + 180) / 360 * 3856 - 0.5
    np.testing.assert_allclose(row, cells.row, atol=1e-3)
    np.testing.assert_allclose(column, cells.column, atol=1e-3)


def test_smap_is_noisy_and_ends_a_day_before_the_cutoff(tiny: Case) -> None:
    smap = pd.read_parquet(tiny.path("smap"))
    assert list(smap.columns) == ["time", "row", "column", "soil_moisture"]
    assert smap.time.max() <= pd.Timestamp(tiny.first_cutoff) - pd.Timedelta(days=1)
    assert smap.time.dt.date.nunique() >= 15
    cells = ease_cells(setting_of("tiny")).set_index(["row", "column"])
    with xr.open_dataset(tiny.path("surface")) as surface:
        place = cells.loc[list(zip(smap.row, smap.column, strict=True))]
        truth = surface.soil_moisture.sel(
            time=xr.DataArray(smap.time.dt.floor("D").dt.tz_convert(None).to_numpy(), dims="n"),
            latitude=xr.DataArray(place.latitude_deg.to_numpy(), dims="n"),
            longitude=xr.DataArray(place.longitude_deg.to_numpy(), dims="n"),
            method="nearest",
        ).values
    error = smap.soil_moisture.to_numpy() - truth
    assert abs(error.mean()) < 0.01
    assert 0.025 < error.std() < 0.04
