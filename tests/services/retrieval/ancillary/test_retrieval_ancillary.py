"""Rasters of any CRS, terrain, SMAP files and burned-area labels against closed forms and brute force."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pyproj
import pytest
import rasterio
from rasterio.transform import from_origin
from scipy.interpolate import RegularGridInterpolator

from services.retrieval.ancillary.burned_rasters import BurnedRaster, burn_times_at, label_by_rasters
from services.retrieval.ancillary.layers import Layers, terrain, with_ancillary
from services.retrieval.ancillary.rasters import TILE, interpolate, open_raster, sample
from services.retrieval.ancillary.smap import latest_before, read_smap
from services.retrieval.burned_area.labels import BURNED, UNBURNED, UNKNOWN
from services.retrieval.ease_grid import centre, row_column
from shared.errors import DomainError

SINUSOIDAL = "+proj=sinu +lon_0=0 +x_0=0 +y_0=0 +R=6371007.181 +units=m +no_defs"


def write_raster(
    path: Path, values: np.ndarray, transform, crs: str = "EPSG:4326", nodata: float | None = None
) -> Path:
    height, width = values.shape
    profile = {"driver": "GTiff", "count": 1, "height": height, "width": width, "dtype": values.dtype.name}
    with rasterio.open(path, "w", crs=crs, transform=transform, nodata=nodata, **profile) as file:
        file.write(values, 1)
    return path


def _places(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-121.0, -119.0, count), rng.uniform(35.0, 37.0, count)


@pytest.mark.parametrize(
    "crs", ["EPSG:4326", "EPSG:32610", "EPSG:6933", SINUSOIDAL], ids=["geo", "utm", "ease", "modis"]
)
def test_sampling_is_rasterios_own_in_any_crs(tmp_path: Path, crs: str) -> None:
    """Against rasterio's point sampler, over several tiles."""
    longitude, latitude = _places(500)
    px, py = pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(longitude, latitude)
    x, y = (px.min(), px.max()), (py.max(), py.min())
    size = TILE + 300
    transform = from_origin(x[0], y[0], (x[1] - x[0]) / size, (y[0] - y[1]) / size)
    values = np.random.default_rng(1).integers(0, 366, (size, size)).astype(np.int16)
    path = write_raster(tmp_path / "r.tif", values, transform, crs)
    with open_raster(path) as source:
        found = sample(source, longitude, latitude)
        again = sample(source, longitude % 360.0, latitude)
        expected = np.array([value[0] for value in source.sample(zip(px, py, strict=True))], dtype=float)
    inside = np.isfinite(found)  # places on the outermost edge may lie a rounding beyond it
    assert inside.sum() >= 496
    assert np.array_equal(found[inside], expected[inside]) and np.array_equal(again[inside], expected[inside])
    assert (found > 0).mean() > 0.9


def test_nothing_outside_and_no_data_is_nan(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "r.tif", np.array([[1, -9], [3, 4]], np.int16), from_origin(0, 2, 1, 1), nodata=-9)
    with open_raster(path) as source:
        found = sample(source, np.array([0.5, 1.5, 5.0, 0.5]), np.array([1.5, 1.5, 1.5, -3.0]))
    assert found[0] == 1 and np.isnan(found[1:]).all()


def test_interpolation_is_scipys_between_pixel_centres(tmp_path: Path) -> None:
    values = np.random.default_rng(2).normal(0.0, 1.0, (40, 50)).astype(np.float32)
    path = write_raster(tmp_path / "r.tif", values, from_origin(-122.0, 37.5, 0.08, 0.08))
    rows, columns = 37.5 - 0.08 * (np.arange(40) + 0.5), -122.0 + 0.08 * (np.arange(50) + 0.5)
    longitude, latitude = _places(300)
    expected = RegularGridInterpolator((rows[::-1], columns), values[::-1])(np.stack([latitude, longitude], axis=1))
    with open_raster(path) as source:
        assert interpolate(source, longitude, latitude) == pytest.approx(expected, abs=1e-5)


def test_slope_of_a_tilted_plane_is_its_tilt_in_any_crs(tmp_path: Path) -> None:
    """A plane that rises 100 m a km eastwards, in UTM: 5.71 deg, whatever the pixels."""
    heights = np.broadcast_to(0.1 * (np.arange(400) * 500.0), (400, 400)).astype(np.float32)
    path = write_raster(tmp_path / "dem.tif", heights.copy(), from_origin(600_000, 4_100_000, 500, 500), "EPSG:32610")
    longitude, latitude = pyproj.Transformer.from_crs(32610, 4326, always_xy=True).transform([650_000.0], [4_000_000.0])
    height, slope = terrain(path, np.array(latitude), np.array(longitude))
    assert height[0] == pytest.approx(0.1 * (50_000.0 - 250.0), abs=1.0)
    assert slope[0] == pytest.approx(np.rad2deg(np.arctan(0.1)), abs=0.05)


@pytest.mark.parametrize(
    "content", [b"", b"no raster at all", b"\x0e\x03\x13\x01 cut off"], ids=["empty", "text", "hdf4"]
)
def test_a_file_that_is_no_raster_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "r.tif").write_bytes(content)
    with pytest.raises(DomainError) as error, open_raster(tmp_path / "r.tif", field="elevation"):
        pass
    assert error.value.field == "elevation" and "r.tif" in error.value.message


def test_modis_tile_in_hdf4_lies_where_its_corners_say(tmp_path: Path) -> None:
    """A tile as NASA writes it: the place of a known pixel comes back through the sinusoidal projection."""
    from pyhdf.SD import SD, SDC

    size, west, north, pixel = 240, -11119505.196667, 4447802.078667, 4633.12716525
    values = np.zeros((size, size), np.int16)
    values[100, 50] = 200
    file = SD(str(tmp_path / "MCD64A1.hdf"), SDC.WRITE | SDC.CREATE)
    data = file.create("Burn Date", SDC.INT16, values.shape)
    data[:] = values
    data.endaccess()
    corners = f"UpperLeftPointMtrs=({west},{north})\nLowerRightMtrs=({west + size * pixel},{north - size * pixel})\n"
    file.attr("StructMetadata.0").set(SDC.CHAR, "GROUP=GridStructure\n" + corners)
    file.end()
    x, y = west + 50.5 * pixel, north - 100.5 * pixel
    longitude, latitude = pyproj.Transformer.from_crs(SINUSOIDAL, 4326, always_xy=True).transform(x, y)
    raster = BurnedRaster(tmp_path / "MCD64A1.hdf", "day-of-year", year=2021)
    times, seen = burn_times_at(raster, np.array([longitude, longitude + 0.2]), np.array([latitude, latitude]))
    assert seen.all() and np.isnat(times[1])
    assert times[0] == np.datetime64("2021-07-20", "ms")  # day 200 is 19 July: burned from its end


def _looks(longitude: list[float], day: str, latitude: float = 36.0) -> pd.DataFrame:
    count = len(longitude)
    time = np.full(count, np.datetime64(day, "ms"))
    return pd.DataFrame({"time": time, "latitude_deg": np.full(count, latitude), "longitude_deg": longitude})


@pytest.fixture
def rasters(tmp_path: Path) -> list[BurnedRaster]:
    """Two products of different CRS over one box: west burned on day 150 by one, the middle as class by the other."""
    days = np.zeros((200, 300), np.int16)
    days[:, :100] = 150
    days[:, 250:] = -1  # not observed
    classes = np.zeros((200, 300), np.uint8)
    classes[:, 100:200] = 1
    classes[:, 250:] = 255
    transform = from_origin(-120.0, 36.2, 0.002, 0.002)
    first = write_raster(tmp_path / "doy.tif", days, transform)
    second = write_raster(tmp_path / "class.tif", classes, transform, nodata=255)
    burned_on = np.datetime64("2021-07-01", "ms")
    return [BurnedRaster(first, "day-of-year", year=2021), BurnedRaster(second, "class", burned_on=burned_on)]


def test_labels_are_the_union_of_the_rasters_at_the_looks_time(rasters: list[BurnedRaster]) -> None:
    places = [-119.9, -119.7, -119.55, -119.45, -118.0]  # day 150; class; unburned; observed by none; outside
    before, between, after = (
        label_by_rasters(_looks(places, day), rasters) for day in ("2021-05-01", "2021-06-10", "2021-08-01")
    )
    assert before.tolist() == [UNBURNED, UNBURNED, UNBURNED, UNKNOWN, UNKNOWN]
    assert between.tolist() == [BURNED, UNBURNED, UNBURNED, UNKNOWN, UNKNOWN]
    assert after.tolist() == [BURNED, BURNED, UNBURNED, UNKNOWN, UNKNOWN]


def test_looks_about_the_day_of_burning_are_unknown(rasters: list[BurnedRaster]) -> None:
    """Day 150 is 30 May; with an uncertainty of a day nothing is said from 29 May to 1 June."""
    found = [
        int(label_by_rasters(_looks([-119.9], day), rasters[:1])[0])
        for day in ("2021-05-28", "2021-05-30T12", "2021-06-01")
    ]
    assert found == [UNBURNED, UNKNOWN, BURNED]


def test_unburned_counts_only_while_observed(rasters: list[BurnedRaster]) -> None:
    bounded = BurnedRaster(rasters[0].path, "day-of-year", year=2021, observed_to=np.datetime64("2021-07-01", "ms"))
    found = label_by_rasters(_looks([-119.9, -119.55], "2021-08-01"), [bounded])
    assert found.tolist() == [BURNED, UNKNOWN]


@pytest.mark.parametrize(
    ("coding", "given", "field"),
    [("day-of-year", {}, "burned_rasters.year"), ("class", {}, "burned_rasters.burned_on"), ("dates", {}, "coding")],
)
def test_codings_say_what_they_need(coding: str, given: dict, field: str) -> None:
    with pytest.raises(DomainError) as error:
        BurnedRaster(Path("x.tif"), coding, **given)
    assert error.value.field == field


def test_values_that_are_no_days_are_refused(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "r.tif", np.full((9, 9), 2021, np.int16), from_origin(-120.0, 36.5, 0.1, 0.1))
    with pytest.raises(DomainError) as error:
        label_by_rasters(_looks([-119.5], "2021-08-01"), [BurnedRaster(path, "day-of-year", year=2021)])
    assert error.value.field == "burned_rasters" and error.value.value == 2021


def _smap_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """A level-3 file as NSIDC ships it: AM and PM groups, fill, and a cell whose retrieval is not recommended."""
    rows, columns = np.meshgrid(np.arange(400, 404), np.arange(600, 605), indexing="ij")
    latitude, longitude = centre(rows, columns, 9)
    with netCDF4.Dataset(path, "w") as file:
        for half, suffix, shift in (("AM", "", 0.0), ("PM", "_pm", 0.1)):
            group = file.createGroup(f"Soil_Moisture_Retrieval_Data_{half}")
            group.createDimension("y", 4)
            group.createDimension("x", 5)
            moisture = (0.1 + shift + 0.001 * np.arange(20)).reshape(4, 5)
            moisture[0, 0] = -9999.0
            flag = np.zeros((4, 5), np.uint16)
            flag[1, 1] = 1
            for name, values in (("soil_moisture", moisture), ("latitude", latitude), ("longitude", longitude)):
                group.createVariable(name + suffix, "f4", ("y", "x"), fill_value=-9999.0)[:] = values
            group.createVariable("retrieval_qual_flag" + suffix, "u2", ("y", "x"))[:] = flag
    return rows, columns


def test_smap_level_3_reads_both_passes_without_fill_and_poor_retrievals(tmp_path: Path) -> None:
    path = tmp_path / "SMAP_L3_SM_P_E_20210715_R18290_001.h5"
    rows, columns = _smap_file(path)
    table = read_smap(path)
    assert len(table) == 2 * 18
    morning = table.head(18)
    keep = np.ones((4, 5), bool)
    keep[0, 0] = keep[1, 1] = False
    assert morning["row"].tolist() == rows[keep].tolist() and morning["column"].tolist() == columns[keep].tolist()
    assert morning["soil_moisture"].to_numpy() == pytest.approx(
        (0.1 + 0.001 * np.arange(20)).reshape(4, 5)[keep], abs=1e-6
    )
    _, longitude = centre(np.array([401]), np.array([602]), 9)
    local_h = 6.0 - longitude[0] / 15.0
    assert abs((morning["time"].iloc[0] - pd.Timestamp("2021-07-15")) / pd.Timedelta(hours=1) - local_h) < 0.1


def test_smap_of_texas_is_read(real_data: Path) -> None:
    paths = sorted((real_data / "gnssr/texas_2024").glob("SMAP_*/*.nc"))
    table = pd.concat([read_smap(path, resolution_km=36) for path in paths])
    latitude, longitude = centre(table["row"].to_numpy(), table["column"].to_numpy(), 36)
    assert table["soil_moisture"].between(0.02, 0.65).all() and len(table) > 200
    assert ((latitude > 25) & (latitude < 37.5) & (longitude > -108) & (longitude < -93)).all()


def test_ancillary_soil_moisture_never_comes_from_later() -> None:
    """Brute force: the last value of the cell at or before the look, ten days old at most."""
    rng = np.random.default_rng(3)
    longitude, latitude = _places(200, 4)
    start = np.datetime64("2021-06-01", "ms")
    hours = lambda high, count: rng.integers(0, high, count) * np.timedelta64(3_600_000, "ms")  # noqa: E731
    looks = pd.DataFrame({"time": start + hours(900, 200), "latitude_deg": latitude, "longitude_deg": longitude})
    row, column = row_column(latitude, longitude, 36)
    pick = rng.integers(0, 200, 300)
    table = pd.DataFrame({"time": start + hours(900, 300), "row": row[pick], "column": column[pick]})
    table["soil_moisture"] = rng.random(300)
    found = latest_before(looks, table, resolution_km=36)
    for n in range(200):
        here = table[(table["row"] == row[n]) & (table["column"] == column[n]) & (table["time"] <= looks["time"][n])]
        here = here[here["time"] >= looks["time"][n] - pd.Timedelta(days=10)].sort_values("time", kind="stable")
        assert (
            np.isnan(found[n])
            if here.empty
            else found[n] in here["soil_moisture"][here["time"] == here["time"].max()].tolist()
        )


@pytest.mark.parametrize(
    ("name", "content", "field"),
    [("SMAP_20210715.h5", b"not hdf", "soil_moisture"), ("table.parquet", b"PAR1 broken", "soil_moisture")],
)
def test_broken_soil_moisture_is_named(tmp_path: Path, name: str, content: bytes, field: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DomainError) as error:
        read_smap(tmp_path / name)
    assert error.value.field == field


def test_layers_lie_over_what_level_1_says(tmp_path: Path) -> None:
    looks = _looks([-119.5, -110.0], "2021-08-01").assign(height_m=[5.0, 7.0], land_cover=[np.nan, 12.0])
    path = write_raster(tmp_path / "d.tif", np.full((9, 9), 100, np.int16), from_origin(-120.0, 36.5, 0.1, 0.1))
    found = with_ancillary(looks, Layers(elevation=path, land_cover=path))
    assert found["height_m"].tolist() == [100.0, 7.0] and found["land_cover"].tolist() == [100.0, 12.0]
    assert found["slope_deg"][0] == pytest.approx(0.0) and found["ancillary_soil_moisture"].isna().all()
