"""TIGN_G on the fire mesh of a Lambert domain: where cells lie, what their seconds mean, what is refused."""

from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
from pyproj import Geod

from services.arrival.exports.wrf_sfire import OUTSIDE_S, FireSubgrid, lambert_crs, read_subgrid, tign_g, write_tign_g
from shared.errors import DomainError
from tests.services.arrival.exports.made_maps import REFERENCE, round_fire

ATTRIBUTES = {"MAP_PROJ": 1, "TRUELAT1": 33.0, "TRUELAT2": 34.0, "STAND_LON": -106.2, "MOAD_CEN_LAT": 33.45}
ROWS, COLUMNS, RATIO_Y, RATIO_X, DX_M = 22, 24, 4, 5, 1000.0


def wrfinput(
    path: Path, longitude: float = -106.0, latitude: float = 33.5, mesh: bool = True, **attributes: float
) -> Path:
    """A wrfinput-like file of a small domain around a place; `mesh` fills FXLAT and FXLONG (else they hold zeros)."""
    from pyproj import Transformer

    held = {**ATTRIBUTES, "DX": DX_M, "DY": DX_M, "CEN_LAT": latitude, "CEN_LON": longitude, **attributes}
    crs = lambert_crs(held)
    x0, y0 = Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True).transform(longitude, latitude)
    back = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
    x = x0 + (np.arange(COLUMNS) - (COLUMNS - 1) / 2) * DX_M
    y = y0 + (np.arange(ROWS) - (ROWS - 1) / 2) * DX_M
    fx = x[0] - DX_M / 2 + (np.arange((COLUMNS + 1) * RATIO_X) + 0.5) * DX_M / RATIO_X
    fy = y[0] - DX_M / 2 + (np.arange((ROWS + 1) * RATIO_Y) + 0.5) * DX_M / RATIO_Y
    with netCDF4.Dataset(str(path), "w") as file:
        for name, size in (("Time", 1), ("south_north", ROWS), ("west_east", COLUMNS)):
            file.createDimension(name, size)
        file.createDimension("south_north_subgrid", fy.size)
        file.createDimension("west_east_subgrid", fx.size)
        for kind, axes in (("X", (x, y)), ("FX", (fx, fy))):
            lon, lat = back.transform(*np.meshgrid(*axes))
            dims = ("south_north", "west_east") if kind == "X" else ("south_north_subgrid", "west_east_subgrid")
            for name, values in (("LONG", lon), ("LAT", lat)):
                filled = np.asarray(values) if kind == "X" or mesh else np.zeros(np.shape(values))
                file.createVariable(kind + name, "f4", ("Time", *dims))[0] = filled
        file.setncatts(held)
    return path


@pytest.mark.parametrize("mesh", [True, False])
def test_the_mesh_is_that_of_the_file(tmp_path: Path, mesh: bool) -> None:
    path = wrfinput(tmp_path / "wrfinput_d02", mesh=True)
    subgrid = read_subgrid(path if mesh else wrfinput(tmp_path / "zeros", mesh=False))
    assert subgrid.ratio == (RATIO_Y, RATIO_X) and subgrid.cell_m == (200.0, 250.0)
    lon, lat = subgrid.degrees()
    with netCDF4.Dataset(str(path)) as file:
        theirs = file["FXLONG"][0], file["FXLAT"][0]
    _, _, off_m = Geod(ellps="WGS84").inv(lon, lat, *(np.asarray(v, float) for v in theirs))
    assert np.max(off_m) < 2.0  # the file's own coordinates are single precision
    assert subgrid.padding().sum() == subgrid.rows * subgrid.columns - ROWS * RATIO_Y * COLUMNS * RATIO_X


def test_reprojection_there_and_back_stays_within_half_a_cell(tmp_path: Path) -> None:
    subgrid = read_subgrid(wrfinput(tmp_path / "wrfinput_d02"))
    lon, lat = subgrid.degrees()
    made = round_fire()
    x, y = made.grid.local_km(lon.ravel(), lat.ravel())  # to the map's UTM grid
    east, north = made.grid.origin_km
    back = made.grid.degrees((x + east) * 1e3, (y + north) * 1e3)  # and to degrees again
    row, column = subgrid.index(*back)
    rows, columns = np.indices(lon.shape)
    assert np.abs(row - rows.ravel()).max() < 0.01 and np.abs(column - columns.ravel()).max() < 0.01


def test_a_field_there_and_back_moves_its_front_by_less_than_half_a_cell(tmp_path: Path) -> None:
    """Arrival is distance over speed, so an error of time is an error of place."""
    made = round_fire(speed_km_h=0.25, end_h=24.0)
    subgrid = read_subgrid(wrfinput(tmp_path / "wrfinput_d02"))
    values, outside = tign_g([(made, REFERENCE)], subgrid, REFERENCE, REFERENCE + pd.Timedelta(days=2))
    lon, lat = subgrid.degrees()
    x, y = made.grid.local_km(lon.ravel(), lat.ravel())
    distance_km = np.hypot(x, y).reshape(lon.shape)
    burned = values < outside
    off_km = np.abs(values[burned] / 3600.0 * 0.25 - distance_km[burned])
    assert burned.sum() > 1000 and np.median(off_km) < 0.02
    away = distance_km[burned] > 0.5  # the cone's tip is blunt
    assert off_km[away].max() < 0.5 * 0.25
    assert (distance_km[burned] < 6.0 + 0.25).all() and burned[(distance_km < 5.7) & ~subgrid.padding()].all()


def test_what_seconds_mean_before_the_start_and_after_the_end(tmp_path: Path) -> None:
    made = round_fire(end_h=24.0)
    subgrid = read_subgrid(wrfinput(tmp_path / "wrfinput_d02"))
    start, end = REFERENCE + pd.Timedelta(hours=6), REFERENCE + pd.Timedelta(hours=18)
    values, outside = tign_g([(made, REFERENCE)], subgrid, start, end)
    lon, lat = subgrid.degrees()
    hours = np.hypot(*made.grid.local_km(lon.ravel(), lat.ravel())).reshape(lon.shape) / 0.25
    inner = ~subgrid.padding()
    assert (values[(hours < 5) & inner] == 0).all(), "burned before the start: burning as it begins"
    middle = (hours > 7) & (hours < 17) & inner
    assert np.abs(values[middle] - (hours[middle] - 6) * 3600).max() < 0.1 * 3600
    assert (values[(hours > 19) & inner] == outside).all() and (values[subgrid.padding()] == outside).all()
    assert outside == OUTSIDE_S > (end - start).total_seconds()
    weeks = tign_g([(made, REFERENCE)], subgrid, start, start + pd.Timedelta(days=10))[1]
    assert weeks > 10 * 86400


def test_of_several_fires_the_earliest_counts(tmp_path: Path) -> None:
    one, other = round_fire(-106.04), round_fire(-105.96, end_h=12.0)
    subgrid = read_subgrid(wrfinput(tmp_path / "wrfinput_d02"))
    both = [(one, REFERENCE), (other, REFERENCE + pd.Timedelta(hours=2))]
    end = REFERENCE + pd.Timedelta(days=2)
    merged, _ = tign_g(both, subgrid, REFERENCE, end)
    single = [tign_g([fire], subgrid, REFERENCE, end)[0] for fire in both]
    np.testing.assert_array_equal(merged, np.minimum(*single))


def test_file_reads_as_wrf_writes_it(tmp_path: Path) -> None:
    made, subgrid = round_fire(), read_subgrid(wrfinput(tmp_path / "wrfinput_d02"))
    values, outside = tign_g([(made, REFERENCE)], subgrid, REFERENCE, REFERENCE + pd.Timedelta(days=1))
    for name in ("a.nc", "b.nc"):
        write_tign_g(tmp_path / name, values, subgrid, REFERENCE, outside, {"simulated": False, "code_version": "1"})
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    with netCDF4.Dataset(str(tmp_path / "a.nc")) as file:
        assert file["TIGN_G"].dimensions == ("Time", "south_north_subgrid", "west_east_subgrid")
        assert file["TIGN_G"].units == "s" and file["TIGN_G"].dtype == np.float32
        np.testing.assert_array_equal(file["TIGN_G"][0], values.astype(np.float32))
        assert b"".join(file["Times"][0].tolist()).decode() == "2022-06-01_18:00:00"
        assert file.outside_time_s == outside and file.sr_x == RATIO_X and file.DX == DX_M
        again = read_subgrid(wrfinput(tmp_path / "w2"))
        assert np.abs(file["FXLAT"][0] - again.degrees()[1]).max() < 1e-4


def test_southern_hemisphere_domain(tmp_path: Path) -> None:
    path = wrfinput(tmp_path / "w", 149.1, -37.5, TRUELAT1=-36.0, TRUELAT2=-39.0, STAND_LON=149.0, MOAD_CEN_LAT=-37.5)
    values, outside = tign_g(
        [(round_fire(149.1, -37.5), REFERENCE)], read_subgrid(path), REFERENCE, REFERENCE + pd.Timedelta(days=1)
    )
    row, column = np.unravel_index(values.argmin(), values.shape)
    assert (values < outside).sum() > 1000
    assert abs(row - ROWS * RATIO_Y / 2) <= 1 and abs(column - COLUMNS * RATIO_X / 2) <= 1


@pytest.mark.parametrize(
    ("change", "why"),
    [({"MAP_PROJ": 3}, "MAP_PROJ"), ({"drop": "DX"}, "DX"), ({"drop": "subgrid"}, "subgrid"), ({"text": 1}, "")],
)
def test_other_files_are_refused_by_name(tmp_path: Path, change: dict[str, object], why: str) -> None:
    path = wrfinput(tmp_path / "wrfinput_d02", **({"MAP_PROJ": 3} if "MAP_PROJ" in change else {}))
    if "text" in change:
        path.write_text("not netCDF")
    elif change.get("drop") == "DX":
        with netCDF4.Dataset(str(path), "a") as file:
            file.delncattr("DX")
    elif change.get("drop") == "subgrid":
        with netCDF4.Dataset(str(path), "w") as file:
            file.setncatts({**ATTRIBUTES, "DX": 1.0, "DY": 1.0})
    with pytest.raises(DomainError) as caught:
        read_subgrid(path)
    assert caught.value.field == "wrfinput" and "wrfinput_d02" in caught.value.message and why in caught.value.message


def test_a_domain_elsewhere_and_an_end_before_the_start_are_refused(tmp_path: Path) -> None:
    subgrid: FireSubgrid = read_subgrid(wrfinput(tmp_path / "w"))
    with pytest.raises(DomainError) as caught:
        tign_g([(round_fire(-100.0), REFERENCE)], subgrid, REFERENCE, REFERENCE + pd.Timedelta(days=1))
    assert caught.value.field == "wrfinput"
    with pytest.raises(DomainError) as caught:
        tign_g([(round_fire(), REFERENCE)], subgrid, REFERENCE, REFERENCE)
    assert caught.value.field == "simulation_end"
