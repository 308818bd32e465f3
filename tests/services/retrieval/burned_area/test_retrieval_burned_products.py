"""Burned-area products through the processes: grid, COG, GeoJSON, picture; labels from rasters; product attributes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
import xarray as xr
from matplotlib.image import imread
from rasterio.transform import from_origin

from services.retrieval.burned_area.model import FEATURES, load_model
from services.retrieval.ease_grid import row_column
from shared.contracts import tables
from shared.contracts.cog import read_cog
from shared.contracts.schema import read_attributes, read_table, write_table
from shared.errors import DomainError
from tests.services.retrieval import small_world
from tests.services.retrieval.running import local as _local
from tests.services.retrieval.running import run as _run

PLAN = small_world.PLAN


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Specular points, surface, perimeters, a DEM, land cover, and two burned-area rasters that split the truth."""
    folder = tmp_path_factory.mktemp("store")
    (folder / "in").mkdir()
    small_world.write_surface(folder / "in/surface.nc")
    after = small_world.points(small_world.SPLIT_MS, PLAN.end_ms, 1)
    write_table(folder / "in/after.parquet", after, tables.SPECULAR_POINTS)
    write_table(folder / "in/images.parquet", small_world.images_of(after, 60), tables.AS_RUN)
    square = shapely.box(
        PLAN.longitude_deg + 0.3, PLAN.latitude_deg + 0.3, PLAN.longitude_deg + 1, PLAN.latitude_deg + 1
    )
    geopandas.GeoDataFrame(geometry=[square], crs="EPSG:4326").to_file(
        folder / "in/perimeters.geojson", driver="GeoJSON"
    )
    _rasters(folder / "in")
    return folder


def _rasters(folder: Path) -> None:
    world = small_world.surface()
    latitude, longitude = world.burn_latitude_deg, world.burn_longitude_deg
    transform = from_origin(longitude[0] - 0.005, latitude[-1] + 0.005, 0.01, 0.01)
    burned = ~np.isnat(world.burn_time)
    year = world.burn_time.astype("datetime64[Y]")
    day = np.where(burned, (world.burn_time.astype("datetime64[D]") - year.astype("datetime64[D]")).astype(int) + 1, 0)
    west = longitude[None, :] < longitude.mean()
    layers = {
        "mcd64a1.tif": np.where(west, day, 0).astype(np.int16),
        "firecci51.tif": np.where(west, 0, day).astype(np.int16),
        "landsat.tif": burned.astype(np.int16),
        "dem.tif": np.broadcast_to(np.arange(longitude.size) * 20, day.shape).astype(np.int16),
    }
    for name, values in layers.items():
        height, width = values.shape
        profile = {"driver": "GTiff", "count": 1, "height": height, "width": width, "dtype": "int16"}
        with rasterio.open(folder / name, "w", crs="EPSG:4326", transform=transform, **profile) as file:
            file.write(values[::-1], 1)


@pytest.fixture(scope="module")
def seen(root: Path) -> dict[str, Any]:
    return _run(
        root,
        "simulate-observations",
        specular_points={"href": "in/after.parquet"},
        surface={"href": "in/surface.nc"},
        images={"href": "in/images.parquet"},
        seed=5,
    )


@pytest.fixture(scope="module")
def burned(root: Path, seen: dict[str, Any]) -> dict[str, Any]:
    given = {"observations": [seen["nominal"], seen["raw_if"]], "perimeters": {"href": "in/perimeters.geojson"}}
    return _run(root, "retrieve-burned-area", **given)


def test_grid_counts_every_look_once_in_its_own_cell(burned: dict[str, Any]) -> None:
    points = read_table(_local(burned["burned_area"]), tables.BURNED_AREA)
    with xr.open_dataset(_local(burned["grid"])) as grid:
        assert int(grid["count"].sum()) == len(points)
        assert int(grid["burned_count"].sum()) == int(points["burned"].sum())
        row, column = row_column(points.geometry.y.to_numpy(), points.geometry.x.to_numpy(), 3)
        row, column = row - grid.attrs["first_row"], column - grid.attrs["first_column"]
        expected = np.zeros(grid["count"].shape, int)
        np.add.at(expected, (row, column), 1)
        assert np.array_equal(grid["count"], expected)
        alone = np.flatnonzero(expected[row, column] == 1)
        found = grid["burned_probability"].to_numpy()[row[alone], column[alone]]
        assert found == pytest.approx(points["burned_probability"].to_numpy()[alone], abs=1e-5)
        assert np.array_equal(grid["burned_class"] == 0, expected == 0)
        assert grid.attrs["simulated"] == "true" and grid["crs"].attrs["epsg_code"] == "EPSG:6933"


def test_cog_is_the_grid_in_place(burned: dict[str, Any]) -> None:
    bands, transform, crs, tags = read_cog(_local(burned["cog"]))
    with xr.open_dataset(_local(burned["grid"])) as grid:
        assert crs == "EPSG:6933" and tags["simulated"] == "true"
        for name, band in bands.items():
            known = np.nan_to_num(grid[name].to_numpy().astype(float), nan=-9999.0)
            assert band == pytest.approx(known, abs=1e-6), name
        centre = transform * (0.5, 0.5)
        assert centre == pytest.approx((float(grid["x"][0]), float(grid["y"][0])), abs=1e-3)
    with rasterio.open(_local(burned["cog"])) as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"


def test_geojson_holds_the_looks_and_says_simulated(burned: dict[str, Any]) -> None:
    document = json.loads(_local(burned["geojson"]).read_text())
    points = read_table(_local(burned["burned_area"]), tables.BURNED_AREA)
    assert len(document["features"]) + document["left_out"] == len(points)
    assert document["product"]["simulated"] is True
    first = document["features"][0]["properties"]
    assert first["burned_probability"] == pytest.approx(points["burned_probability"].max(), abs=1e-4)
    assert geopandas.read_file(_local(burned["geojson"])).crs.to_epsg() == 4326


def test_perimeters_are_drawn_and_enter_no_product(root: Path, seen: dict[str, Any], burned: dict[str, Any]) -> None:
    bare = _run(root, "retrieve-burned-area", observations=[seen["nominal"], seen["raw_if"]])
    with_line, without = imread(_local(burned["map"])), imread(_local(bare["map"]))
    blue = lambda image: ((image[..., 2] - image[..., 0] > 0.4) & (image[..., 2] > 0.5)).sum()  # noqa: E731
    assert blue(with_line) > blue(without) + 300
    one, two = (read_table(_local(r["burned_area"]), tables.BURNED_AREA) for r in (burned, bare))
    assert one["burned_probability"].equals(two["burned_probability"])
    stated = [read_attributes(_local(made["burned_area"])) for made in (burned, bare)]
    for name in ("simulated", "simulated_share", "oldest_input", "screening"):
        assert stated[0][name] == stated[1][name]


def test_training_takes_the_union_of_rasters_and_ancillary_layers(root: Path, seen: dict[str, Any]) -> None:
    """Rasters that hold half of the truth each, and one that is late, give the labels that the truth gives."""
    common = {"observations": [seen["nominal"], seen["raw_if"]], "calibration_share": 0.4}
    rasters = [
        {"raster": {"href": "in/mcd64a1.tif"}, "product": "mcd64a1", "year": 2023},
        {"raster": {"href": "in/firecci51.tif"}, "product": "firecci51", "year": 2023},
        {"raster": {"href": "in/landsat.tif"}, "product": "landsat", "burned_on": "2023-09-08T00:00:00Z"},
    ]
    elevation = {"href": "in/dem.tif"}
    made = _run(root, "train-burned-area", burned_rasters=rasters, elevation=elevation, **common)
    first = _run(root, "train-burned-area", burned_rasters=rasters[:1], **common)
    truth = _run(root, "train-burned-area", labels={"href": "in/surface.nc"}, **common)
    reports = [json.loads(_local(result["report"]).read_text()) for result in (made, first, truth)]
    assert reports[0]["burned"] > reports[1]["burned"] > 0
    assert 0.7 * reports[2]["burned"] < reports[0]["burned"] <= reports[2]["burned"]  # days of burning are left out
    assert reports[0]["split"] in ("region", "region and time")
    assert load_model(_local(made["model"])).features == (*FEATURES, "height_m", "slope_deg")
    again = _run(root, "retrieve-burned-area", model=made["model"], elevation=elevation, observations=[seen["nominal"]])
    assert again["look_count"] > 0


def test_model_carries_its_product_attributes(root: Path, seen: dict[str, Any]) -> None:
    made = _run(
        root,
        "train-burned-area",
        observations=[seen["nominal"]],
        labels={"href": "in/surface.nc"},
        calibration_share=0.4,
    )
    product = json.loads(load_model(_local(made["model"])).booster.attr("product"))
    assert product["process"] == "train-burned-area" and product["simulated"] is True


def test_baseline_and_reference_carry_their_own_attributes(root: Path, seen: dict[str, Any]) -> None:
    """The baseline rests on simulated looks alone; the reference also on soil moisture that is not simulated."""
    world = small_world.surface()
    latitude, longitude = np.meshgrid(world.latitude_deg, world.longitude_deg, indexing="ij")
    row, column = row_column(latitude.ravel(), longitude.ravel(), 9)
    days = range(PLAN.days_before - 3, PLAN.days_before + PLAN.days_after)
    parts = [
        pd.DataFrame({"row": row, "column": column, "soil_moisture": world.soil_moisture[day].ravel()}).assign(
            time=pd.Timestamp(world.time[day], tz="UTC") + pd.Timedelta(hours=12)
        )
        for day in days
    ]
    pd.concat(parts).groupby(["time", "row", "column"], as_index=False).mean().to_parquet(root / "in/smap.parquet")
    made = _run(root, "train-soil-moisture", observations=[seen["nominal"]], soil_moisture={"href": "in/smap.parquet"})
    baseline, reference = (read_attributes(_local(made[name])) for name in ("baseline", "reference"))
    assert baseline["simulated"] is True and baseline["simulated_share"] == 1.0
    assert reference["simulated"] is True and reference["process"] == "train-soil-moisture"
    manifest = json.loads((_local(made["baseline"]).parent / "manifest.json").read_text())
    for name, attributes in (("baseline.parquet", baseline), ("reference.parquet", reference)):
        entry = {
            **manifest["product"],
            **{k: v for k, v in manifest["files"][name].items() if k in manifest["product"]},
        }
        assert {key: attributes[key] for key in entry} == entry


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({}, "labels"),
        ({"burned_rasters": [{"raster": {"href": "in/mcd64a1.tif"}, "product": "mcd64a1"}]}, "burned_rasters.year"),
        (
            {"burned_rasters": [{"raster": {"href": "in/landsat.tif"}, "product": "landsat"}]},
            "burned_rasters.burned_on",
        ),
        (
            {"burned_rasters": [{"raster": {"href": "in/after.parquet"}, "product": "mcd64a1", "year": 2023}]},
            "burned_rasters",
        ),
        ({"labels": {"href": "in/surface.nc"}, "elevation": {"href": "in/after.parquet"}}, "elevation"),
        ({"labels": {"href": "in/surface.nc"}, "soil_moisture": [{"href": "in/surface.nc"}]}, "soil_moisture"),
    ],
    ids=["no labels", "no year", "no date", "no raster", "no dem", "smap without a day"],
)
def test_bad_inputs_are_named(root: Path, seen: dict[str, Any], given: dict[str, Any], field: str) -> None:
    with pytest.raises(DomainError) as error:
        _run(root, "train-burned-area", observations=[seen["nominal"]], **given)
    assert error.value.field == field


def test_perimeters_that_are_none_are_named(root: Path, seen: dict[str, Any]) -> None:
    with pytest.raises(DomainError) as error:
        _run(root, "retrieve-burned-area", observations=[seen["nominal"]], perimeters={"href": "in/surface.nc"})
    assert error.value.field == "perimeters"
