"""Inputs of infer-fire-arrival beside detections tables, through the process: point lists, weather, a fire mesh."""

from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import shapely
import xarray as xr

from shared.contracts.grids import WEATHER_GRID, write_netcdf
from shared.errors import DomainError
from tests.services.arrival.exports.test_arrival_wrf_sfire import wrfinput
from tests.services.arrival.requests import (
    START,
    detections_at,
    file_of,
    incident_at,
    product_of,
    report_of,
    run_request,
)

HERE = shapely.Point(-106.0, 33.5)
HOURS = np.repeat(np.arange(2.0, 46.0, 4.0), 6)
RNG = np.random.default_rng(3)
LON = -106.0 + 0.0012 * HOURS + 0.004 * RNG.standard_normal(HOURS.size)
LAT = 33.5 + 0.006 * RNG.standard_normal(HOURS.size)
STAGED = {"detections": detections_at(LON, LAT, HOURS), "incidents": incident_at(HERE)}
PLAIN = {"method": "nearest-detection"}


def _firms(path: Path) -> None:
    times = START + pd.to_timedelta(HOURS, unit="h")
    head = "latitude,longitude,bright_ti4,scan,track,acq_date,acq_time,satellite,instrument,confidence,frp\n"
    rows = [
        f"{lat:.5f},{lon:.5f},330,0.4,0.38,{time:%Y-%m-%d},{time:%H%M},N,VIIRS,h,5.0"
        for lat, lon, time in zip(LAT, LON, times, strict=True)
    ]
    path.write_text(head + "\n".join(rows) + "\n")


def _weather(path: Path, wind_from_deg: float = 270.0) -> None:
    times = pd.date_range(START.tz_localize(None) - pd.Timedelta(hours=24), periods=120, freq="h")
    dims = ("time", "latitude", "longitude")
    values = {
        "temperature_c": 30.0,
        "relative_humidity_pct": 20.0,
        "wind_speed_m_s": 7.0,
        "wind_direction_deg": wind_from_deg,
        "rain_mm": 0.0,
    }
    data = {name: (dims, np.full((120, 3, 3), value)) for name, value in values.items()}
    data["issued_at"] = ("time", np.full(120, times[0]))
    axes = {"time": times, "latitude": [33.0, 33.5, 34.0], "longitude": [-106.5, -106.0, -105.5]}
    write_netcdf(path, WEATHER_GRID.check(xr.Dataset(data, axes)))


def test_point_lists_and_tables_mix_in_one_request(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    _firms(tmp_path / "in/firms.csv")
    table = run_request(tmp_path, STAGED, **PLAIN)
    listed = run_request(
        tmp_path,
        {"incidents": STAGED["incidents"], "detections": STAGED["detections"].iloc[:6]},
        files={"detections": [{"href": "in/detections.parquet"}, {"href": "in/firms.csv"}]},
        **PLAIN,
    )
    files = report_of(listed)["files"]
    assert [entry["format"] for entry in files] == ["detections table", "firms"]
    assert files[1]["fire"] == HOURS.size == report_of(listed)["incidents"][0]["fire_detections"] - 6
    burned = [np.isfinite(product_of(outputs)["fire_arrival_time"].to_numpy()).sum() for outputs in (table, listed)]
    assert burned[1] == pytest.approx(burned[0], rel=0.1)


def test_weather_enters_the_next_day_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    _weather(tmp_path / "in/weather.nc")
    outputs = run_request(tmp_path, STAGED, files={"weather": {"href": "in/weather.nc"}}, **PLAIN)
    assert report_of(outputs)["incidents"][0]["front24"]["basis"] == "spread+weather"
    plain = run_request(tmp_path, STAGED, **PLAIN)
    assert report_of(plain)["incidents"][0]["front24"]["basis"] == "spread"
    far = {"detections": detections_at(LON - 20.0, LAT, HOURS), "incidents": incident_at(shapely.Point(-126.0, 33.5))}
    away = run_request(tmp_path, far, files={"weather": {"href": "in/weather.nc"}}, **PLAIN)
    assert "weather-out-of-reach" in product_of(away).attrs["flags"]
    probability = product_of(outputs)["front24_probability"].to_numpy()
    assert probability.min() >= 0 and 0.5 < probability.max() <= 1
    assert not probability[np.isfinite(product_of(outputs)["fire_arrival_time"].to_numpy())].any()


def test_tign_g_of_a_request(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    wrfinput(tmp_path / "in/wrfinput_d02")
    end = START + pd.Timedelta(hours=24)
    files = {"wrfinput": {"href": "in/wrfinput_d02"}}
    times = {"simulation_start": START.isoformat(), "simulation_end": end.isoformat()}
    outputs = run_request(tmp_path, STAGED, files=files, **times, **PLAIN)
    with netCDF4.Dataset(str(file_of(outputs["tign_g"]))) as file:
        seconds = np.asarray(file["TIGN_G"][0])
    burned = seconds < 86400.5
    assert burned.any() and seconds.min() >= 0 and (seconds[~burned] >= 360000).all()
    assert run_request(tmp_path, STAGED, **PLAIN)["tign_g"] is None
    (tmp_path / "in/notes").write_text("none")
    with pytest.raises(DomainError) as caught:
        run_request(tmp_path, STAGED, files={"wrfinput": {"href": "in/notes"}}, **PLAIN)
    assert caught.value.field == "wrfinput"


def test_the_papers_network_comes_as_onnx_where_asked_for(tmp_path: Path) -> None:
    both = {"formats": ["onnx"], "epochs": 3}
    outputs = run_request(tmp_path, STAGED, method="fusion-nn", **both)
    assert [file_of(ref).name for ref in outputs["networks"]] == ["network_one.onnx"]
    assert file_of(outputs["networks"][0]).stat().st_size < 80_000
    assert run_request(tmp_path, STAGED, method="nearest-detection", **both)["networks"] == []
