"""The five processes on a made-up region, through the store, as a service runs them."""

from __future__ import annotations

import json
import subprocess
import sys
import time as clock

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from services.prioritization.large_fire import model as large_fire_model
from shared.contracts import grids, schema, tables
from shared.errors import DomainError


@pytest.fixture
def danger(room, make, time):
    refs = {"weather": room.grid("weather.nc", make["weather"]()), "fuels": room.grid("fuels.nc", make["fuels"]())}
    return room.run("rate-prefire-danger", time=time, **refs)


def test_parent_stays_light():
    code = "import sys, services.prioritization.processes as p; print({'numpy', 'pandas'} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


def test_rate_active_fires(room, make, time):
    weather = room.grid("weather.nc", make["weather"]())
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    fuels = room.grid("fuels.nc", make["fuels"]())
    out = room.run("rate-active-fires", incidents=incidents, weather=weather, time=time, fuels=fuels)
    ratings = schema.read_table(room.path(out["ratings"]), tables.RATINGS).set_index("incident_id")
    assert list(ratings.index) == ["A", "B"]  # C was not known yet
    assert (ratings["probability_low"] <= ratings["probability"]).all()
    assert (ratings["probability"] <= ratings["probability_high"]).all()
    assert ratings.loc["B", "wind_speed_m_s"] > ratings.loc["A", "wind_speed_m_s"]
    assert ratings.loc["B", "probability"] >= ratings.loc["A", "probability"]  # same air, more wind
    assert (ratings["imputed"] == "").all()
    assert ratings["drivers"].str.count(r"\([+-]\d\.\d\d\)").eq(3).all()
    assert ratings.loc["A", "temperature_c"] == pytest.approx(33, abs=0.5)  # the hottest hour of the cycle


def test_unknown_drought_is_imputed_and_said(room, make, time):
    weather = room.grid("weather.nc", make["weather"]())
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    out = room.run("rate-active-fires", incidents=incidents, weather=weather, time=time)
    ratings = schema.read_table(room.path(out["ratings"]), tables.RATINGS)
    assert (ratings["imputed"] == "kbdi_mm").all()
    assert (ratings["probability"] > 0.005).all()


def test_fire_off_the_weather_grid_is_imputed_not_safe(room, make, time):
    weather = room.grid("weather.nc", make["weather"]().isel(longitude=slice(6, None)))
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    out = room.run("rate-active-fires", incidents=incidents, weather=weather, time=time)
    ratings = schema.read_table(room.path(out["ratings"]), tables.RATINGS).set_index("incident_id")
    assert ratings.loc["A", "imputed"] == "temperature_c,relative_humidity_pct,wind_speed_m_s,kbdi_mm"
    assert ratings.loc["A", "probability"] > 0.01


def test_weather_issued_after_the_cut_off_changes_nothing(room, make, time):
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    weather = make["weather"](hours=48)
    late = weather.isel(time=[-1]).assign_coords(time=[pd.Timestamp("2022-06-10T19:30:00")])
    late["temperature_c"] += 15
    late["issued_at"] = ("time", [np.datetime64("2022-06-10T19:30:00", "ns")])
    both = xr.concat([weather, late], dim="time").sortby("time")
    first = room.run("rate-active-fires", incidents=incidents, weather=room.grid("a.nc", weather), time=time)
    second = room.run("rate-active-fires", incidents=incidents, weather=room.grid("b.nc", both), time=time)
    columns = ["incident_id", "probability"]
    a, b = (schema.read_table(room.path(out["ratings"]), tables.RATINGS)[columns] for out in (first, second))
    pd.testing.assert_frame_equal(a, b)


def test_hot_day_in_wrong_unit_is_refused_by_name(room, make, time):
    weather = make["weather"]()
    weather["temperature_c"] = weather["temperature_c"] + 273.15
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    with pytest.raises(DomainError, match="temperature_c") as caught:
        room.run("rate-active-fires", incidents=incidents, weather=room.grid("weather.nc", weather), time=time)
    assert caught.value.field == "temperature_c"


def test_missing_variable_is_named(room, make, time):
    weather = room.grid("weather.nc", make["weather"]().drop_vars("relative_humidity_pct"))
    with pytest.raises(DomainError) as caught:
        room.run("rate-prefire-danger", weather=weather, fuels=room.grid("fuels.nc", make["fuels"]()), time=time)
    assert caught.value.field == "relative_humidity_pct"


def test_danger_grid_keeps_the_contract(room, danger):
    grid = grids.read_netcdf(room.path(danger["danger"]), grids.DANGER)
    assert grid.sizes["lead_day"] == 8
    burnable = grid["mask_code"].to_numpy() == 0
    assert np.isfinite(grid["wfpi"].to_numpy()[:, burnable]).all()
    assert np.isnan(grid["wfpi"].to_numpy()[:, ~burnable]).all()
    code = grid["wfpi_code"].to_numpy()
    assert (code[:, ~burnable] == grid["mask_code"].to_numpy()[~burnable]).all()
    for name in ("wfpi", "wlfp", "wfsp"):
        np.testing.assert_array_equal(grid[name].to_numpy(), grid[name + "_x"].to_numpy())
    report = json.loads(room.path(danger["report"]).read_text())
    assert report["share_changed_by_satellites"] == 0
    assert room.path(danger["map"]).read_bytes()[:4] == b"\x89PNG"


def test_danger_is_quick_and_repeatable(room, make, time):
    refs = {"weather": room.grid("weather.nc", make["weather"]()), "fuels": room.grid("fuels.nc", make["fuels"]())}
    first = room.run("rate-prefire-danger", time=time, **refs)
    began = clock.perf_counter()
    second = room.run("rate-prefire-danger", time=time, cycle="again", **refs)
    assert clock.perf_counter() - began < 10
    for name in ("danger", "map", "report"):
        assert first[name]["sha256"] == second[name]["sha256"]


def test_nan_block_is_no_data_not_zero_danger(room, make, time):
    weather = make["weather"]()
    weather["temperature_c"][:, :4, :4] = np.nan
    refs = {"weather": room.grid("weather.nc", weather), "fuels": room.grid("fuels.nc", make["fuels"]())}
    out = room.run("rate-prefire-danger", time=time, **refs)
    grid = grids.read_netcdf(room.path(out["danger"]), grids.DANGER)
    block = grid.sel(latitude=slice(32.3, 32.7), longitude=slice(-108.9, -108.3))
    assert np.isnan(block["wfpi"].to_numpy()).all()
    assert (block["wfpi_code"].to_numpy() == 255).all()
    report = json.loads(room.path(out["report"]).read_text())
    assert report["burnable_cells_unknown_on_day_0"] > 0


def test_short_weather_leaves_later_days_unknown(room, make, time):
    refs = {"weather": room.grid("w.nc", make["weather"](hours=72)), "fuels": room.grid("f.nc", make["fuels"]())}
    out = room.run("rate-prefire-danger", time=time, **refs)
    assert json.loads(room.path(out["report"]).read_text())["lead_days_without_weather"] == [3, 4, 5, 6, 7]


def test_dry_soil_seen_raises_danger_there_only(room, make, time, danger):
    from services.prioritization.prefire.soil_moisture import ease_cells

    row, column = ease_cells(np.array([-108.0]), np.array([33.5]))
    table = pd.DataFrame(
        {"time": [time - pd.Timedelta(hours=5)], "row": row, "column": column, "soil_moisture": [0.04]}
        | {"soil_moisture_sd": [0.03], "count": [4], "mode": ["nominal"]}
    )
    soil = room.table("soil.parquet", table, "SOIL_MOISTURE")
    refs = {"weather": room.grid("w.nc", make["weather"]()), "fuels": room.grid("f.nc", make["fuels"]())}
    out = room.run("rate-prefire-danger", time=time, soil_moisture=[soil], **refs)
    grid = grids.read_netcdf(room.path(out["danger"]), grids.DANGER)
    change = (grid["wfpi_x"] - grid["wfpi"]).isel(lead_day=0).fillna(0)
    assert float(change.max()) > 1 and float(change.min()) == 0
    assert 1 <= int((change != 0).sum()) <= 6
    assert float(change.sel(longitude=-108.0, latitude=33.5, method="nearest")) > 1
    for name in ("wlfp", "wfsp"):
        assert float((grid[name + "_x"] - grid[name]).max()) > 0


def test_fuel_moisture_forecast_feeds_danger_and_ratings(room, make, time):
    weather, fuels = room.grid("w.nc", make["weather"]()), room.grid("f.nc", make["fuels"]())
    stations = pd.DataFrame(
        {
            "time": pd.date_range(time - pd.Timedelta(hours=23), time, freq="h"),
            "longitude_deg": -108.2,
            "latitude_deg": 33.2,
            "fuel_moisture_10h_pct": 12 + 0.1 * np.arange(24),
        }
    )
    observations = room.plain("stations.parquet", stations)
    plain = room.run("forecast-fuel-moisture", weather=weather, time=time)
    corrected = room.run("forecast-fuel-moisture", weather=weather, time=time, observations=observations)
    assert corrected["observations_used"] == 24
    a, b = (grids.read_netcdf(room.path(out["fuel_moisture"])) for out in (plain, corrected))
    at = {"longitude": -108.2, "latitude": 33.2, "method": "nearest"}
    later = slice(time.tz_localize(None), (time + pd.Timedelta(hours=24)).tz_localize(None))
    gain = (b - a).sel(**at).sel(time=later)
    assert float(gain["fuel_moisture_10h_pct"].min()) > 1  # wetter than the air alone says, a day ahead too
    assert float(gain["fuel_moisture_10h_variance"].max()) < 0
    dry = room.run("rate-prefire-danger", weather=weather, fuels=fuels, time=time, fuel_moisture=plain["fuel_moisture"])
    wet = room.run(
        "rate-prefire-danger", weather=weather, fuels=fuels, time=time, fuel_moisture=corrected["fuel_moisture"]
    )
    d, w = (grids.read_netcdf(room.path(out["danger"])).isel(lead_day=0).sel(**at) for out in (dry, wet))
    assert float(w["wfpi"]) < float(d["wfpi"])
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    refs = {"incidents": incidents, "weather": weather, "fuels": fuels, "time": time}
    moistures = []
    for out in (plain, corrected):
        rated = room.run("rate-active-fires", fuel_moisture=out["fuel_moisture"], **refs)
        ratings = schema.read_table(room.path(rated["ratings"]), tables.RATINGS).set_index("incident_id")
        moistures.append(ratings.loc["A", "dead_fuel_moisture_10h_pct"])
    assert moistures[1] > moistures[0] + 1


def test_build_targets(room, make, time, area, danger):
    refs = {
        "incidents": room.table("incidents.parquet", make["incidents"](), "INCIDENTS"),
        "ratings": room.table("ratings.parquet", make["ratings"](), "RATINGS"),
        "danger": danger["danger"],
        "fire_arrival": [room.grid("fire_arrival_A.nc", make["arrival"]())],
        "observed": room.plain(
            "observed.parquet", pd.DataFrame({"longitude_deg": [-108.2], "latitude_deg": [33.2], "time": [time]})
        ),
    }
    out = room.run("build-targets", time=time, area=area, **refs)
    targets = schema.read_table(room.path(out["targets"]), tables.TARGETS)
    assert out["active_count"] + out["prefire_count"] == len(targets)
    assert set(targets["kind"]) == {"active", "prefire"}
    report = json.loads(room.path(out["report"]).read_text())
    assert [fire["incident_id"] for fire in report["fires"]] == ["A", "B"]
    assert "20.0 %" in report["fires"][0]["reason"]
    assert report["incidents_not_yet_known"] == ["C"]


def test_missing_column_of_observed_is_named(room, make, time, area, danger):
    refs = {
        "incidents": room.table("incidents.parquet", make["incidents"](), "INCIDENTS"),
        "ratings": room.table("ratings.parquet", make["ratings"](), "RATINGS"),
        "danger": danger["danger"],
        "observed": room.plain("observed.parquet", pd.DataFrame({"longitude_deg": [-108.2], "time": [time]})),
    }
    with pytest.raises(DomainError, match="latitude_deg") as caught:
        room.run("build-targets", time=time, area=area, **refs)
    assert caught.value.field == "observed"


def test_training_reproduces_the_shipped_model(room, real_data):
    table = real_data / "large_fire" / "victoria_2008_2018.csv.gz"
    copy = room.inputs / table.name
    copy.write_bytes(table.read_bytes())
    out = room.run("train-large-fire-model", table={"href": copy.as_uri()})
    again = large_fire_model.load(room.path(out["model"])).calibration
    shipped = large_fire_model.load(large_fire_model.shipped_path()).calibration
    assert again.fires == shipped.fires == 6716
    assert again.slope == pytest.approx(shipped.slope, abs=1e-3)
    assert again.resampled == pytest.approx(np.asarray(shipped.resampled), abs=5e-3)
    assert out["auc"] > 0.75
    card = (large_fire_model.shipped_path().parent / "large_fire.md").read_text()
    assert f"| **model** | {out['mcc']:.3f} [" in card
    assert room.path(out["figure"]).read_bytes().startswith(b"\x89PNG")
    assert "SIMULATED" not in room.path(out["card"]).read_text()
