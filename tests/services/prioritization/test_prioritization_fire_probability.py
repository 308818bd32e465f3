"""WFSP and WLFP: the refit finds a known truth, repeats the shipped coefficients and is as reliable as its forecast."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from services.prioritization.prefire import fire_history, fire_probability, fire_probability_fit, fire_probability_skill
from shared.errors import ContractError, DomainError

WFPI = np.linspace(0, 247, 60)


@pytest.fixture(scope="module")
def history():
    fires, voxels = fire_history.simulate()
    return fire_probability_fit.checked_fires(fires), fire_probability_fit.checked_voxels(voxels)


@pytest.fixture(scope="module")
def refit(history):
    return fire_probability_fit.fit(*history, fire_history.SOURCE, demonstration=True)


@pytest.fixture(scope="module")
def fitted(refit):
    return refit.model


def test_the_refit_repeats_the_shipped_demonstration(fitted):
    shipped = fire_probability.shipped()
    assert shipped.demonstration and shipped.trained_on == fire_history.SOURCE
    for ours, theirs in ((fitted.spread, shipped.spread), (fitted.ignition, shipped.ignition)):
        coefficients = [fire_probability_fit.coefficients_of(part) for part in (ours, theirs)]
        np.testing.assert_allclose(*coefficients, atol=1e-3)


def test_the_refit_finds_the_truth(fitted):
    for longitude in (-118.0, -95.0, -82.0):
        for day in (30.0, 210.0):
            wfpi, place = np.array([30.0, 60.0, 90.0, 120.0]), (np.array(longitude), np.array(36.0))
            spread, ignitions = fire_history.truth(np.full(4, longitude), np.full(4, 36.0), np.full(4, day), wfpi)
            wfsp, wlfp = fitted.at(*place).rates(wfpi, day)
            expected = fire_probability.sigmoid(spread)
            np.testing.assert_allclose(wfsp, 100 * expected, rtol=0.35)
            np.testing.assert_allclose(wlfp, 1e6 * ignitions * expected, rtol=0.45)


def test_forecasts_span_the_published_bins_and_never_fall_with_wfpi():
    model = fire_probability.shipped()
    at = model.at(np.array(-110.0), np.array(36.0))
    wfsp, wlfp = at.rates(WFPI, 200.0)
    assert wfsp[0] < 0.5 and wfsp[-1] > 30 and wlfp[0] < 0.1 and wlfp[-1] > 7
    for longitude in (-122.0, -100.0, -75.0, 30.0):
        wfsp, wlfp = model.at(np.array(longitude), np.array(40.0)).rates(WFPI, 100.0)
        assert (np.diff(wfsp) >= 0).all() and (np.diff(wlfp) >= 0).all()
    assert np.isnan(at.rates(np.array([np.nan]), 200.0)[0]).all()


def test_south_has_its_seasons_half_a_year_later_and_foreign_places_the_average():
    spread = fire_probability.shipped().spread
    north, south = spread.yearly(np.array([40.0, -40.0]), 210.0)
    np.testing.assert_allclose(south, spread.yearly(np.array(40.0), 210.0 + 365.25 / 2))
    assert north > south
    assert spread.place(np.array(146.0), np.array(-37.0)) == 0


def test_left_out_years_are_as_reliable_as_their_forecast(refit, history):
    tables = [table[table["time"].dt.year < 2008] for table in history]
    report = fire_probability_skill.against_usgs(refit, *tables)
    for name in ("wfsp", "wlfp"):
        rows = report["reliability"][name]
        assert len(rows) == 8 and report["summary"][name]["bins_held"] >= 6  # 90 % intervals: one in ten may miss
        assert [row["usgs_observed"] for row in rows] == sorted(row["usgs_observed"] for row in rows)
        for row in rows:
            assert row["from"] <= row["forecast"] <= row["to"]


def test_reliability_counts_by_hand():
    predicted, observed = np.array([0.001, 0.002, 0.3, 0.35, 0.4]), np.array([0.0, 1.0, 1.0, 0.0, 1.0])
    rows = fire_probability_skill.reliability(predicted, observed, np.ones(5), fire_probability_skill.WFSP_BINS, 100.0)
    assert [row["rows"] for row in rows] == [2, 0, 0, 0, 0, 0, 0, 3]
    assert rows[0]["forecast"] == pytest.approx(0.15) and rows[0]["observed"] == pytest.approx(50)
    assert rows[-1]["forecast"] == pytest.approx(35) and rows[-1]["observed"] == pytest.approx(200 / 3)


def test_sampling_rate_corrects_the_intercept():
    rng = np.random.default_rng(5)
    count = 60_000
    table = pd.DataFrame({"longitude_deg": rng.uniform(-120, -80, count), "latitude_deg": rng.uniform(30, 45, count)})
    table["time"] = pd.Timestamp("2015-06-01", tz="UTC") + pd.to_timedelta(rng.integers(0, 365, count), unit="D")
    table = table.assign(wfpi=rng.uniform(0, 150, count), ignition=(rng.uniform(size=count) < 0.05).astype(int))
    kept = table[(table["ignition"] == 1) | (rng.uniform(size=count) < 0.1)]
    kept = kept.assign(sampling_rate=np.where(kept["ignition"] == 1, 1.0, 0.1))
    model, _ = fire_probability_fit.fit_logit(kept, "ignition", fire_probability_fit.box_of(kept), (30.0,))
    matrix = fire_probability_fit.design(table, fire_probability_fit.box_of(kept))
    predicted = fire_probability.sigmoid(matrix @ fire_probability_fit.coefficients_of(model))
    assert predicted.mean() == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize(
    ("column", "value", "field"),
    [
        ("wfpi", 4000.0, "wfpi"),
        ("latitude_deg", np.nan, "latitude_deg"),
        ("large", 3, "large"),
        ("time", "never", "time"),
    ],
)
def test_impossible_rows_are_named(history, column, value, field):
    table = history[0].head(50).copy()
    table[column] = table[column].astype(object)
    table.loc[7, column] = value
    with pytest.raises(DomainError, match="Row 7") as caught:
        fire_probability_fit.checked_fires(table)
    assert caught.value.field == field


def test_too_few_events_missing_columns_and_mixed_rates_are_named(history):
    fires, voxels = history
    with pytest.raises(DomainError, match="too few"):
        fire_probability_fit.fit_logit(
            fires[fires["large"] == 0].head(500), "large", fire_probability_fit.box_of(fires)
        )
    with pytest.raises(DomainError) as caught:
        fire_probability_fit.checked_voxels(voxels.drop(columns="sampling_rate"))
    assert caught.value.value == "sampling_rate"
    mixed = voxels.assign(sampling_rate=np.where(voxels.index % 2 == 0, 0.1, voxels["sampling_rate"]))
    with pytest.raises(DomainError) as caught:
        fire_probability_fit.checked_voxels(mixed)
    assert caught.value.field == "sampling_rate"


def test_area_gives_large_by_500_acres(history):
    table = history[0].head(4).drop(columns="large").assign(area_km2=[2.0, 2.03, 0.1, 50.0])
    assert fire_probability_fit.checked_fires(table)["large"].tolist() == [0, 1, 0, 1]


def test_the_model_survives_json_and_other_documents_are_refused(fitted):
    again = fire_probability.from_document(json.loads(json.dumps(fire_probability.to_document(fitted))))
    assert again == fitted
    with pytest.raises(ContractError) as caught:
        fire_probability.from_document({"kind": "something else"})
    assert caught.value.field == "probability_model"
