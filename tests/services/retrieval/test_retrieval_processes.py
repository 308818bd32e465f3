"""The retrieval processes as steps: simulate, train, retrieve, map a recording; contracts kept, errors named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray as xr
from matplotlib.image import imread

from services.retrieval.ease_grid import row_column
from services.retrieval.raw_if.recording import Header, write_recording
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.errors import DomainError
from tests.services.retrieval import small_world
from tests.services.retrieval.running import local as _local
from tests.services.retrieval.running import run as _run

PLAN = small_world.PLAN


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("store")
    (folder / "in").mkdir()
    small_world.write_surface(folder / "in/surface.nc")
    before = small_world.points(PLAN.first_ms, small_world.SPLIT_MS, 0)
    after = small_world.points(small_world.SPLIT_MS, PLAN.end_ms, 1)
    write_table(folder / "in/before.parquet", before, tables.SPECULAR_POINTS)
    write_table(folder / "in/after.parquet", after, tables.SPECULAR_POINTS)
    write_table(folder / "in/images.parquet", small_world.images_of(after, 60), tables.AS_RUN)
    small_world.write_smap(folder / "in/smap.parquet")
    return folder


@pytest.fixture(scope="module")
def chain(root: Path) -> dict[str, dict[str, Any]]:
    """The chain that the loop runs."""
    surface = {"href": "in/surface.nc"}
    before = _run(root, "simulate-observations", specular_points={"href": "in/before.parquet"}, surface=surface, seed=1)
    after = _run(
        root,
        "simulate-observations",
        specular_points={"href": "in/after.parquet"},
        surface=surface,
        images={"href": "in/images.parquet"},
        seed=2,
    )
    trained = _run(
        root, "train-soil-moisture", observations=[before["nominal"]], soil_moisture={"href": "in/smap.parquet"}
    )
    seen = [after["nominal"], after["raw_if"]]
    return {
        "before": before,
        "after": after,
        "trained": trained,
        "burned": _run(root, "retrieve-burned-area", observations=seen, baseline=trained["baseline"]),
        "moisture": _run(root, "retrieve-soil-moisture", observations=seen, reference=trained["reference"]),
    }


def test_simulated_files_are_marked_and_counted(chain: dict[str, dict[str, Any]]) -> None:
    assert chain["before"]["raw_if"] is None and chain["before"]["raw_if_count"] == 0
    assert chain["after"]["nominal_count"] > 1000 and chain["after"]["raw_if_count"] > 50
    for name, shape in (("nominal", (17, 11)), ("raw_if", (69, 111))):
        with netCDF4.Dataset(_local(chain["after"][name])) as file:
            assert file.simulated == "true"
            assert file["power_analog"].shape[2:] == shape
            counts = json.loads(file.screening)[{"nominal": "nominal", "raw_if": "raw-if"}[name]]
        assert counts["usable"] == chain["after"][f"{name}_count"]
        assert counts["read"] == sum(value for reason, value in counts.items() if reason != "read")
    report = json.loads(_local(chain["after"]["report"]).read_text())
    assert report["images_left_out"] == {"read": 60, "lost": 1}
    volume = report["data_volume"]
    assert 1_000 * 7_158 < volume["nominal_bytes"] < chain["after"]["nominal_count"] * 7_160
    assert 0 < volume["raw_if_bytes"] <= 59 * 12_027_150 and volume["raw_if_to_nominal_per_second"] == 1680


def test_burned_area_keeps_its_contract_and_says_what_was_screened(chain: dict[str, dict[str, Any]]) -> None:
    table = read_table(_local(chain["burned"]["burned_area"]), tables.BURNED_AREA)
    report = json.loads(_local(chain["burned"]["report"]).read_text())
    assert set(table["mode"]) == {"nominal", "raw-if"}
    assert len(table) == chain["burned"]["look_count"] == report["looks"]
    assert (
        report["screening"]["nominal"]["read"]
        == report["screening"]["nominal"]["all_fill"] + chain["after"]["nominal_count"]
    )
    assert report["with_baseline"] > 0.9 * len(table)
    assert report["product"]["simulated"] is True
    assert table["along_m"].between(3000, 12_000).all()
    assert imread(_local(chain["burned"]["map"])).shape[:2] > (500, 500)


def test_burned_looks_have_higher_probability(chain: dict[str, dict[str, Any]]) -> None:
    table = read_table(_local(chain["burned"]["burned_area"]), tables.BURNED_AREA)
    time = table["time"].dt.tz_localize(None).to_numpy()
    truth = small_world.surface().is_burned(table.geometry.y.to_numpy(), table.geometry.x.to_numpy(), time)
    assert truth.sum() > 50
    assert table["burned_probability"][truth].mean() > 1.5 * table["burned_probability"][~truth].mean()


def test_soil_moisture_table_grid_and_truth(chain: dict[str, dict[str, Any]]) -> None:
    table = read_table(_local(chain["moisture"]["soil_moisture"]), tables.SOIL_MOISTURE)
    with xr.open_dataset(_local(chain["moisture"]["grid"])) as grid:
        assert {"SM_daily", "SIGMA_daily", "count", "crs", "latitude", "longitude"} <= set(grid.variables)
        seen = grid["SM_daily"].notnull().sum()
        nominal = table[table["mode"] == "nominal"]
        assert len(nominal) <= int(seen) <= len(table)
        assert int(grid["count"].sum()) == int(table["count"].sum())
        one = table.iloc[0]
        x, y = one["column"] - grid.attrs["first_column"], one["row"] - grid.attrs["first_row"]
        found = row_column(grid["latitude"].to_numpy()[y, x], grid["longitude"].to_numpy()[y, x], 9)
        assert (int(found[0]), int(found[1])) == (one["row"], one["column"])
        assert grid.attrs["simulated"] == "true"


def test_soil_moisture_skill_is_reported_beside_the_cell_mean(chain: dict[str, dict[str, Any]]) -> None:
    report = json.loads(_local(chain["trained"]["report"]).read_text())
    skill = report["leave_a_day_out"]
    assert skill["regression"]["ubrmse"] < 1.05 * skill["cell_mean_baseline"]["ubrmse"]
    assert 0.85 < skill["regression"]["interval90_coverage"] < 0.95
    assert report["median_slope_m3_m3_db"] > 0


def test_images_not_on_the_ground_in_time_are_not_there(root: Path) -> None:
    after = read_table(root / "in/images.parquet", tables.AS_RUN)
    by = after["downlinked_at"].sort_values().iloc[19]
    made = _run(
        root,
        "simulate-observations",
        specular_points={"href": "in/after.parquet"},
        surface={"href": "in/surface.nc"},
        images={"href": "in/images.parquet"},
        nominal=False,
        downlinked_by=by.isoformat(),
    )
    with netCDF4.Dataset(_local(made["raw_if"])) as file:
        images = np.ma.compressed(file["image_id"][:])
    assert made["nominal"] is None
    assert set(images) <= set(after["image_id"][after["downlinked_at"] <= by])


def test_the_same_request_gives_the_same_bytes(root: Path, chain: dict[str, dict[str, Any]], tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("before.parquet", "after.parquet", "images.parquet", "surface.nc", "smap.parquet"):
        (tmp_path / "in" / name).write_bytes((root / "in" / name).read_bytes())
    again = _run(
        tmp_path,
        "simulate-observations",
        specular_points={"href": "in/after.parquet"},
        surface={"href": "in/surface.nc"},
        images={"href": "in/images.parquet"},
        seed=2,
    )
    assert [again[n]["sha256"] for n in ("nominal", "raw_if")] == [
        chain["after"][n]["sha256"] for n in ("nominal", "raw_if")
    ]
    retrieved = _run(tmp_path, "retrieve-burned-area", observations=[again["nominal"]])
    twice = _run(tmp_path, "retrieve-burned-area", observations=[again["nominal"]], cycle="other")
    for name in ("burned_area", "map", "report"):
        assert retrieved[name]["sha256"] == twice[name]["sha256"]


def test_an_own_model_can_be_trained_and_used(root: Path, chain: dict[str, dict[str, Any]]) -> None:
    seen = [chain["after"]["nominal"]]
    baseline = chain["trained"]["baseline"]
    trained = _run(
        root,
        "train-burned-area",
        observations=seen,
        labels={"href": "in/surface.nc"},
        baseline=baseline,
        calibration_share=0.4,
    )
    assert trained["look_count"] > 1000
    used = _run(root, "retrieve-burned-area", observations=seen, baseline=baseline, model=trained["model"])
    assert used["look_count"] == trained["look_count"]


def test_a_recording_becomes_a_map_that_the_retrieval_reads(root: Path) -> None:
    from tests.services.retrieval.raw_if.test_retrieval_raw_if import HEAD, _samples

    assert isinstance(HEAD, Header)
    write_recording(root / "in/recording.bin", HEAD, _samples(8, 0.15, 400.25, 1730.0))
    look = {"latitude_deg": 34.0, "longitude_deg": -118.0, "incidence_deg": 30.0, "rx_gain_dbi": 10.0}
    look |= {"rx_range_m": 6e5, "tx_range_m": 2.1e7, "eirp_w": 700.0}
    made = _run(
        root, "compute-ddm", recording={"href": "in/recording.bin"}, prn=7, doppler_hz=1750.0, search_hz=250, look=look
    )
    assert made["peak_to_mean"] > 10
    report = json.loads(_local(made["report"]).read_text())
    assert report["milliseconds_lost"] == 0 and report["milliseconds_used"] == 7
    table = _run(root, "retrieve-burned-area", observations=[made["ddm"]])
    assert table["look_count"] == 1
    row = read_table(_local(table["burned_area"]), tables.BURNED_AREA).iloc[0]
    assert row["mode"] == "raw-if" and row.geometry.x == pytest.approx(-118.0, abs=1e-4)
    assert row["time"] == pd.Timestamp("1980-01-06", tz="UTC") + pd.Timedelta(weeks=2209, seconds=432_000 - 18)


def test_soil_moisture_comes_as_cog_and_training_as_picture(chain: dict[str, dict[str, Any]]) -> None:
    with rasterio.open(_local(chain["moisture"]["cog"])) as source:
        assert source.crs.to_epsg() == 6933 and source.tags()["simulated"] == "true"
        assert source.descriptions[0].startswith("SM_daily 2023-")
    table = pd.read_parquet(_local(chain["moisture"]["soil_moisture"]))
    assert (table["soil_moisture_low"] <= table["soil_moisture"]).all()
    assert (table["soil_moisture"] <= table["soil_moisture_high"]).all()
    assert imread(_local(chain["trained"]["figure"])).shape[1] > 800
    report = json.loads(_local(chain["trained"]["report"]).read_text())
    assert {"leave_a_day_out", "leave_a_block_out", "forward_in_time", "raw_if"} <= set(report)
    assert report["raw_if"]["trained"] is False and chain["trained"]["raw_if_model"] is None


def test_errors_name_the_field(root: Path, chain: dict[str, dict[str, Any]]) -> None:
    (root / "in/noise.nc").write_bytes(bytes(range(256)) * 8)
    with pytest.raises(DomainError) as error:
        _run(root, "retrieve-burned-area", observations=[{"href": "in/noise.nc"}])
    assert error.value.field == "observations"
    with pytest.raises(DomainError) as error:
        _run(
            root,
            "retrieve-soil-moisture",
            observations=[chain["after"]["nominal"]],
            reference={"href": "in/smap.parquet"},
        )
    assert error.value.field == "reference.soil_moisture_mean"
    with pytest.raises(DomainError) as error:
        _run(root, "compute-ddm", recording={"href": "in/noise.nc"}, prn=7, doppler_hz=0.0)
    assert error.value.field == "recording.magic"
    with pytest.raises(DomainError) as error:
        _run(
            root,
            "simulate-observations",
            specular_points={"href": "in/after.parquet"},
            surface=chain["after"]["nominal"],
        )
    assert error.value.field == "surface"


def test_no_usable_look_is_an_empty_product_not_an_error(root: Path, chain: dict[str, dict[str, Any]]) -> None:
    empty = _run(
        root,
        "retrieve-burned-area",
        observations=[chain["after"]["nominal"]],
        baseline=chain["trained"]["baseline"],
        time_from="2030-01-01T00:00:00Z",
    )
    assert empty["look_count"] == 0
    assert len(read_table(_local(empty["burned_area"]), tables.BURNED_AREA)) == 0
    moisture = _run(
        root,
        "retrieve-soil-moisture",
        observations=[chain["after"]["nominal"]],
        reference=chain["trained"]["reference"],
        time_from="2030-01-01T00:00:00Z",
    )
    assert moisture["cell_count"] == 0


def test_images_that_saw_no_surface_give_an_empty_file_that_reads(root: Path) -> None:
    far = read_table(root / "in/images.parquet", tables.AS_RUN)
    far = far.assign(start=far["start"] + pd.Timedelta(days=400), end=far["end"] + pd.Timedelta(days=400))
    write_table(root / "in/far.parquet", far, tables.AS_RUN)
    made = _run(
        root,
        "simulate-observations",
        specular_points={"href": "in/after.parquet"},
        surface={"href": "in/surface.nc"},
        images={"href": "in/far.parquet"},
        nominal=False,
    )
    assert made["raw_if_count"] == 0
    assert _run(root, "retrieve-burned-area", observations=[made["raw_if"]])["look_count"] == 0
