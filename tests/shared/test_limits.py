"""How large an input may be, told from what the file says of itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from shared.contracts.limits import InputLimits
from shared.errors import ContractError


def test_a_table_of_too_many_rows_is_refused(tmp_path: Path) -> None:
    pd.DataFrame({"a": range(100)}).to_parquet(tmp_path / "a.parquet")
    InputLimits(table_rows=100).check(tmp_path / "a.parquet", "targets")
    with pytest.raises(ContractError, match="'targets' holds 100 rows; at most 99"):
        InputLimits(table_rows=99).check(tmp_path / "a.parquet", "targets")


def test_a_grid_is_measured_unpacked(tmp_path: Path) -> None:
    zeros = xr.Dataset({"a": (("y", "x"), np.zeros((1000, 1000)))})
    zeros.to_netcdf(tmp_path / "a.nc", engine="netcdf4", encoding={"a": {"zlib": True}})
    assert (tmp_path / "a.nc").stat().st_size < 100_000
    InputLimits(grid_bytes=8_000_000).check(tmp_path / "a.nc", "a.nc")
    with pytest.raises(ContractError, match="8000000 bytes once unpacked"):
        InputLimits(grid_bytes=7_999_999).check(tmp_path / "a.nc", "a.nc")


@pytest.mark.parametrize("name", ["a.parquet", "a.nc", "a.json"])
def test_what_cannot_be_read_is_left_to_its_reader(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"<html>")
    InputLimits(1, 1).check(tmp_path / name, name)
