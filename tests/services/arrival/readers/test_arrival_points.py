"""FIRMS CSV and HMS points in their documented forms, and the one door in front of all readers."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from services.arrival.readers.points import read_firms, read_hms
from services.arrival.readers.sources import read_active_fire
from shared.contracts.schema import write_table
from shared.contracts.tables import DETECTIONS
from shared.errors import DomainError
from tests.services.arrival.readers.granule_files import VIIRS_M, made_up, write_viirs_file

VIIRS_CSV = """latitude,longitude,bright_ti4,scan,track,acq_date,acq_time,satellite,instrument,confidence,version,\
bright_ti5,frp,daynight,type
33.25,-108.05,330.1,0.39,0.36,2022-05-14,0912,N,VIIRS,n,2.0NRT,290.1,4.2,N,0
33.26,-108.04,345.0,0.51,0.49,2022-05-14,0912,N20,VIIRS,h,2.0NRT,291.0,8.1,N,0
33.27,-108.03,310.0,0.51,0.49,2022-05-14,0912,N,VIIRS,l,2.0NRT,291.0,1.1,N,2
"""
MODIS_CSV = """latitude,longitude,brightness,scan,track,acq_date,acq_time,satellite,instrument,confidence,version,\
bright_t31,frp,daynight
-37.5,149.1,320.0,2.1,1.4,2020-01-04,340,Terra,MODIS,88,6.03,300.0,55.5,D
-37.6,149.2,320.0,1.0,1.0,2020-01-04,0005,Aqua,MODIS,31,6.03,300.0,,D
"""
HMS_TEXT = """       Lon,       Lat, YearDay, Time,        Satellite, Method of Detection, Ecosystem, Fire RadPower
 -97.173515, 32.463669, 2022095, 0610,        GOES-EAST,                 FDC,        41,       45.851
 -82.228790, 35.696796, 2022095, 0621,        SUOMI NPP,               VIIRS,        27,        3.629
 -82.228790, 35.696796, 2022095, 0621,        SUOMI NPP,               VIIRS,        27,        3.629
 -90.000000, 35.000000, 2022095, 1700,      MODIS TERRA,               MODIS,        27,     -999.000
 -91.000000, 35.500000, 2022095, 1700,         NOAA 20,            ANALYSIS,        27,     -999.000
"""


def _file(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_firms_viirs_and_modis_with_their_own_footprints(tmp_path: Path) -> None:
    rows = read_firms(_file(tmp_path / "v.csv", VIIRS_CSV))
    assert len(rows) == 2, "a static source is no wildfire"
    assert rows["time"].iloc[0] == pd.Timestamp("2022-05-14T09:12Z")
    assert list(rows["satellite"]) == ["SUOMI NPP", "NOAA 20"] and list(rows["confidence"]) == [75.0, 95.0]
    assert list(rows["across_m"]) == [390.0, 510.0] and list(rows["along_m"]) == [360.0, 490.0]
    modis = read_firms(_file(tmp_path / "m.csv", MODIS_CSV))
    assert list(modis["time"]) == [pd.Timestamp("2020-01-04T03:40Z"), pd.Timestamp("2020-01-04T00:05Z")]
    assert list(modis["satellite"]) == ["TERRA", "AQUA"] and list(modis["confidence"]) == [88.0, 31.0]
    assert modis["frp_mw"].isna().tolist() == [False, True] and modis["fire"].all()


def test_hms_text_by_its_columns(tmp_path: Path) -> None:
    rows = read_hms(_file(tmp_path / "hms.txt", HMS_TEXT))
    assert len(rows) == 4, "the doubled row counts once"
    assert list(rows["time"].dt.strftime("%m-%dT%H:%M")) == ["04-05T06:10", "04-05T06:21", "04-05T17:00", "04-05T17:00"]
    assert list(rows["instrument"]) == ["ABI", "VIIRS", "MODIS", "ANALYSIS"] and rows["satellite"].iloc[2] == "TERRA"
    assert rows["confidence"].isna().all() and rows["frp_mw"].isna().tolist() == [False, False, True, True]
    assert rows["along_m"].iloc[0] > 2500 > rows["across_m"].iloc[0] > 2000, "GOES at 32 N sees longer pixels"


def test_hms_archive_agrees_with_the_text_form(real_data: Path) -> None:
    path = real_data / "fires/detections_hms_conus_20220405_20220717.parquet"
    reading = read_active_fire(path, [(-108.4, 33.0, -107.6, 33.6)])
    rows = DETECTIONS.check(reading.detections)
    assert reading.report["format"] == "hms" and len(rows) > 2000 and rows["fire"].all()
    assert set(rows["instrument"]) >= {"VIIRS", "MODIS", "ABI"} and len(reading.obscured) == 0


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("33.26,", "ninety,", "latitude"),
        ("33.26,", "93.26,", "latitude"),
        ("33.26,", ",", "latitude"),
        ("2022-05-14,0912,N20", "2022-15-14,0912,N20", "acq_date, acq_time"),
        ("VIIRS,h,", "VIIRS,130,", "confidence"),
        ("scan,track", "scan,trick", "track"),
    ],
)
def test_a_bad_row_is_named(tmp_path: Path, old: str, new: str, field: str) -> None:
    with pytest.raises(DomainError) as caught:
        read_firms(_file(tmp_path / "bad.csv", VIIRS_CSV.replace(old, new, 1)))
    assert caught.value.field == field and "bad.csv" in caught.value.message
    if field != "track":
        assert "line 3" in caught.value.message


def test_one_door_tells_formats_apart_by_content(tmp_path: Path) -> None:
    everywhere = [(-180.0, -90.0, 180.0, 90.0)]
    firms = read_active_fire(_file(tmp_path / "a", VIIRS_CSV), everywhere)
    hms = read_active_fire(_file(tmp_path / "b", HMS_TEXT), everywhere)
    made = made_up(VIIRS_M, -40.0, -145.0, lines=160)
    made.mask[20:60, 1200:1300] = 4
    granule = read_active_fire(write_viirs_file(tmp_path / "c", made), [(-180.0, -90.0, 180.0, 90.0)])
    for reading, form in ((firms, "firms"), (hms, "hms"), (granule, "granule")):
        DETECTIONS.check(reading.detections)
        assert reading.report["format"] == form and reading.report["fire"] == reading.detections["fire"].sum() > 0
    assert set(granule.obscured["look"]) == {"cloud", "water"} and not granule.obscured["fire"].any()
    assert granule.report["cloud"] == (granule.obscured["look"] == "cloud").sum() > 1000
    write_table(tmp_path / "d", firms.detections, DETECTIONS)
    table = read_active_fire(tmp_path / "d", everywhere)
    assert table.report["format"] == "detections table" and len(table.detections) == 2
    far = read_active_fire(tmp_path / "a", [(10.0, 0.0, 11.0, 1.0)])
    assert len(far.detections) == 0 and far.report["outside_areas"] == 2
    with pytest.raises(DomainError) as caught:
        read_active_fire(_file(tmp_path / "e", "a,b\n1,2\n"), everywhere)
    assert caught.value.field == "detections" and "FIRMS" in caught.value.accepted


def test_an_empty_list_is_no_error(tmp_path: Path) -> None:
    rows = read_firms(_file(tmp_path / "none.csv", VIIRS_CSV.split("\n")[0] + "\n"))
    assert len(rows) == 0 and np.issubdtype(rows["along_m"].dtype, np.floating)
