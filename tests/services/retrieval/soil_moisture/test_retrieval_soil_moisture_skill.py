"""Held-out skill of the regression: drying land, unseen blocks, seasons; 9 and 36 km grids; SMAP files."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import rasterio

from services.retrieval.ancillary.smap import read_smap
from services.retrieval.ease_grid import centre, ease_grid
from services.retrieval.soil_moisture.level3 import level3_grid, write_level3_cog
from services.retrieval.soil_moisture.regression import fit_cells, on_grid, predict, retrieve
from services.retrieval.soil_moisture.skill import evaluate, interval_factor, leave_blocks_out, train_reference
from shared.errors import DomainError
from tests.services.retrieval.texas import texas_pairs

SENSITIVITY = 0.03  # m3/m3 per dB in what follows


def _drying(days: int, side: int = 16, spot_db: float = 3.0, seed: int = 0) -> pd.DataFrame:
    """Cell-days of a land that dries for good, seen by looks that differ by spot far more than by moisture."""
    rng = np.random.default_rng(seed)
    table = pd.MultiIndex.from_product([range(side), range(side), range(days)], names=["row", "column", "day"])
    pairs = table.to_frame(index=False).sample(frac=0.4, random_state=seed).reset_index(drop=True)
    place = rng.uniform(-0.03, 0.03, (side, side))[pairs["row"], pairs["column"]]
    wetness = 0.12 * np.exp(-pairs["day"].to_numpy() / 10.0)
    truth = 0.12 + place + wetness
    dim = rng.uniform(-4.0, 4.0, (side, side))[pairs["row"], pairs["column"]]
    reflectivity = -20.0 + dim + wetness / SENSITIVITY + rng.normal(0.0, spot_db, len(pairs))
    given = truth + rng.normal(0.0, 0.01, len(pairs))
    return pairs.assign(soil_moisture=given, reflectivity_db=reflectivity, count=1)


def test_land_that_has_dried_is_not_kept_wet() -> None:
    """Fitted on the wet days, judged on the dry ones after: the cell mean is too wet by far, the regression is not."""
    pairs = _drying(24)
    early, late = pairs[pairs["day"] < 12], pairs[pairs["day"] >= 12]
    found = predict(late, fit_cells(early), ["day"])
    bias = float((found["estimate"] - found["soil_moisture"]).mean())
    mean_bias = float((found["soil_moisture_mean"] - found["soil_moisture"]).mean())
    assert mean_bias > 0.04 and abs(bias) < 0.3 * mean_bias
    assert fit_cells(early)["area_slope"].iloc[0] == pytest.approx(SENSITIVITY, rel=0.3)


def test_every_way_of_holding_out_stands_beside_the_cell_mean() -> None:
    pairs = _drying(12, side=24)
    report = evaluate(pairs)
    assert set(report) == {"leave_a_day_out", "leave_a_block_out", "forward_in_time"}
    for way in report.values():
        assert way["regression"]["count"] == way["cell_mean_baseline"]["count"] > 100
    assert 0.87 < report["leave_a_day_out"]["regression"]["interval90_coverage"] < 0.93
    apart = pairs.assign(day=np.where(pairs["day"] >= 6, pairs["day"] + 100, pairs["day"]))
    assert set(evaluate(apart)["transfer"]) == {"first_to_second", "second_to_first"}


def test_blocks_held_out_see_nothing_of_their_own_soil_moisture() -> None:
    pairs = _drying(10, side=40)
    block = (pairs["row"] // 17 == 0) & (pairs["column"] // 17 == 0)
    assert block.any()
    shifted = pairs.assign(soil_moisture=pairs["soil_moisture"] + np.where(block, 0.2, 0.0))
    keys = ["row", "column", "day"]
    plain, moved = (leave_blocks_out(table).sort_values(keys, ignore_index=True) for table in (pairs, shifted))
    inside = ((plain["row"] // 17 == 0) & (plain["column"] // 17 == 0)).to_numpy()
    assert plain["estimate"][inside].to_numpy() == pytest.approx(moved["estimate"][inside].to_numpy(), abs=1e-12)


def test_factor_brings_the_interval_to_nine_in_ten() -> None:
    rng = np.random.default_rng(0)
    held = pd.DataFrame({"estimate": 0.0, "soil_moisture": rng.normal(0.0, 0.05, 4000), "sd": 0.02})
    assert interval_factor(held) == pytest.approx(2.5, rel=0.06)
    assert interval_factor(held.head(5)) == 1.0


def test_36_km_cells_hold_sixteen_of_9_km_and_make_a_reference_of_their_own(tmp_path: Path) -> None:
    pairs = _drying(12)
    time = (np.datetime64("2024-03-01") + pairs["day"].to_numpy()).astype("datetime64[ms]")
    looks = pairs[["row", "column", "reflectivity_db"]].assign(time=time, incidence_deg=30.0, mode="nominal")
    truth = on_grid(pairs.assign(time=time)[["time", "row", "column", "soil_moisture"]], 36)
    reference = train_reference(looks, truth, 36)
    assert len(reference) == 16 and set(reference["resolution_km"]) == {36}
    table, _ = retrieve(looks, reference)
    assert table["row"].max() == 3 and table["count"].sum() == len(looks)
    grid = level3_grid(table, 36)
    assert grid.attrs["grid"] == "EASE2_M36km" and grid["SM_daily"].shape == (12, 4, 4)
    write_level3_cog(tmp_path / "moisture.tif", grid, {"simulated": False})
    with rasterio.open(tmp_path / "moisture.tif") as source:
        assert source.crs.to_epsg() == 6933 and source.res == pytest.approx((36032.22, 36032.22), abs=0.01)
        assert source.descriptions[0] == "SM_daily 2024-03-01" and source.count == 36
        assert np.allclose(source.read(1), grid["SM_daily"].to_numpy()[0], atol=1e-6)
        assert source.bounds.top == pytest.approx(7314540.83) and source.bounds.left == pytest.approx(-17367530.445)
    with pytest.raises(DomainError):
        on_grid(looks, 25)


def test_smap_level_3_file_is_read_by_its_names_and_flags(tmp_path: Path) -> None:
    """A file laid out as SPL3SMP_E: groups by half day, names with _pm, fill -9999, recommended quality in bit 0."""
    row, column = np.meshgrid(np.arange(360, 363), np.arange(740, 744), indexing="ij")
    latitude, longitude = centre(row, column, 9)
    morning = np.full(row.shape, 0.2, dtype=np.float32)
    morning[0, 0], morning[0, 1] = -9999.0, 0.9
    flag = np.zeros(row.shape, dtype=np.uint16)
    flag[1, 1], flag[1, 2] = 1, 8  # not recommended; recommended with another bit set
    path = tmp_path / "SMAP_L3_SM_P_E_20240301_R19240_001.h5"
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("y", row.shape[0])
        file.createDimension("x", row.shape[1])
        for half, suffix, values in (("AM", "", morning), ("PM", "_pm", morning + 0.1)):
            group = file.createGroup(f"Soil_Moisture_Retrieval_Data_{half}")
            fields = {"soil_moisture": values, "latitude": latitude, "longitude": longitude}
            for name, field in fields.items():
                variable = group.createVariable(name + suffix, "f4", ("y", "x"), fill_value=-9999.0)
                variable[:] = field
            group.createVariable("retrieval_qual_flag" + suffix, "u2", ("y", "x"))[:] = flag
    table = read_smap(path)
    early = table[table["soil_moisture"] < 0.25]
    assert len(early) == 12 - 3 and len(table) == 9 + 9  # fill, out of range, not recommended
    assert early["time"].iloc[0] > np.datetime64("2024-03-01T12") and set(table["row"]) <= set(range(360, 363))
    kept = set(zip(early["row"], early["column"], strict=True))
    assert (361, 742) in kept and (361, 741) not in kept and (360, 740) not in kept


def test_texas_days_blocks_and_seasons(real_data: Path) -> None:
    """Real looks beat the cell mean on held-out days and blocks; between seasons what is left is told as bias."""
    pairs = texas_pairs(real_data)
    report = evaluate(pairs, 36)
    for way in ("leave_a_day_out", "leave_a_block_out"):
        own, mean = (report[way][name]["ubrmse"] for name in ("regression", "cell_mean_baseline"))
        assert own < mean
    for way in report["transfer"].values():
        assert np.isfinite(way["regression"]["bias"]) and way["regression"]["count"] > 300


def test_monotone_in_simulated_moisture() -> None:
    """A brighter land is never estimated drier, whatever the cell's slopes were fitted as."""
    pairs = _drying(10)
    model = fit_cells(pairs)
    assert (model["slope"] >= 0).all() and (model["area_slope"] >= 0).all()
    day = pairs[pairs["day"] == 3]
    steps = [predict(day.assign(reflectivity_db=day["reflectivity_db"] + s), model, ["day"]) for s in (-3.0, 0.0, 3.0)]
    estimates = np.stack([step["estimate"] for step in steps])
    assert (np.diff(estimates, axis=0) > 0).all()
    assert ease_grid(9).cell_m * 4 == pytest.approx(ease_grid(36).cell_m)
