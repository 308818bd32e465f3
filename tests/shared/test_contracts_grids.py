"""Every grid contract: what fits passes, and what does not is refused by variable, dimension or attribute."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from shared.contracts import grids
from shared.errors import ContractError

SIZES = {"lead_day": 8, "latitude": 3, "longitude": 4, "y": 5, "x": 6, "time": 2}

# The names and dimensions of the design's page, written out: the oracle for shared.contracts.grids.
DANGER_CUBE = ("wfpi", "wlfp", "wfsp", "wfpi_x", "wlfp_x", "wfsp_x")
ARRIVAL_MAPS = (
    "fire_arrival_time",
    "fire_arrival_time_sd",
    "fire_arrival_time_q05",
    "fire_arrival_time_q50",
    "fire_arrival_time_q95",
    "burned_probability",
    "information",
    "latest_observation",
)
WEATHER = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "wind_direction_deg", "rain_mm")
FUELS = ("ndvi", "ndvi_min", "ndvi_max", "live_load", "dead_load", "extinction_pct", "mask_code")
DESIGN: dict[str, dict[str, tuple[str, ...]]] = {
    "DANGER": dict.fromkeys(DANGER_CUBE, ("lead_day", "latitude", "longitude"))
    | {"mask_code": ("latitude", "longitude")},
    "FIRE_ARRIVAL": dict.fromkeys(ARRIVAL_MAPS, ("y", "x")) | {"crs": ()},
    "WEATHER_GRID": dict.fromkeys(WEATHER, ("time", "latitude", "longitude")) | {"issued_at": ("time",)},
    "FUELS": dict.fromkeys(FUELS, ("latitude", "longitude")),
}
ATTRIBUTES = {"FIRE_ARRIVAL": {"reference_time": "2024-07-01T00:00:00Z", "incident_id": "black"}}
VARIABLES = [(name, variable) for name, variables in DESIGN.items() for variable in variables]


def example(name: str, seed: int = 0) -> xr.Dataset:
    draw = np.random.default_rng(seed)
    dataset = xr.Dataset(attrs=ATTRIBUTES.get(name, {}))
    for variable, dimensions in DESIGN[name].items():
        shape = tuple(SIZES[dimension] for dimension in dimensions)
        values = draw.random(shape).astype("float32")
        if variable in ("mask_code", "information"):
            values = (values * 200).astype("uint8")
        dataset[variable] = (dimensions, values, {"units": "1"})
    if "latitude" in dataset.dims:
        dataset = dataset.assign_coords(latitude=np.linspace(30, 40, 3), longitude=np.linspace(-110, -100, 4))
    if "time" in dataset.dims:
        dataset = dataset.assign_coords(time=pd.date_range("2024-07-01", periods=2, freq="h"))
        dataset["issued_at"] = ("time", pd.date_range("2024-07-01T01:00", periods=2, freq="h"))
    return dataset


def refusal(name: str, dataset: xr.Dataset, field: str) -> ContractError:
    with pytest.raises(ContractError) as caught:
        grids.ALL[name].check(dataset)
    assert caught.value.field == field
    assert f"'{field}'" in caught.value.message
    assert f"'{grids.ALL[name].name}'" in caught.value.message
    return caught.value


def test_the_contracts_are_those_of_the_design() -> None:
    assert {name: dict(schema.variables) for name, schema in grids.ALL.items()} == DESIGN
    assert {name: schema.attributes for name, schema in grids.ALL.items() if schema.attributes} == {
        name: tuple(attributes) for name, attributes in ATTRIBUTES.items()
    }


@pytest.mark.parametrize("name", DESIGN)
def test_a_grid_comes_back_as_it_was(name: str, tmp_path: Path) -> None:
    dataset = example(name)
    grids.write_netcdf(tmp_path / "a.nc", dataset, {"simulated": True, "model_version": None, "simulated_share": 0.5})
    found = grids.read_netcdf(tmp_path / "a.nc", grids.ALL[name])
    xr.testing.assert_equal(found, dataset)
    assert {key: str(value.dtype) for key, value in found.data_vars.items()} == {
        key: str(value.dtype) for key, value in dataset.data_vars.items()
    }
    assert (found.attrs["simulated"], found.attrs["model_version"]) == ("true", "")
    assert found.attrs["simulated_share"] == 0.5
    assert found.attrs["Conventions"].startswith("CF-1.11")
    assert "history" not in found.attrs
    assert list(found.attrs) == sorted(found.attrs)


@pytest.mark.parametrize("name", DESIGN)
def test_more_variables_may_be_added(name: str) -> None:
    dataset = example(name).assign(further=("row", [1, 2]))
    assert grids.ALL[name].check(dataset) is dataset


@pytest.mark.parametrize(("name", "variable"), VARIABLES)
def test_a_missing_variable_is_named(name: str, variable: str, tmp_path: Path) -> None:
    broken = example(name).drop_vars(variable)
    refusal(name, broken, variable)
    grids.write_netcdf(tmp_path / "a.nc", broken)
    with pytest.raises(ContractError) as caught:
        grids.read_netcdf(tmp_path / "a.nc", grids.ALL[name])
    assert caught.value.field == variable


@pytest.mark.parametrize(("name", "variable"), VARIABLES)
def test_wrong_dimensions_are_named(name: str, variable: str) -> None:
    dataset = example(name)
    turned = dataset[variable].T if dataset[variable].ndim > 1 else dataset[variable].expand_dims("other")
    error = refusal(name, dataset.drop_vars(variable).assign({variable: turned}), variable)
    assert str(DESIGN[name][variable]) in error.message
    assert error.value == tuple(turned.dims)


@pytest.mark.parametrize("attribute", ATTRIBUTES["FIRE_ARRIVAL"])
def test_a_missing_attribute_is_named(attribute: str) -> None:
    dataset = example("FIRE_ARRIVAL")
    del dataset.attrs[attribute]
    refusal("FIRE_ARRIVAL", dataset, attribute)


def test_the_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    """Also in another process and another second: HDF5 can stamp its objects with the clock."""
    code = (
        "import sys, time; sys.path[:0] = sys.argv[2:]\n"
        "from test_contracts_grids import DESIGN, example\n"
        "from shared.contracts.grids import write_netcdf\n"
        "for name in DESIGN: write_netcdf(f'{sys.argv[1]}/{name}-other.nc', example(name), {'b': True, 'a': 1})\n"
    )
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
    for name in DESIGN:
        grids.write_netcdf(tmp_path / f"{name}.nc", example(name), {"a": 1, "b": True})
        grids.write_netcdf(tmp_path / f"{name}-seed.nc", example(name, seed=1), {"a": 1, "b": True})
    subprocess.run([sys.executable, "-c", code, str(tmp_path), *folders], check=True, timeout=60)
    for name in DESIGN:
        first = (tmp_path / f"{name}.nc").read_bytes()
        assert (tmp_path / f"{name}-other.nc").read_bytes() == first, name
        assert (tmp_path / f"{name}-seed.nc").read_bytes() != first, name


def test_writing_leaves_the_dataset_as_it_was(tmp_path: Path) -> None:
    dataset = example("FUELS")
    grids.write_netcdf(tmp_path / "a.nc", dataset, {"simulated": True})
    assert dataset.attrs == {}
    xr.testing.assert_identical(dataset, example("FUELS"))


def test_grids_are_compressed(tmp_path: Path) -> None:
    grids.write_netcdf(tmp_path / "a.nc", example("FUELS"))
    with netCDF4.Dataset(tmp_path / "a.nc") as opened:
        assert opened["ndvi"].filters()["zlib"]


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((100, 100))
    grids.write_netcdf(tmp_path / "a.nc", xr.Dataset({"ndvi": (("latitude", "longitude"), values)}))
    whole = (tmp_path / "a.nc").read_bytes()
    middle = len(whole) // 2
    for damaged in (
        b"",
        b"not netCDF",
        whole[:middle],
        whole[:middle] + b"\xff" * 200 + whole[middle + 200 :],
    ):
        (tmp_path / "b.nc").write_bytes(damaged)
        with pytest.raises(ContractError, match="netCDF"):
            grids.read_netcdf(tmp_path / "b.nc", grids.FUELS)
    with pytest.raises(ContractError, match="netCDF"):
        grids.read_netcdf(tmp_path / "none.nc", grids.FUELS)
