"""Vegetation that is missing, impossible, swapped, in another scale or on another grid: flagged or refused by name."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from services.prioritization.prefire import danger_grid, fuels
from shared.contracts import cog
from shared.errors import ContractError, DomainError


def _on_usgs(bands: dict[str, np.ndarray], grid: danger_grid.UsgsGrid) -> xr.Dataset:
    data = {name: (("y", "x"), values) for name, values in bands.items()}
    data["crs"] = ((), 0, {"crs_wkt": danger_grid.USGS_CRS})
    return xr.Dataset(data, coords={"x": grid.x_m, "y": grid.y_m})


def _bands(shape: tuple[int, int]) -> dict[str, np.ndarray]:
    flat = np.ones(shape, dtype=np.float32)
    values = {"ndvi": 0.4, "ndvi_min": 0.2, "ndvi_max": 0.7, "live_load": 0.5, "dead_load": 1.0, "extinction_pct": 25.0}
    return {name: value * flat for name, value in values.items()} | {"mask_code": np.zeros(shape, dtype=np.uint8)}


def test_good_fuels_carry_no_flag(make):
    given = fuels.fuels_from_dataset(make["fuels"](0.1))
    assert not given.flag.any()
    assert given.greenness[given.mask_code == 0].min() > 0
    assert given.ndvi_largest == 0.75


@pytest.mark.parametrize(
    ("name", "value", "bit"),
    [
        ("ndvi", np.nan, fuels.VEGETATION_MISSING),
        ("ndvi", 5200.0, fuels.VEGETATION_IMPOSSIBLE),
        ("ndvi_min", 0.9, fuels.VEGETATION_IMPOSSIBLE),
        ("live_load", -1.0, fuels.VEGETATION_IMPOSSIBLE),
        ("extinction_pct", 0.0, fuels.VEGETATION_IMPOSSIBLE),
        ("dead_load", np.nan, fuels.VEGETATION_MISSING),
    ],
)
def test_a_few_bad_cells_are_unknown_and_say_so(make, name, value, bit):
    dataset = make["fuels"](0.05)
    dataset[name][30:32, 30:33] = value
    given = fuels.fuels_from_dataset(dataset)
    assert (given.flag[30:32, 30:33] == bit).all() and np.isnan(given.greenness[30:32, 30:33]).all()
    assert (given.flag > 0).sum() == 6 and np.isfinite(given.greenness[given.flag == 0]).all()
    assert sum(given.counts.values()) == 6


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"ndvi": lambda d: d["ndvi"] * 10000}, "ndvi"),
        ({"ndvi_min": lambda d: d["ndvi_max"], "ndvi_max": lambda d: d["ndvi_min"]}, "ndvi_min"),
        ({"extinction_pct": lambda d: d["extinction_pct"] / 100}, "extinction_pct"),
        ({"dead_load": lambda d: -d["dead_load"]}, "dead_load"),
        ({"live_load": lambda d: d["live_load"] * np.nan}, "live_load"),
        ({"soil_moisture_q95": lambda d: d["soil_moisture_q95"] * 100}, "soil_moisture_q95"),
        ({"soil_moisture_q05": lambda d: d["soil_moisture_q95"] + 0.1}, "soil_moisture_q05"),
    ],
)
def test_a_whole_field_that_is_wrong_is_refused_by_name(make, change, field):
    dataset = make["fuels"](0.1)
    with pytest.raises(DomainError) as caught:
        fuels.fuels_from_dataset(dataset.assign({name: rule(dataset) for name, rule in change.items()}))
    assert caught.value.field == field


def test_bad_values_under_a_mask_do_not_count(make):
    dataset = make["fuels"](0.1)
    dataset["ndvi"] = dataset["ndvi"].where(dataset["mask_code"] == 0, -9999.0)
    assert not fuels.fuels_from_dataset(dataset).flag.any()


def test_a_missing_variable_is_named(make):
    with pytest.raises(DomainError) as caught:
        fuels.fuels_from_dataset(make["fuels"](0.1).drop_vars("extinction_pct"))
    assert caught.value.field == "extinction_pct"


def test_fuels_on_the_usgs_grid_from_netcdf_and_geotiff_agree(tmp_path):
    grid = danger_grid.UsgsGrid(900, 1500, 12, 20)
    bands = _bands(grid.shape)
    bands["ndvi"][2, 3] = np.nan
    first = fuels.fuels_from_dataset(_on_usgs(bands, grid))
    as_float = {name: values.astype(np.float32) for name, values in bands.items()}
    path = tmp_path / "fuels.tif"
    tags = {"ndvi_date": "2022-06-10"}
    cog.write_cog(path, as_float, transform=grid.transform, crs=grid.crs, nodata=None, attributes=tags)
    second = fuels.read_geotiff(str(path))
    assert first.grid == second.grid == grid
    np.testing.assert_array_equal(first.greenness, second.greenness)
    assert second.flag[2, 3] == fuels.VEGETATION_MISSING and second.notes == tags


def test_geotiff_without_a_band_or_on_another_grid_is_refused(tmp_path):
    grid = danger_grid.UsgsGrid(900, 1500, 12, 20)
    bands = {name: values.astype(np.float32) for name, values in _bands(grid.shape).items()}
    path = tmp_path / "fuels.tif"

    def write(chosen, transform):
        cog.write_cog(path, chosen, transform=transform, crs=grid.crs, nodata=None, attributes={})

    write({name: values for name, values in bands.items() if name != "ndvi_max"}, grid.transform)
    with pytest.raises(DomainError) as caught:
        fuels.read_geotiff(str(path))
    assert caught.value.field == "ndvi_max"
    write(bands, _shifted(grid))
    with pytest.raises(DomainError, match="align") as caught:
        fuels.read_geotiff(str(path))
    assert caught.value.field == "fuels"
    path.write_bytes(b"II*\x00 no tiff")
    with pytest.raises(ContractError):
        fuels.read_geotiff(str(path))


def _shifted(grid: danger_grid.UsgsGrid):
    from rasterio.transform import Affine

    t = grid.transform
    return Affine(t.a, t.b, t.c + 400.0, t.d, t.e, t.f)
