"""Rating pre-fire danger and refitting its probabilities, through the store, as a service runs them."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import rasterio
from rasterio import warp

from services.prioritization.prefire import danger_grid, fire_history, fuels, legend, vegetation_2001
from shared.contracts import cog, grids
from shared.errors import DomainError


def _refs(room, make, **changed):
    weather = changed.get("weather", make["weather"](hours=48))
    given = changed.get("fuels", make["fuels"](0.1))
    return {"weather": room.grid("weather.nc", weather), "fuels": room.grid("fuels.nc", given)}


def _report(room, out):
    return json.loads(room.path(out["report"]).read_text())


@pytest.fixture
def on_window(room, make, time):
    burned = room.table("burned.parquet", make["burned_area"](-107.4, 34.1, 10), "BURNED_AREA")
    refs = _refs(room, make)
    return room.run("rate-prefire-danger", time=time, grid="usgs-1km-window", lead_days=2, burned_area=[burned], **refs)


def _raster(room, out, name):
    reference = next(ref for ref in out["rasters"] if ref["href"].endswith(f"/{name}"))
    return rasterio.open(room.path(reference))


def test_rasters_lie_on_the_usgs_grid(room, on_window):
    assert len(on_window["rasters"]) == 2 * 7
    with _raster(room, on_window, "wfpi_x_0.tif") as source:
        assert source.dtypes == ("uint8",) and source.nodata == 255
        steps = [(source.transform.c + 2050500) / 1000, (752500 - source.transform.f) / 1000]
        assert steps == [round(step) for step in steps] and source.transform.a == 1000
        lon, lat = danger_grid.usgs_window(np.array([[-109.0, -106.0]]), np.array([[32.0], [35.0]])).places(slice(0, 2))
        x, y = warp.transform("EPSG:4326", source.crs, lon.ravel()[:50], lat.ravel()[:50])
        np.testing.assert_allclose([x, y], danger_grid.project(lon.ravel()[:50], lat.ravel()[:50]), atol=0.01)
        assert source.colormap(1)[150][:3] == legend.colormap()[150]
        assert "254 water" in source.tags()["masks"]
        codes = source.read(1)
    assert {249, 251, 254} <= set(np.unique(codes)) and codes[codes < 248].max() > 90
    with _raster(room, on_window, "wfsp_0.tif") as source:
        tenths = source.read(1)
    assert source.dtypes == ("int16",) and ((tenths >= 2480) == (codes >= 248)).all()
    with _raster(room, on_window, "wfpi_change_0.tif") as source:
        change = source.read(1)
    scar = (change < 0) & (change > -32768)
    assert 25 <= scar.sum() <= 32 and (change[~scar & (change > -32768)] == 0).all()


def test_the_danger_grid_holds_the_means_of_the_rasters(room, on_window):
    coarse = grids.read_netcdf(room.path(on_window["danger"]), grids.DANGER)
    with _raster(room, on_window, "wfpi_1.tif") as source:
        codes, transform = source.read(1), source.transform
    row, column = np.nonzero(codes < 248)
    x, y = transform.c + 1000 * (column + 0.5), transform.f - 1000 * (row + 0.5)
    lon, lat = warp.transform(danger_grid.USGS_CRS, "EPSG:4326", x, y)
    inside = (np.floor(np.array(lon) * 10) == -1075) & (np.floor(np.array(lat) * 10) == 335)
    cell = coarse["wfpi"].isel(lead_day=1).sel(latitude=33.55, longitude=-107.45, method="nearest")
    assert inside.sum() > 80
    assert float(cell) == pytest.approx(codes[row, column][inside].mean(), abs=0.2)
    assert _report(room, on_window)["grid"]["kind"] == "usgs-1km"


def test_targets_come_from_the_1_km_grid_as_from_any(room, make, time, area, on_window):
    refs = {
        "incidents": room.table("incidents.parquet", make["incidents"](), "INCIDENTS"),
        "ratings": room.table("ratings.parquet", make["ratings"](), "RATINGS"),
    }
    plain = room.run("rate-prefire-danger", time=time, lead_days=2, **_refs(room, make))
    counts = [
        room.run("build-targets", time=time, area=area, danger=out["danger"], **refs)["prefire_count"]
        for out in (plain, on_window)
    ]
    assert counts[0] > 500 and abs(counts[1] - counts[0]) < 0.05 * counts[0]


def test_1_km_rating_repeats_to_the_byte(room, make, time):
    refs = _refs(room, make)
    body = {"time": time, "grid": "usgs-1km-window", "lead_days": 1, **refs}
    first, second = (room.run("rate-prefire-danger", cycle=cycle, **body) for cycle in ("a", "b"))
    for name in ("danger", "map", "change_map", "report"):
        assert first[name]["sha256"] == second[name]["sha256"]
    assert [ref["sha256"] for ref in first["rasters"]] == [ref["sha256"] for ref in second["rasters"]]


def test_fuels_given_on_the_usgs_grid_stay_on_their_cells(room, make, time):
    window = danger_grid.usgs_window(np.array([[-108.6, -107.6]]), np.array([[33.0], [33.8]]))
    bands = vegetation_2001.on_usgs_grid(make["fuels"](0.1), window)
    path = room.inputs / "fuels.tif"
    cog.write_cog(path, bands, transform=window.transform, crs=window.crs, nodata=None, attributes={})
    weather = room.grid("weather.nc", make["weather"](hours=48))
    reference = {"href": path.as_uri()}
    out = room.run("rate-prefire-danger", time=time, weather=weather, fuels=reference, lead_days=1)
    with _raster(room, out, "wfpi_0.tif") as source:
        assert source.transform == window.transform and source.shape == window.shape
        own = source.read(1)
    sampled = room.run("rate-prefire-danger", time=time, grid="usgs-1km-window", lead_days=1, **_refs(room, make))
    with _raster(room, sampled, "wfpi_0.tif") as source:
        row = round((source.transform.f - window.transform.f) / 1000)
        column = round((window.transform.c - source.transform.c) / 1000)
        same = source.read(1)[row : row + window.rows, column : column + window.columns]
    np.testing.assert_array_equal(own, same)


def test_unknown_vegetation_is_no_data_and_flagged(room, make, time):
    given = make["fuels"](0.05)
    given["ndvi"][20:26, 40:46] = np.nan
    given["ndvi_min"][40, 10] = 0.9  # above its maximum
    out = room.run("rate-prefire-danger", time=time, **_refs(room, make, fuels=given))
    grid = grids.read_netcdf(room.path(out["danger"]), grids.DANGER)
    block = grid.isel(latitude=slice(20, 26), longitude=slice(40, 46))
    assert np.isnan(block["wfpi"]).all() and (block["wfpi_code"] == 255).all()
    assert (block["quality_flag"][0] == fuels.VEGETATION_MISSING).all()
    assert int(grid["quality_flag"][0, 40, 10]) == fuels.VEGETATION_IMPOSSIBLE
    report = _report(room, out)
    assert report["flagged_cells_on_day_0"]["vegetation_missing"] == 36
    assert report["vegetation_values_taken_out"]["ndvi_min: not below ndvi_max"] == 1
    assert report["burnable_cells_unknown_on_day_0"] == 37


def test_weather_gone_mad_in_a_few_hours_is_flagged_in_a_day_refused(room, make, time):
    weather = make["weather"](hours=200)
    weather["temperature_c"][30:33, 6, 6] = 300.0
    out = room.run("rate-prefire-danger", time=time, **_refs(room, make, weather=weather))
    grid = grids.read_netcdf(room.path(out["danger"]), grids.DANGER)
    place = grid.sel(latitude=33.62, longitude=-107.37, method="nearest")
    assert int(place["quality_flag"][0]) == 8 and int(place["quality_flag"][1]) == 0
    assert 40 < float(place["wfpi"][0]) < 150
    assert _report(room, out)["weather_values_taken_out"]["temperature_c"] == 3
    weather["temperature_c"][24:48] = 300.0
    with pytest.raises(DomainError) as caught:
        room.run("rate-prefire-danger", time=time, **_refs(room, make, weather=weather))
    assert caught.value.field == "temperature_c"


@pytest.mark.parametrize(
    ("what", "field"),
    [("swapped", "ndvi_min"), ("scaled", "ndvi"), ("weather elsewhere", "weather"), ("other projection", "fuels")],
)
def test_what_does_not_fit_is_refused_by_name(room, make, time, what, field):
    given, weather = make["fuels"](0.1), make["weather"](hours=48)
    if what == "swapped":
        given = given.assign(ndvi_min=given["ndvi_max"], ndvi_max=given["ndvi_min"])
    elif what == "scaled":
        given = given.assign(ndvi=given["ndvi"] * 10000)
    elif what == "weather elsewhere":
        weather = weather.assign_coords(longitude=weather["longitude"] + 30)
    else:
        renamed = given.rename(latitude="y", longitude="x").assign_coords(x=np.arange(30) * 1e3, y=np.arange(30) * 1e3)
        given = renamed.assign(crs=((), 0, {"crs_wkt": "EPSG:5070"}))
    with pytest.raises(DomainError) as caught:
        room.run("rate-prefire-danger", time=time, **_refs(room, make, fuels=given, weather=weather))
    assert caught.value.field == field


def test_fuel_moisture_of_other_days_is_refused(room, make, time):
    weather = room.grid("old.nc", make["weather"](hours=48))
    moisture = room.run("forecast-fuel-moisture", weather=weather, time=time)["fuel_moisture"]
    later = make["weather"](hours=48)
    later = later.assign_coords(time=later["time"] + np.timedelta64(30, "D"))
    refs = _refs(room, make, weather=later)
    with pytest.raises(DomainError) as caught:
        room.run("rate-prefire-danger", time=time + pd.Timedelta(days=30), fuel_moisture=moisture, **refs)
    assert caught.value.field == "fuel_moisture"


def test_both_editions_of_fpi_can_be_chosen(room, make, time):
    refs = _refs(room, make)
    means = []
    for version in ("1998", "2000"):
        out = room.run("rate-prefire-danger", time=time, fpi_version=version, lead_days=1, **refs)
        grid = grids.read_netcdf(room.path(out["danger"]), grids.DANGER)
        assert grid.attrs["fpi_version"] == version
        means.append(float(grid["wfpi"].mean()))
    assert abs(means[0] - means[1]) > 1


def test_a_refit_replaces_the_demonstration(room, make, time):
    fires, voxels = fire_history.simulate(seed=4)
    keep = np.random.default_rng(0).uniform(size=len(voxels)) < 0.3
    kept = voxels[keep | (voxels["ignition"] == 1)]
    kept = kept.assign(sampling_rate=np.where(kept["ignition"] == 0, 0.3 * kept["sampling_rate"], 1.0))
    years = fires["time"].dt.year < 2005
    refs = {
        "fires": room.plain("fires.parquet", fires[years]),
        "voxels": room.plain("voxels.parquet", kept[kept["time"].dt.year < 2005]),
    }
    fit = room.run("fit-fire-probability", source="a simulated history, seed 4", demonstration=True, **refs)
    assert fit["bins"] == 16 and fit["bins_held"] >= 11  # few years, and 90 % intervals
    assert json.loads(room.path(fit["model"]).read_text())["product"]["simulated"]
    assert room.path(fit["figure"]).read_bytes()[:4] == b"\x89PNG"
    body = {"time": time, "lead_days": 1, **_refs(room, make)}
    out = room.run("rate-prefire-danger", probability_model=fit["model"], **body)
    assert _report(room, out)["fire_probability"] == "a simulated history, seed 4"
    shipped = room.run("rate-prefire-danger", **body)
    grid, other = (grids.read_netcdf(room.path(each["danger"])) for each in (out, shipped))
    np.testing.assert_array_equal(grid["wfpi"], other["wfpi"])
    assert not np.array_equal(grid["wfsp"], other["wfsp"], equal_nan=True)


def test_maps_of_2001_carry_their_date(real_data):
    dataset = vegetation_2001.fuels(real_data / "vegetation", 7)
    given = fuels.fuels_from_dataset(dataset)
    assert given.notes == {"ndvi_date": "2001-07", "ndvi_years": "2001"}
    assert 0.3 < np.nanmean(given.greenness[given.mask_code == 0]) < 0.95 and given.flag.mean() < 0.01
    assert 0.2 < (given.mask_code == 254).mean() < 0.7
