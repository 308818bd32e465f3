"""The VIIRS reader against real granules, and the default method against what an aircraft saw."""

from pathlib import Path

import numpy as np
import pytest

from services.arrival.field import FieldSettings
from services.arrival.viirs import footprint_m, read_viirs
from shared.errors import DomainError
from tests.services.arrival.airborne import FIRES, sorensen_against_perimeter

BOBCAT = (-118.1, 34.1, -117.7, 34.4)


def test_footprints_grow_from_375_m_to_about_800_m() -> None:
    along, across = footprint_m(np.array([3200, 0, 6399, 4300]))
    assert along[0] == pytest.approx(375, abs=2) and across[0] == pytest.approx(388, abs=20)
    assert 750 < along[1] < 850 and 700 < across[1] < 850
    assert along[1] == pytest.approx(along[2]) and across[1] == pytest.approx(across[2])
    assert across[3] > across[0]


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


def test_noaa_20_granule_of_another_producer_reads_too(real_data: Path) -> None:
    path = next((real_data / "active_fire/readers").glob("VJ114*.nc"))
    rows = read_viirs(path, (-121.9, 39.5, -121.3, 40.0))  # the Camp Fire on its first day
    assert rows["satellite"].iloc[0] == "NOAA 20" and rows["fire"].sum() > 50 and (~rows["fire"]).any()


def test_another_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.nc").write_bytes(b"not netCDF")
    with pytest.raises(DomainError) as caught:
        read_viirs(tmp_path / "x.nc", BOBCAT)
    assert caught.value.field == "path"


def test_mineral_agrees_with_its_airborne_perimeter(real_data: Path) -> None:
    assert "mineral" in FIRES
    quick = FieldSettings(steps=120, members=2)
    assert sorensen_against_perimeter(real_data, "mineral", "fusion-nn", quick) > 0.72
