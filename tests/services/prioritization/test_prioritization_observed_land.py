"""What soil moisture and burn scars change in WFPI, WLFP and WFSP; and that nothing seen changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from services.prioritization import weather
from services.prioritization.prefire import (
    burn_scar,
    conditions,
    danger,
    danger_grid,
    danger_run,
    fire_probability,
    fuels,
    soil_moisture,
)
from shared.errors import DomainError

EFFECT = soil_moisture.SoilMoistureEffect()
INDICES = ("wfpi", "wlfp", "wfsp")


@pytest.mark.parametrize("resolution_km", [9, 36])
def test_ease_grid_cells_agree_with_proj(resolution_km):
    rng = np.random.default_rng(3)
    longitude, latitude = rng.uniform(-180, 180, 5000), rng.uniform(-80, 80, 5000)
    x, y = Transformer.from_crs(4326, 6933, always_xy=True).transform(longitude, latitude)
    cell = soil_moisture.EASE_CELL_M[resolution_km]
    row, column = soil_moisture.ease_cells(longitude, latitude, resolution_km)
    np.testing.assert_array_equal(row, np.floor((7314540.830638599 - y) / cell))
    np.testing.assert_array_equal(column, np.floor((x + 17367530.445161372) / cell))


def test_ease_grid_cells_agree_with_their_definition():
    row, column = soil_moisture.ease_cells(np.array([-179.999, 0.01]), np.array([85.0, -0.01]))
    assert (row[0], column[0]) == (0, 0)
    assert (row[1], column[1]) == (812, 1928)  # 1624 x 3856 cells: the equator and Greenwich split them evenly


@settings(max_examples=80, deadline=None)
@given(rg=st.floats(0, 1), w=st.floats(0, 1), a=st.floats(-0.5, 1), s=st.floats(0, 1))
def test_greenness_is_untouched_without_weight_or_at_the_middle(rg, w, a, s):
    assert soil_moisture.greenness_with_soil_moisture(np.array(rg), np.array(0.0), np.array(a), np.array(s)) == rg
    assert soil_moisture.greenness_with_soil_moisture(np.array(rg), np.array(w), np.array(a), np.array(0.5)) == rg
    changed = soil_moisture.greenness_with_soil_moisture(np.array(rg), np.array(w), np.array(a), np.array(s))
    assert changed == pytest.approx(np.clip(rg * (1 + 2 * w * a * (s - 0.5)), 0, 1), abs=1e-15)  # the stated formula
    assert (changed - rg) * (s - 0.5) * a >= 0  # wetter is greener in the growing season, and the other way round


def test_position_lies_between_the_cells_own_5_and_95_per_cent():
    soil = np.array([0.05, 0.2, 0.35, 0.5, 0.01, np.nan, 0.2])
    low, high = np.full(7, 0.05), np.array([0.35, 0.35, 0.35, 0.35, 0.35, 0.35, 0.05])
    np.testing.assert_allclose(soil_moisture.position(soil, low, high), [0, 0.5, 1, 1, 0, 0.5, 0.5])


def test_alpha_changes_sign_with_the_season():
    summer, winter = (soil_moisture.growing_season(d, np.array(35.0)) for d in (180.0, 362.6))
    assert soil_moisture.alpha(summer, np.array(1.0), np.array(1.0), EFFECT) > 0
    assert soil_moisture.alpha(winter, np.array(1.0), np.array(1.0), EFFECT) < 0
    assert soil_moisture.growing_season(180.0, np.array(-35.0)) == pytest.approx(0, abs=1e-6)


def _soil(places: list[tuple[float, float]], time: pd.Timestamp, moisture: float = 0.05, sd: float = 0.03):
    row, column = soil_moisture.ease_cells(*np.array(places).T)
    table = pd.DataFrame({"time": time, "row": row, "column": column, "soil_moisture": moisture})
    return table.assign(soil_moisture_sd=sd, count=3)


def test_weight_is_quality_times_age_and_ends_at_the_latitude_limit_and_at_the_cut_off(time):
    def weight(latitude: float, age_h: float, sd: float = 0.03) -> float:
        table = _soil([(-107.0, latitude)], time - pd.Timedelta(hours=age_h), sd=sd)
        layer = soil_moisture.latest_layer([table], time, EFFECT)
        if layer is None:
            return 0.0
        return float(layer.at(np.array([[-107.0]]), np.array([[latitude]]), np.float64)[1][0, 0])

    assert weight(33.0, 1) > weight(33.0, 48) > 0
    assert weight(33.0, 96) / weight(33.0, 0) == pytest.approx(np.exp(-1), rel=1e-6)  # tau is four days
    assert weight(33.0, 0, 0.06) == pytest.approx(0.5)  # quality halves at the stated standard deviation
    assert weight(41.0, 1) == weight(-41.0, 1) == 0
    assert weight(33.0, -1) == 0  # not known yet


def test_latest_soil_moisture_counts(time):
    ages = ((30, 0.3), (2, 0.1), (60, 0.4))
    tables = [_soil([(-107.0, 33.0)], time - pd.Timedelta(hours=hours), value) for hours, value in ages]
    layer = soil_moisture.latest_layer(tables, time, EFFECT)
    assert layer is not None
    assert layer.at(np.array([[-107.0]]), np.array([[33.0]]), np.float64)[0][0, 0] == 0.1


def test_soil_moisture_of_another_grid_or_scale_is_named(time):
    table = _soil([(140.0, -33.0)], time)
    with pytest.raises(DomainError, match="36 km") as caught:
        soil_moisture.latest_layer([table], time, EFFECT, 36)
    assert caught.value.field == "soil_moisture"
    with pytest.raises(DomainError, match="12"):
        soil_moisture.latest_layer([table.assign(soil_moisture=12.0)], time, EFFECT)
    assert soil_moisture.latest_layer([table.assign(soil_moisture=np.nan)], time, EFFECT) is None


@pytest.mark.parametrize("usgs", [False, True])
def test_burn_scar_is_local_and_heals(make, time, usgs):
    grid = danger_grid.GeographicGrid(np.arange(33, 34, 0.05), np.arange(-108, -107, 0.05))
    if usgs:
        grid = danger_grid.usgs_window(*np.broadcast_arrays(*grid.corners()))

    def scar(hours_ago: float) -> np.ndarray:
        table = make["burned_area"](-107.5, 33.5, hours_ago)
        return burn_scar.burn_scar([table], grid, time, burn_scar.BurnScarEffect())

    fresh = scar(10)
    assert 0.5 < fresh.max() <= 0.9
    assert (25 <= (fresh > 0).sum() <= 32) if usgs else (1 <= (fresh > 0).sum() <= 6)
    longitude, latitude = np.broadcast_arrays(*grid.places(slice(None)))
    assert np.hypot(longitude[fresh > 0] + 107.5, latitude[fresh > 0] - 33.5).max() < 0.06
    assert scar(24 * 365).max() == pytest.approx(fresh.max() / np.e, rel=0.01)
    assert scar(-5).max() == 0


def _rated(make, time, soil=(), burned=(), version="2000", month=6, grid="fuels", effects=None, fuel=None):
    when = time + pd.DateOffset(months=month - time.month)
    air = make["weather"](hours=48)
    air = air.assign_coords(time=air["time"] + (when - time).to_timedelta64())
    source = danger_run.on_grid(fuels.fuels_from_dataset(make["fuels"](0.1) if fuel is None else fuel), grid)
    daily = conditions.daily_conditions(weather.weather_from_dataset(air), None, when, 2)
    effects = effects or danger.DangerEffects()
    moved = [table.assign(time=table["time"] + (when - time)) for table in soil]
    seen = danger.seen_land(source.grid, moved, list(burned), when, effects)
    return danger_run.rate(source, daily, seen, when, version, effects)


def _everywhere(time, moisture: float) -> pd.DataFrame:
    x, y = np.meshgrid(np.arange(-109.1, -105.9, 0.05), np.arange(31.9, 35.1, 0.05))
    table = _soil(list(zip(x.ravel(), y.ravel(), strict=True)), time - pd.Timedelta(hours=3), moisture)
    return table.drop_duplicates(["row", "column"])


def _changes(rated) -> dict[str, np.ndarray]:
    day = rated.grid.isel(lead_day=0)
    found = {name: (day[name + "_x"] - day[name]).to_numpy() for name in INDICES}
    return {name: change[np.isfinite(change)] for name, change in found.items()}


@pytest.mark.parametrize("grid", ["fuels", "usgs-1km-window"])
@pytest.mark.parametrize("version", ["1998", "2000"])
def test_trend_signs_hold_in_all_three(make, time, version, grid):
    # The form of 1998 itself rises with greenness where RG < TN / 2 (green fuel then takes the place of moist dead
    # fuel), so it is held to its sign where the land is greener than that.
    fuel = None if version == "2000" else make["fuels"](0.1).assign(ndvi=lambda d: d["ndvi"] + 0.15)
    for month, moisture, sign in ((6, 0.06, 1), (6, 0.34, -1), (12, 0.06, -1), (12, 0.34, 1)):
        soil = [_everywhere(time, moisture)]
        changes = _changes(_rated(make, time, soil, version=version, month=month, grid=grid, fuel=fuel))
        for name, change in changes.items():
            assert (sign * change >= 0).all(), (name, month, moisture)
            assert (sign * change > 0).mean() > 0.9, (name, month, moisture)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(first=st.floats(0.03, 0.4), second=st.floats(0.03, 0.4), month=st.sampled_from([2, 6, 9, 12]))
def test_all_three_move_one_way_with_soil_moisture(make, time, first, second, month):
    dry, wet = sorted((first, second))
    layers = [_rated(make, time, [_everywhere(time, value)], month=month).grid.isel(lead_day=0) for value in (dry, wet)]
    growing = soil_moisture.growing_season(float((time + pd.DateOffset(months=month - 6)).dayofyear), 33.0)
    strength = soil_moisture.alpha(growing, np.array(0.4), np.array(0.8), EFFECT)
    for name in INDICES:
        rise = (layers[1][name + "_x"] - layers[0][name + "_x"]).to_numpy()
        assert (np.sign(strength) * rise[np.isfinite(rise)] <= 1e-6).all()  # wetter, and less danger while it grows


@pytest.mark.parametrize("grid", ["fuels", "usgs-1km-window"])
@pytest.mark.parametrize("version", ["1998", "2000"])
def test_no_weight_and_the_middle_change_not_a_bit(make, time, version, grid):
    middle = _everywhere(time, 0.2)  # half way from 0.05 to 0.35
    unknown = _everywhere(time, 0.06).assign(soil_moisture_sd=np.inf)  # quality 0
    for soil in ([], [middle], [unknown]):
        rated = _rated(make, time, soil, version=version, grid=grid)
        for name in INDICES:
            np.testing.assert_array_equal(rated.grid[name].to_numpy(), rated.grid[name + "_x"].to_numpy())
        for name in INDICES if rated.stack else ():
            np.testing.assert_array_equal(rated.stack.layers[name], rated.stack.layers[name + "_x"])
        assert rated.tally.report()["share_touched_by_satellites"] == 0


@pytest.mark.parametrize("version", ["1998", "2000"])
def test_scar_lowers_all_three_there_only(make, time, version):
    rated = _rated(make, time, burned=[make["burned_area"](-107.4, 34.1, 10)], version=version)
    for change in _changes(rated).values():
        assert change.min() < 0 and change.max() == 0 and (change < 0).sum() <= 4
    report = rated.tally.report()
    assert report["burn_scar_cells"] == (_changes(rated)["wfpi"] < 0).sum()
    assert report["share_changed_by_satellites"] == pytest.approx(report["burn_scar_cells"] / report["burnable_cells"])


def test_a_scar_fades_from_wfpi_as_it_regrows(make, time):
    lost = []
    for days in (1, 100, 365, 2000):
        table = make["burned_area"](-107.4, 34.1, 24 * days)
        lost.append(-_changes(_rated(make, time, burned=[table]))["wfpi"].min())
    assert lost[0] > lost[1] > lost[2] > 10 * lost[3]


def test_probabilities_follow_wfpi_with_any_model(make, time):
    shipped = fire_probability.shipped()
    louder = replace(shipped, ignition=replace(shipped.ignition, intercept=shipped.ignition.intercept + 1))
    effects = danger.DangerEffects(probability=louder)
    plain, changed = (_rated(make, time, effects=e).grid.isel(lead_day=0) for e in (None, effects))
    ratio = (changed["wlfp"] / plain["wlfp"]).to_numpy()
    np.testing.assert_allclose(ratio[np.isfinite(ratio)], np.e, rtol=1e-3)
    np.testing.assert_array_equal(plain["wfsp"], changed["wfsp"])


def test_greener_land_is_less_dangerous_and_windier_more(make, time):
    day = _rated(make, time).grid["wfpi"].isel(lead_day=0)
    row = day.sel(latitude=33.5, method="nearest").to_numpy()
    assert (np.diff(row[np.isfinite(row)]) < 0.5).all() and row[0] > row[-1]  # greenness rises eastwards
    column = day.sel(longitude=-108.5, method="nearest").to_numpy()
    column = column[np.isfinite(column)]
    assert column[-1] > column[0]  # wind rises northwards
