"""Per-cell regression: recovery of known slopes, pooling, intervals, and real CYGNSS with SMAP over Texas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from services.retrieval.soil_moisture.regression import LIMITS, check_reference, fit_cells, match, retrieve
from services.retrieval.soil_moisture.skill import leave_days_out, skill, skill_report, train_reference
from shared.errors import DomainError
from tests.services.retrieval.texas import texas_pairs


def _pairs(
    days: int, cells: int, slope_sd: float, noise: float = 0.02, seed: int = 0
) -> tuple[pd.DataFrame, np.ndarray]:
    """Cell-days of a linear truth: slope 0.009 m3/m3 per dB, the cells' own slopes around it."""
    rng = np.random.default_rng(seed)
    slope = rng.normal(0.009, slope_sd, cells)
    cell = np.repeat(np.arange(cells), days)
    reflectivity = rng.normal(-20.0, 3.0, cell.size)
    mean = rng.uniform(0.15, 0.3, cells)
    moisture = mean[cell] + slope[cell] * (reflectivity + 20.0) + rng.normal(0.0, noise, cell.size)
    frame = pd.DataFrame({"row": cell // 10, "column": cell % 10, "day": np.tile(np.arange(days), cells)})
    return frame.assign(soil_moisture=moisture, reflectivity_db=reflectivity, count=3), slope


def test_equal_slopes_are_pooled_into_one() -> None:
    pairs, _ = _pairs(days=6, cells=80, slope_sd=0.0)
    fitted = fit_cells(pairs)
    assert fitted["slope"].to_numpy() == pytest.approx(0.009, abs=0.0025)
    assert fitted["slope"].std() < 5e-4
    assert fitted["sd"].median() == pytest.approx(0.02, rel=0.25)


def test_differing_slopes_are_drawn_only_part_of_the_way() -> None:
    """Pooled slopes lie nearer the truth than each cell's own least squares and than one slope for all."""
    pairs, truth = _pairs(days=6, cells=80, slope_sd=0.004)
    fitted = fit_cells(pairs).sort_values(["row", "column"])["slope"].to_numpy()
    own = np.array(
        [np.polyfit(c["reflectivity_db"], c["soil_moisture"], 1)[0] for _, c in pairs.groupby(["row", "column"])]
    )
    errors = [np.sqrt(np.mean((guess - truth) ** 2)) for guess in (fitted, own, np.full(80, truth.mean()))]
    assert errors[0] < errors[1] and errors[0] < errors[2]


def test_a_cell_of_one_day_takes_the_common_slope() -> None:
    pairs, _ = _pairs(days=6, cells=40, slope_sd=0.0)
    lone = pairs.iloc[[0]].assign(row=99, column=99)
    fitted = fit_cells(pd.concat([pairs, lone], ignore_index=True)).set_index(["row", "column"])
    assert fitted.loc[(99, 99), "slope"] == pytest.approx(fitted["slope"].median(), abs=1e-4)
    assert fitted.loc[(99, 99), "sd"] > fitted["sd"].median()


def test_interval_covers_nine_in_ten_days_held_out() -> None:
    pairs, _ = _pairs(days=10, cells=200, slope_sd=0.002)
    report = skill_report(pairs)
    assert 0.87 < report["regression"]["interval90_coverage"] < 0.93
    assert report["regression"]["ubrmse"] < 0.85 * report["cell_mean_baseline"]["ubrmse"]


def test_held_out_day_is_not_seen() -> None:
    """A wild value on the held-out day moves its own error only, not the estimate."""
    pairs, _ = _pairs(days=4, cells=30, slope_sd=0.0)
    wild = pairs.assign(soil_moisture=np.where(pairs["day"] == 3, 0.6, pairs["soil_moisture"]))
    keys = ["row", "column", "day"]
    tame, shaken = (leave_days_out(p).set_index(keys).xs(3, level="day")["estimate"] for p in (pairs, wild))
    pd.testing.assert_series_equal(tame, shaken)


def _looks(pairs: pd.DataFrame) -> pd.DataFrame:
    time = (np.datetime64("2024-03-01") + pairs["day"].to_numpy()).astype("datetime64[ms]") + np.timedelta64(7, "h")
    return pd.DataFrame(
        {
            "time": time,
            "row": pairs["row"],
            "column": pairs["column"],
            "reflectivity_db": pairs["reflectivity_db"],
            "incidence_deg": 30.0,
            "mode": "nominal",
        }
    )


def test_training_and_retrieval_return_the_moisture_that_went_in() -> None:
    pairs, _ = _pairs(days=12, cells=60, slope_sd=0.0, noise=0.004)
    looks = _looks(pairs)
    smap = pd.DataFrame(
        {"time": looks["time"] - np.timedelta64(2, "h"), "row": pairs["row"], "column": pairs["column"]}
    )
    smap["soil_moisture"] = pairs["soil_moisture"]
    reference = train_reference(looks, smap)
    table, counts = retrieve(looks, reference)
    merged = table.assign(
        day=(table["time"].to_numpy() - np.datetime64("2024-03-01")).astype("timedelta64[D]").astype(int)
    )
    merged = merged.merge(pairs, on=["row", "column", "day"], suffixes=("", "_true"))
    assert len(merged) == len(pairs) and counts["without_reference"] == 0
    assert np.sqrt(np.mean((merged["soil_moisture"] - merged["soil_moisture_true"]) ** 2)) < 0.006


def test_retrieval_is_monotone_in_reflectivity_bounded_and_counts_what_it_leaves_out() -> None:
    reference = pd.DataFrame(
        {"row": [1], "column": [1], "soil_moisture_mean": 0.2, "reflectivity_mean_db": -20.0, "slope": 0.01, "sd": 0.03}
    )
    reflectivity = np.array([-80.0, -22.0, -20.0, -18.0, 60.0])
    looks = pd.DataFrame({"time": np.datetime64("2024-03-01", "ms") + np.arange(5) * np.timedelta64(1, "D")})
    looks = looks.assign(row=1, column=1, reflectivity_db=reflectivity, incidence_deg=40.0, mode="nominal")
    elsewhere = looks.head(1).assign(row=7)
    table, counts = retrieve(pd.concat([looks, elsewhere]), reference)
    assert table["soil_moisture"].tolist() == pytest.approx([LIMITS[0], 0.18, 0.20, 0.22, LIMITS[1]])
    assert counts == {"looks": 6, "without_reference": 1, "clipped": 2}
    empty, _ = retrieve(elsewhere, reference)
    assert len(empty) == 0 and list(empty.columns) == list(table.columns)


def test_looks_of_a_day_are_averaged_and_the_incidence_taken_out() -> None:
    reference = pd.DataFrame({"row": [1], "column": [1], "soil_moisture_mean": 0.2, "reflectivity_mean_db": -20.0})
    reference = reference.assign(slope=0.01, sd=0.03, incidence_slope_db_per_deg=-0.1)
    looks = pd.DataFrame({"time": np.datetime64("2024-03-01", "ms") + np.arange(2) * np.timedelta64(1, "h")})
    looks = looks.assign(row=1, column=1, reflectivity_db=[-19.0, -22.0], incidence_deg=[20.0, 50.0], mode="nominal")
    table, _ = retrieve(looks, reference)  # both lie on -20 dB at 30 deg
    assert table["soil_moisture"].tolist() == pytest.approx([0.2])
    assert table["count"].tolist() == [2]
    assert table["time"].iloc[0] == looks["time"].iloc[1]


@pytest.mark.parametrize("column", ["slope", "reflectivity_mean_db"])
def test_reference_without_a_column_or_with_an_empty_one_is_named(column: str) -> None:
    full = pd.DataFrame({"row": [1], "column": [1], "soil_moisture_mean": 0.2, "reflectivity_mean_db": -20.0})
    full = full.assign(slope=0.01, sd=0.03)
    for broken in (full.drop(columns=column), full.assign(**{column: np.nan})):
        with pytest.raises(DomainError) as error:
            check_reference(broken)
        assert error.value.field == f"reference.{column}"


def test_training_without_common_days_or_columns_is_refused() -> None:
    pairs, _ = _pairs(days=3, cells=5, slope_sd=0.0)
    looks = _looks(pairs)
    smap = pd.DataFrame(
        {"time": looks["time"] + np.timedelta64(90, "D"), "row": looks["row"], "column": looks["column"]}
    )
    with pytest.raises(DomainError, match="cell-days"):
        train_reference(looks, smap.assign(soil_moisture=0.2))
    with pytest.raises(DomainError) as error:
        match(looks, smap)
    assert error.value.field == "soil_moisture.soil_moisture"


def test_skill_figures() -> None:
    truth = np.array([0.1, 0.2, 0.3, 0.4])
    found = skill(truth, truth + 0.05, np.full(4, 0.04))
    assert found["bias"] == pytest.approx(0.05)
    assert found["ubrmse"] == pytest.approx(0.0, abs=1e-12)
    assert found["r"] == pytest.approx(1.0)
    assert found["interval90_coverage"] == 1.0


def test_texas_pairs_are_the_matched_days(real_data: Path) -> None:
    """Matched cell-days of CYGNSS and SMAP; the cell mean is hard to beat there, and the report says by how much."""
    pairs = texas_pairs(real_data)
    assert len(pairs) > 400 and pairs["day"].nunique() >= 6
    assert pairs["soil_moisture"].between(0.02, 0.6).all()
    report = skill_report(pairs)
    assert report["regression"]["count"] == report["cell_mean_baseline"]["count"] > 300
    assert report["regression"]["ubrmse"] < 1.1 * report["cell_mean_baseline"]["ubrmse"]
