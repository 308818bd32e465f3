"""Granules of VIIRS and MODIS: classes told apart, every pixel where it lies, footprints by scan angle."""

from pathlib import Path

import numpy as np
import pytest

from services.arrival.readers.granules import open_granule, read_pixels, read_viirs, within_area
from services.arrival.readers.scanners import MODIS, VIIRS_I, VIIRS_M, geostationary_footprint_m
from services.arrival.readers.swath import degrees_of, earth_fixed_km, fit_swath
from shared.errors import DomainError
from tests.services.arrival.readers.granule_files import MadeUp, made_up, write_modis_file, write_viirs_file

BOBCAT = (-118.1, 34.1, -117.7, 34.4)
# Node and argument of latitude so that the pass covers the southern Andes, and the Pacific across the antimeridian.
SOUTHERN, DATE_LINE = (-40.0, -145.0), (171.0, 198.0)


def test_footprints_grow_with_the_scan_angle_as_published() -> None:
    along, across = VIIRS_I.footprint_m(np.array([3200, 0, 6399, 4300]))
    assert along[0] == pytest.approx(375, abs=2) and across[0] == pytest.approx(388, abs=20)
    assert 750 < along[1] < 850 and 700 < across[1] < 850
    assert along[1] == pytest.approx(along[2]) and across[1] == pytest.approx(across[2])
    assert across[3] > across[0]
    # MODIS at the edge of the swath: 2.01 km along, 4.83 km across (Nishihama et al. 1997; FIRMS).
    along, across = MODIS.footprint_m(np.array([677, 0]))
    assert along[0] == pytest.approx(1000, abs=2) and across[0] == pytest.approx(1000, abs=5)
    assert along[1] == pytest.approx(2010, rel=0.02) and across[1] == pytest.approx(4830, rel=0.02)
    along, across = VIIRS_M.footprint_m(np.array([1600, 0]))
    assert along[0] == pytest.approx(750, abs=2) and 1500 < across[1] < 1700  # 1.6 km at the edge


def test_geostationary_pixels_stretch_towards_the_limb() -> None:
    longer, shorter = geostationary_footprint_m(np.array([-75.2, -110.0, 80.0]), np.array([0.0, 45.0, 0.0]), -75.2)
    assert longer[0] == pytest.approx(2004) == shorter[0]
    assert longer[1] > 1.7 * shorter[1] > 3000
    assert np.isnan(longer[2])


def _worst_misplacement_km(made: MadeUp, rows: object, look: str) -> float:
    """Largest distance of pixels read as `look` from the nearest pixel that truly is of that class."""
    from scipy.spatial import cKDTree

    code = {"no fire": 5, "cloud": 4, "water": 3}[look]
    true = earth_fixed_km(made.longitude[made.mask == code], made.latitude[made.mask == code])
    read = rows[rows["look"] == look]
    ours = earth_fixed_km(read.geometry.x.to_numpy(float), read.geometry.y.to_numpy(float))
    return float(cKDTree(true).query(ours)[0].max())


@pytest.mark.parametrize("orbit", [SOUTHERN, DATE_LINE])
@pytest.mark.parametrize("scanner", [VIIRS_M, MODIS])
def test_every_class_is_read_where_it_lies_in_any_hemisphere(tmp_path: Path, scanner, orbit) -> None:
    made = made_up(scanner, *orbit, lines=240)
    path = tmp_path / ("x.hdf" if scanner is MODIS else "x.nc")
    (write_modis_file if scanner is MODIS else write_viirs_file)(path, made)
    granule = open_granule(path)
    lon, lat = granule.longitude[0], granule.latitude[0]
    area = ((lon - 1.5 + 180) % 360 - 180, lat - 1.2, (lon + 1.5 + 180) % 360 - 180, lat + 1.2)
    pixels, placed = read_pixels(granule, [area])
    assert placed
    truth = within_area(made.longitude, made.latitude, area)
    for look, code in (("no fire", 5), ("cloud", 4), ("water", 3)):
        want = int((truth & (made.mask == code)).sum())
        assert (pixels["look"] == look).sum() == pytest.approx(want, rel=0.02, abs=10), look
        if want:
            assert _worst_misplacement_km(made, pixels, look) < 0.35 * scanner.pixel_m / 1e3
    fires = within_area(granule.longitude, granule.latitude, area).sum()
    assert (pixels["look"] == "fire").sum() == fires == pixels["fire"].sum() > 20
    assert pixels["satellite"].iloc[0] == ("AQUA" if scanner is MODIS else "SUOMI NPP")
    assert str(pixels["time"].iloc[0]) == "2023-01-15 12:03:00+00:00"


def test_imagery_classes_differ_from_the_older_ones(tmp_path: Path) -> None:
    made = made_up(VIIRS_I, *SOUTHERN, lines=128)
    made.mask[made.mask == 4] = 5
    made.mask[:, 2000:2300] = 2  # glint in the imagery product
    lon, lat = made.longitude[64, 2300], made.latitude[64, 2300]
    pixels, _ = read_pixels(
        open_granule(write_viirs_file(tmp_path / "x.nc", made)), [(lon - 1, lat - 1, lon + 1, lat + 1)]
    )
    assert {"glint", "no fire"} <= set(pixels["look"]) and "cloud" not in set(pixels["look"])
    assert set(pixels.loc[pixels["fire"], "confidence"]) <= {75.0}


def test_a_pass_without_a_fire_cannot_be_placed_and_says_so(tmp_path: Path) -> None:
    made = made_up(VIIRS_M, *SOUTHERN, lines=96, fires=0)
    pixels, placed = read_pixels(open_granule(write_viirs_file(tmp_path / "x.nc", made)), [(-180, -90, 180, 90)])
    assert not placed and len(pixels) == 0


def test_held_out_fire_pixels_of_real_granules_are_placed_to_half_a_pixel(real_data: Path) -> None:
    """The independent check of the geometry: positions that the product states and the fit has not seen."""
    granules = [
        *sorted((real_data / "active_fire").glob("*/VNP14IMG*.nc"))[:3],
        *(real_data / "active_fire/readers").iterdir(),
    ]
    for path in granules:
        granule = open_granule(path)
        held = np.arange(granule.line.size) % 5 == 0
        parts = (granule.line, granule.sample, granule.longitude, granule.latitude)
        swath = fit_swath(granule.scanner, granule.mask.shape[0], tuple(part[~held] for part in parts), granule.corners)
        assert swath is not None
        ours = swath.positions_km(granule.line[held], granule.sample[held])
        off = np.linalg.norm(ours - earth_fixed_km(granule.longitude[held], granule.latitude[held]), axis=1)
        assert np.median(off) < 0.5 * granule.scanner.pixel_m / 1e3, path.name
        assert np.quantile(off, 0.9) < 1.3 * granule.scanner.pixel_m / 1e3, path.name
        lon, lat = degrees_of(ours)
        assert np.abs(lat - granule.latitude[held]).max() < 0.1 and np.abs(lon - granule.longitude[held]).max() < 0.1


def test_granule_gives_fire_and_clear_land_where_they_are(real_data: Path) -> None:
    path = sorted((real_data / "active_fire/bobcat").glob("*.nc"))[0]
    rows = read_viirs(path, BOBCAT)
    fire = rows[rows["fire"]]
    assert 20 < len(fire) < 2904 and fire["frp_mw"].gt(0).all()
    assert set(fire["confidence"]) <= {20.0, 75.0, 95.0}
    assert str(rows["time"].iloc[0]) == "2020-09-07 09:27:00+00:00"
    land = rows[~rows["fire"]]
    assert len(land) > 5 * len(fire)
    # Fire and land pixels share one swath lattice: no land pixel may lie on top of a fire pixel.
    x = np.column_stack([land.geometry.x * np.cos(np.radians(34.2)), land.geometry.y]) * 111.3
    p = np.column_stack([fire.geometry.x * np.cos(np.radians(34.2)), fire.geometry.y]) * 111.3
    gap = np.sqrt(((x[:, None] - p[None]) ** 2).sum(2)).min(axis=0)
    assert np.median(gap[gap < 1.5]) > 0.2


def test_moderate_resolution_and_modis_granules_of_the_camp_fire(real_data: Path) -> None:
    area = (-121.9, 39.5, -121.3, 40.0)  # its first day
    path = next((real_data / "active_fire/readers").glob("VJ114*.nc"))
    rows = read_viirs(path, area)
    assert rows["satellite"].iloc[0] == "NOAA 20" and rows["fire"].sum() > 50 and (~rows["fire"]).any()
    assert rows["along_m"].between(750, 1700).all() and rows.loc[rows["fire"], "confidence"].between(0, 100).all()
    path = next((real_data / "active_fire/readers").glob("MOD14*.hdf"))
    pixels, placed = read_pixels(open_granule(path), [area])
    assert placed and pixels["satellite"].iloc[0] == "TERRA"
    assert (pixels["look"] == "fire").sum() > 20 and (pixels["look"] == "no fire").sum() > 300
    assert str(pixels["time"].iloc[0]) == "2018-11-08 19:52:30+00:00"
    # Both saw the same fire within an hour.
    theirs = rows[rows["fire"]].geometry.union_all().convex_hull
    assert pixels[pixels["fire"]].geometry.union_all().convex_hull.intersection(theirs).area > 0.5 * theirs.area


@pytest.mark.parametrize("content", [b"not netCDF", b"\x0e\x03\x13\x01broken", b"", b"\x89HDF\r\n\x1a\nbroken"])
def test_another_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.nc").write_bytes(content)
    with pytest.raises(DomainError) as caught:
        read_viirs(tmp_path / "x.nc", BOBCAT)
    assert caught.value.field == "path" and "x.nc" in caught.value.message
