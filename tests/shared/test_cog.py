"""Cloud-Optimised GeoTIFFs: read back by an independent reader, laid out as one, the same bytes twice."""

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from shared.contracts.cog import read_cog, write_cog
from shared.errors import ContractError

TRANSFORM = from_origin(-2_050_000.0, 752_000.0, 1000.0, 1000.0)
ATTRIBUTES = {"simulated": True, "simulated_share": 0.5, "code_version": "0.1.0+abc"}


def codes(rows: int = 1100, columns: int = 1300) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (rows, columns)).astype(np.uint8)


def test_what_is_written_is_read_back_with_its_place_and_its_marks(tmp_path):
    wfpi = codes()
    write_cog(
        tmp_path / "a.tif",
        {"wfpi": wfpi, "wfpi_x": wfpi[::-1]},
        transform=TRANSFORM,
        crs="EPSG:6933",
        nodata=255,
        attributes=ATTRIBUTES,
    )
    bands, transform, crs, tags = read_cog(tmp_path / "a.tif")
    assert list(bands) == ["wfpi", "wfpi_x"]
    assert np.array_equal(bands["wfpi"], wfpi) and np.array_equal(bands["wfpi_x"], wfpi[::-1])
    assert transform == TRANSFORM and crs == "EPSG:6933"
    assert tags["simulated"] == "true" and tags["simulated_share"] == "0.5"


def test_it_is_laid_out_as_cog_with_overviews_of_codes_that_occur(tmp_path):
    coarse = np.where(codes() > 127, np.uint8(250), np.uint8(10))
    write_cog(tmp_path / "a.tif", {"c": coarse}, transform=TRANSFORM, crs="EPSG:5070", nodata=None, attributes={})
    with rasterio.open(tmp_path / "a.tif") as source:
        assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert source.overviews(1)
        small = source.read(1, out_shape=(source.height // 2, source.width // 2))
    assert set(np.unique(small)) == {10, 250}


def test_the_same_grid_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_cog(
            tmp_path / name,
            {"c": codes()},
            transform=TRANSFORM,
            crs="EPSG:5070",
            nodata=0,
            attributes=ATTRIBUTES,
            colormap={10: (1, 2, 3)},
        )
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize(
    "bands",
    [
        {},
        {"a": np.zeros((2, 3), np.float32), "b": np.zeros((3, 2), np.float32)},
        {"a": np.zeros((2, 3), np.float32), "b": np.zeros((2, 3), np.uint8)},
        {"a": np.zeros((2, 3), np.float64)},
        {"a": np.zeros(6, np.float32)},
    ],
)
def test_bands_that_make_no_raster_are_refused(tmp_path, bands):
    with pytest.raises(ContractError):
        write_cog(tmp_path / "a.tif", bands, transform=TRANSFORM, crs="EPSG:4326", nodata=None, attributes={})
    assert not (tmp_path / "a.tif").exists()


def test_another_file_is_refused_by_name(tmp_path):
    (tmp_path / "a.tif").write_text("<html>")
    with pytest.raises(ContractError, match=r"a\.tif"):
        read_cog(tmp_path / "a.tif")
