"""Index maps: levels chosen by elevation, what is missing named or flagged, a real analysis as netCDF and PNG."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import xarray as xr

from services.prioritization import indices
from services.prioritization.fire_weather import catalogue, index_map, upper_air
from services.prioritization.physical_ranges import physical
from shared.errors import DomainError

SHAPE = (2, 3)


def make_air(**changes) -> upper_air.UpperAir:
    """Six cells at 100, 100, 500, 500, 2000, 2000 m under one atmosphere that cools 6.5 K/km and blows harder aloft."""
    elevation = np.array([[100.0, 100.0, 500.0], [500.0, 2000.0, 2000.0]])
    heights = {1000: 110.0, 950: 540.0, 850: 1460.0, 700: 3010.0, 500: 5570.0}
    levels = {
        pressure: {
            "temperature_c": np.full(SHAPE, 30 - 6.5 * height / 1000),
            "relative_humidity_pct": np.full(SHAPE, 25.0),
            "wind_speed_m_s": np.full(SHAPE, 5 + height / 500),
            "height_m": np.full(SHAPE, height),
        }
        for pressure, height in heights.items()
    }
    surface = {
        "temperature_c": 30 - 6.5 * elevation / 1000,
        "relative_humidity_pct": np.full(SHAPE, 20.0),
        "wind_speed_m_s": np.full(SHAPE, 4.0),
        "elevation_m": elevation,
    }
    latitude, longitude = np.meshgrid([35.0, 36.0], [-120.0, -119.0, -118.0], indexing="ij")
    levels = changes.pop("levels", levels)
    return upper_air.UpperAir(np.datetime64("2018-09-17T00:00"), latitude, longitude, surface | changes, levels)


def test_haines_variant_follows_elevation():
    air = make_air()
    value = index_map.haines(air)
    for cell, variant, (lower, upper, moist) in (((0, 0), *_band(0)), ((0, 2), *_band(1)), ((1, 1), *_band(2))):
        t = {p: air.levels[p]["temperature_c"][cell] for p in (lower, upper, moist)}
        expected = indices.haines(t[lower], t[upper], indices.dew_point_c(t[moist], 25.0), variant)
        assert value[cell] == expected


def _band(index):
    variant, _, pressures = index_map.HAINES_BANDS[index]
    return variant, pressures


@pytest.mark.parametrize("pressure", [950, 700, 500])
def test_a_missing_pressure_level_is_named(pressure):
    air = make_air()
    levels = {p: fields for p, fields in air.levels.items() if p != pressure}
    with pytest.raises(DomainError, match=f"{pressure} hPa") as caught:
        index_map.compute(make_air(levels=levels))
    assert str(pressure) in caught.value.field


def test_hdw_takes_levels_above_ground_up_to_500_m_only():
    value = index_map.hot_dry_windy(make_air())
    vpd_950 = indices.vapour_pressure_deficit_hpa(30 - 6.5 * 0.54, 25.0)
    vpd_1000 = indices.vapour_pressure_deficit_hpa(30 - 6.5 * 0.11, 25.0)
    vpd_surface = indices.vapour_pressure_deficit_hpa(30 - 0.65, 20.0)
    worst = max(vpd_950 * (5 + 540 / 500), vpd_1000 * (5 + 110 / 500), vpd_surface * 4)
    assert value[0, 0] == pytest.approx(worst, rel=2e-3)
    surface_2000 = indices.vapour_pressure_deficit_hpa(17.0, 20.0) * 4
    assert value[1, 1] == pytest.approx(surface_2000, rel=2e-3)  # 850 hPa lies under that ground, 700 too high


def test_a_block_of_nan_stays_without_value_and_is_counted():
    temperature = np.full(SHAPE, 25.0)
    temperature[0, :2] = np.nan
    grid = index_map.compute(make_air(temperature_c=temperature))
    assert np.isnan(grid["ffwi"].to_numpy()[0, :2]).all() and np.isfinite(grid["ffwi"].to_numpy()[1]).all()
    report = index_map.summary(grid)
    assert report["ffwi"]["cells_without_value"] == 2
    assert sum(report["ffwi"]["cells"].values()) == 4


def test_classes_rise_with_danger_and_keep_nan():
    for name, classes in index_map.CLASSES.items():
        assert len(classes.words) == len(classes.breaks) + 1, name
        values = np.array([*classes.breaks, classes.breaks[0] - 1e-6, classes.breaks[-1] + 1e-6, np.nan])
        inside = index_map.classify(values, classes)
        assert np.isnan(inside[-1])
        step = -1 if classes.falling else 1
        order = np.argsort(step * values[:-1], kind="stable")
        assert (np.diff(inside[:-1][order]) >= 0).all(), name
    assert index_map.classify(np.array([3.0, 20.0]), index_map.CLASSES["fuel_moisture_10h"]).tolist() == [4.0, 0.0]


def test_a_real_analysis_becomes_a_map_with_its_date(room, real_data):
    source = real_data / "weather" / "nam_conus_20180917T00.grib2"
    copy = room.inputs / source.name
    copy.write_bytes(source.read_bytes())
    out = room.run("map-fire-weather", weather={"href": copy.as_uri()})
    report = json.loads(room.path(out["report"]).read_text())
    assert report["time"] == "2018-09-17T00:00:00Z"
    grid = xr.open_dataset(room.path(out["indices"]))
    assert grid["haines"].shape == (65, 93)
    assert np.unique(grid["haines"]).tolist() == [2, 3, 4, 5, 6]
    nevada = (grid["longitude"] + 117) ** 2 + (grid["latitude"] - 39) ** 2
    gulf = (grid["longitude"] + 90) ** 2 + (grid["latitude"] - 27) ** 2
    dry, wet = (grid["fuel_moisture_10h"].to_numpy().ravel()[int(d.to_numpy().argmin())] for d in (nevada, gulf))
    assert dry < 8 < wet  # an afternoon in September
    assert room.path(out["map"]).read_bytes().startswith(b"\x89PNG")


def test_a_file_that_is_no_grib_is_refused(tmp_path):
    (tmp_path / "x.grib2").write_bytes(b"no grib at all")
    with pytest.raises(DomainError) as caught:
        upper_air.read_grib(tmp_path / "x.grib2")
    assert caught.value.field == "weather"


def test_wrong_units_are_refused_by_name_and_single_freaks_flagged():
    for call, field in (
        (lambda: indices.fosberg(300.0, 20.0, 5.0), "temperature_c"),
        (lambda: indices.canadian([300.0], [40.0], [5.0], [0.0], 40.0, [7]), "temperature_c"),
        (lambda: indices.kbdi([0.0], [303.0], 800.0), "temperature_c"),
        (lambda: indices.kbdi([0.0], [30.0], 800.0, 700.0), "kbdi_mm"),
        (lambda: indices.haines(293.0, 285.0, 275.0, "low"), "temperature_c"),
        (lambda: indices.large_fire_potential(-4.0, 30.0, 20.0), "wind_speed_m_s"),
        (lambda: indices.hot_dry_windy([30.0], [140.0], [5.0], [10.0]), "relative_humidity_pct"),
    ):
        with pytest.raises(DomainError) as caught:
            call()
        assert caught.value.field == field
    grid = np.full((20, 20), 25.0)
    grid[3, 4] = 300.0
    value = indices.fosberg(grid, 20.0, 5.0)
    assert np.isnan(value[3, 4]) and np.isfinite(np.delete(value.ravel(), 64)).all()
    assert physical([101.0, 50.0], "relative_humidity_pct").tolist() == [100.0, 50.0]


def test_the_catalogue_speaks_of_functions_that_exist():
    for row in catalogue.CATALOGUE:
        assert callable(getattr(indices, row.function))
        assert re.search(r"\d|exact|range only", row.agreement)


def test_ffmc_settles_at_its_equilibrium_under_steady_air():
    days = 60
    air = {"temperature_c": [25.0] * days, "relative_humidity_pct": [30.0] * days, "wind_speed_m_s": [5.0] * days}
    series = indices.canadian(**air, rain_mm=[0.0] * days, latitude_deg=40.0, month=[7] * days)
    assert indices.equilibrium_ffmc(25.0, 30.0) == pytest.approx(float(series.ffmc.ravel()[-1]), abs=0.01)


def test_canadian_starts_from_given_codes_and_works_on_grids():
    grid = np.full((3, 2, 2), 20.0)
    start = (np.full((2, 2), 90.0), np.full((2, 2), 30.0), np.full((2, 2), 300.0))
    result = indices.canadian(grid, grid + 20, grid / 4, 0 * grid, 40.0, [7, 7, 7], start=start)
    assert result.dc.shape == (3, 2, 2) and (result.dc[0] > 300).all()
    one = indices.canadian([20.0] * 3, [40.0] * 3, [5.0] * 3, [0.0] * 3, 40.0, [7] * 3, start=(90.0, 30.0, 300.0))
    np.testing.assert_allclose(result.fwi[:, 0, 1], one.fwi.ravel())


def test_fuel_moisture_component_spans_zero_to_one():
    assert indices.fuel_moisture_component(3.0, 0.5, 5.0) == pytest.approx(1.0)
    assert indices.fuel_moisture_component(1.0, 1.0, 0.0) == 0.0
    assert indices.fuel_moisture_component(2.0, 0.6, 3.0) < indices.fuel_moisture_component(2.0, 0.6, 4.0)
    assert np.isnan(indices.fuel_moisture_component(2.0, np.nan, 3.0))
    with pytest.raises(DomainError):
        indices.fuel_moisture_component(2.0, 60.0, 3.0)
