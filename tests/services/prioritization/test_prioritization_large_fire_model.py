"""The large-fire model: skill measures against independent ones, honesty by season, ratings that say what they lack."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xgboost as xgb
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import matthews_corrcoef, roc_auc_score

from services.prioritization import indices
from services.prioritization.large_fire import (
    evaluation,
    features,
    rating,
    reference_groups,
    skill,
    training,
    validation,
)
from services.prioritization.large_fire import model as large_fire_model
from shared.errors import DomainError


@pytest.fixture(scope="module")
def fires() -> pd.DataFrame:
    """2,400 made-up fires of eight seasons whose outcome follows log FFDI and drought; one season is much worse."""
    rng = np.random.default_rng(0)
    n = 2400
    table = pd.DataFrame(
        {
            "temperature_c": rng.normal(24, 7, n),
            "relative_humidity_pct": rng.uniform(5, 95, n),
            "wind_speed_m_s": rng.gamma(3, 1.5, n),
            "kbdi_mm": rng.uniform(0, 170, n),
            "season": np.repeat([f"20{y:02d}-{y + 1:02d}" for y in range(10, 18)], n // 8),
        }
    )
    table = features.derive(table)
    logit = -5.5 + 1.1 * np.log(table["ffdi_dry"]) + 0.008 * table["kbdi_mm"] + 0.8 * (table["season"] == "2011-12")
    return table.assign(large=(rng.random(n) < 1 / (1 + np.exp(-logit))).astype(int))


@pytest.fixture(scope="module")
def trained(fires) -> training.Trained:
    return training.train_and_test(fires, "large", "season", first_season="2014-15", resamples=20)


@pytest.fixture(scope="module")
def model(trained) -> large_fire_model.LargeFireModel:
    return trained.model


def test_skill_measures_agree_with_scikit_learn():
    rng = np.random.default_rng(3)
    y = rng.random(500) < 0.2
    s = np.round(rng.normal(0, 1, 500) + y, 1)  # with ties
    assert skill.auc(y, s) == pytest.approx(roc_auc_score(y, s))
    assert skill.mcc(y, s > 1) == pytest.approx(matthews_corrcoef(y, s > 1))
    thresholds = np.unique(s)
    best = max(matthews_corrcoef(y, s >= t) for t in thresholds)
    assert skill.mcc(y, s >= skill.best_threshold(y, s)) == pytest.approx(best)


def test_logistic_fit_agrees_with_scikit_learn():
    rng = np.random.default_rng(5)
    s = rng.normal(0, 1, 20000)
    y = rng.random(20000) < 1 / (1 + np.exp(-(1.5 * s - 2)))
    reference = LogisticRegression(C=1e9).fit(s[:, None], y)
    slope, intercept = skill.fit_logistic(y, s)
    assert slope == pytest.approx(reference.coef_[0, 0], abs=0.01)
    assert intercept == pytest.approx(reference.intercept_[0], abs=0.01)
    assert np.isfinite(skill.fit_logistic([0, 0, 1, 1], [-1, -0.5, 0.5, 1.0])).all()  # separable


def test_calibration_slope_finds_overconfidence():
    rng = np.random.default_rng(6)
    logit = rng.normal(-1, 1.5, 30000)
    y = rng.random(30000) < 1 / (1 + np.exp(-logit))
    assert skill.calibration_slope(y, 1 / (1 + np.exp(-logit))) == pytest.approx(1, abs=0.04)
    assert skill.calibration_slope(y, 1 / (1 + np.exp(-2 * logit))) == pytest.approx(0.5, abs=0.03)


def test_margins_of_a_season_do_not_depend_on_it_or_later_ones(fires):
    season = fires["season"].to_numpy()
    later = season >= "2015-16"

    def folds(table):
        return {f.name: f for f in validation.folds(validation.checked(table, "large", "season", "loop"), "loop")}

    before = folds(fires)
    after = folds(fires.assign(large=np.where(later, 1 - fires["large"], fires["large"])))
    for name in ("2013-14", "2014-15", "2015-16"):
        np.testing.assert_array_equal(before[name].margin, after[name].margin)
        np.testing.assert_array_equal(before[name].taught, after[name].taught)
    assert not np.array_equal(before["2016-17"].margin, after["2016-17"].margin, equal_nan=True)
    assert min(before) == "2013-14"
    for fold in before.values():
        assert not (fold.earlier & (season >= fold.name)).any()
        assert np.isnan(fold.taught[season >= fold.name]).all()


def test_a_region_left_out_teaches_nothing_about_itself(fires):
    region = np.array(["a", "b", "c"])[np.arange(len(fires)) % 3]
    table = fires.assign(region=region)

    def fold_c(frame):
        checked = validation.checked(frame, "large", "region", "loop", "leave-one-out")
        return validation.folds(checked, "loop", "leave-one-out")[2]

    before = fold_c(table)
    after = fold_c(table.assign(large=np.where(region == "c", 1 - table["large"], table["large"])))
    np.testing.assert_array_equal(before.margin, after.margin)
    np.testing.assert_array_equal(before.taught, after.taught)
    assert np.isfinite(before.taught[region != "c"]).all() and np.isnan(before.taught[region == "c"]).all()


def test_probabilities_are_calibrated_on_unseen_seasons(trained):
    result = trained.skill
    assert result["brier_skill"] > 0.03
    assert 0.7 < result["calibration_slope"] < 1.4
    assert result["auc"] > result["natural"]["kbdi_mm"]["auc"] + 0.05


def test_report_holds_every_metric_of_every_index_at_both_prevalences(trained):
    names = {"model", "trees", "logistic"} | {f.name for f in features.single_indices("loop")}
    for prevalence in ("natural", "one to two"):
        rows = trained.skill[prevalence]
        assert set(rows) == names
        for row in rows.values():
            for metric in ("mcc", "auc", "precision", "recall", "brier", "calibration_error"):
                low, high = row[f"{metric}_interval"]
                assert low <= high and np.isfinite(row[metric])
    counts = trained.skill["counts"]
    assert counts["truth"]["large"] == trained.skill["large_fires"]
    assert {sum(count.values()) for count in counts.values()} == {trained.skill["fires"]}


def test_one_to_two_counts_are_those_of_a_balanced_sample(trained):
    """Precision at 1:2 follows from recall and the false alarm rate alone; drawn samples scatter around it."""
    rng = np.random.default_rng(2)
    y = (rng.random(20000) < 0.05).astype(float)
    called = rng.random(20000) < np.where(y > 0, 0.6, 0.1)
    weight = np.where(y > 0, 1.0, evaluation.small_fire_weight(y, 1 / 3))
    assert (weight * y).sum() * 2 == pytest.approx((weight * (1 - y)).sum())
    small = np.flatnonzero(y == 0)
    drawn = [
        skill.mcc(y[i], called[i])
        for i in (np.append(np.flatnonzero(y), rng.choice(small, int(2 * y.sum()), replace=False)) for _ in range(30))
    ]
    assert skill.mcc(y, called, weight) == pytest.approx(np.mean(drawn), abs=0.01)


def test_expected_mcc_threshold_is_the_best_one_for_many_outcomes():
    rng = np.random.default_rng(8)
    p = 1 / (1 + np.exp(-rng.normal(-3, 1.5, 40000)))
    y = rng.random(40000) < p
    by_labels, expected = skill.best_threshold(y, p), skill.expected_mcc_threshold(p)
    assert skill.mcc(y, p >= expected) == pytest.approx(skill.mcc(y, p >= by_labels), abs=0.004)


def test_intervals_cover_how_seasons_differ():
    rng = np.random.default_rng(4)
    season = np.repeat(["a", "b", "c", "d"], 500)
    score = rng.normal(size=2000)
    y = (score + rng.normal(0, np.where(season == "a", 0.1, 5.0)) > 1).astype(float)
    draws = evaluation._resampled_weights(season, 0, 200)
    low, high = np.quantile([skill.auc(y, score, draw) for draw in draws], [0.05, 0.95])
    shuffled = evaluation._resampled_weights(rng.permutation(season), 0, 200)
    narrow = np.quantile([skill.auc(y, score, draw) for draw in shuffled], [0.05, 0.95])
    assert high - low > 2 * (narrow[1] - narrow[0])


def test_fires_without_weather_are_left_out_and_counted(fires):
    gappy = fires.assign(temperature_c=fires["temperature_c"].where(fires.index % 10 != 0))
    table = validation.checked(features.derive(gappy), "large", "season", "loop")
    assert table.without_weather == 240 and len(table.outcome) == 2160


def test_saved_model_rates_the_same(model, fires, tmp_path):
    model.save(tmp_path / "m.ubj")
    again = large_fire_model.load(tmp_path / "m.ubj")
    np.testing.assert_array_equal(model.margin(fires), again.margin(fires))
    assert again.calibration == model.calibration


def test_training_is_repeatable(fires, model, tmp_path):
    again = training.train_and_test(fires, "large", "season", first_season="2014-15", resamples=2)
    again.model.save(tmp_path / "a.ubj")
    model.save(tmp_path / "b.ubj")
    assert (tmp_path / "a.ubj").read_bytes() == (tmp_path / "b.ubj").read_bytes()


def test_contributions_add_up_to_the_margin(model, fires):
    margin, parts = model.margin(fires), model.contributions(fires)
    constant = margin - parts.sum(axis=1)
    np.testing.assert_allclose(constant, constant[0], atol=1e-4)


def test_more_wind_never_lowers_the_probability(model, fires):
    rows = fires.iloc[:200][list(features.PRIMITIVES)]
    margins = [model.margin(features.derive(rows.assign(wind_speed_m_s=w))) for w in (0.0, 2.0, 9.0, 20.0)]
    assert (np.diff(margins, axis=0) >= -1e-6).all()


def test_interval_holds_the_probability_and_widens_at_the_ends(model):
    p, low, high = model.calibration.probability(np.array([-4.0, -2.0, 1.0]))
    assert (low <= p).all() and (p <= high).all() and (high - low > 0).all()


def test_shipped_model_is_small_and_loads():
    path = large_fire_model.shipped_path()
    assert path.stat().st_size < 2**20
    shipped = large_fire_model.load(path)
    assert [f.name for f in shipped.features] == [f.name for f in features.features_of("loop")]
    assert shipped.calibration.base_rate == pytest.approx(0.0493, abs=1e-4)


@pytest.mark.parametrize("content", [b"not a model", b""])
def test_files_that_are_no_model_are_refused(tmp_path, content):
    (tmp_path / "m.ubj").write_bytes(content)
    with pytest.raises(DomainError) as caught:
        large_fire_model.load(tmp_path / "m.ubj")
    assert caught.value.field == "model"


def test_model_without_calibration_is_refused(tmp_path):
    booster = xgb.train({"max_depth": 1}, xgb.DMatrix(np.eye(4), np.array([0, 1, 0, 1])), 1)
    booster.save_model(tmp_path / "m.ubj")
    with pytest.raises(DomainError, match="calibration"):
        large_fire_model.load(tmp_path / "m.ubj")


def test_bad_tables_are_named(fires):
    for change, field in (
        ({"large": 2}, "label"),
        ({"season": "2010-11"}, "table"),
    ):
        with pytest.raises(DomainError) as caught:
            training.train_and_test(fires.assign(**change), "large", "season")
        assert caught.value.field == field
    with pytest.raises(DomainError) as caught:
        training.train_and_test(fires, "huge", "season")
    assert caught.value.field == "label"
    with pytest.raises(DomainError) as caught:
        features.derive(fires.drop(columns="kbdi_mm"))
    assert caught.value.field == "kbdi_mm"
    with pytest.raises(DomainError) as caught:
        training.train_and_test(fires, "large", "season", first_season="2031-32")
    assert caught.value.field == "first_test_season"
    with pytest.raises(DomainError) as caught:
        training.train_and_test(fires, "large", "season", "full")
    assert caught.value.field == "ffdi"


def test_percentile_is_among_fires_of_the_same_season_and_place(fires):
    rng = np.random.default_rng(0)
    frame = fires.assign(elevation_m=rng.uniform(0, 1500, len(fires)))
    margin = frame["kbdi_mm"].to_numpy() / 50
    groups = reference_groups.of_fires(frame, margin)
    dry, wet = groups.group(160.0, 900.0), groups.group(10.0, 900.0)
    assert (dry, wet) == ("dry upland", "wet upland")
    assert groups.group(np.nan, 900.0) == "all" and groups.group(160.0) == "dry"
    assert groups.percentile(2.0, wet) == 100 and groups.percentile(2.0, dry) == 0
    exact = 100 * (margin < 1.0).mean()
    assert groups.percentile(1.0, "all") == pytest.approx(exact, abs=1)
    few = reference_groups.of_fires(frame.iloc[:150], margin[:150])
    assert few.group(160.0, 900.0) == "all"


def _rated(make, time, series, model, kbdi=100.0):
    incidents = make["incidents"]().iloc[:1]
    conditions = rating.burning_conditions(
        incidents, lambda x, y: series, time, lambda x, y: kbdi, lambda x, y, t: float("nan"), model.calibration.median
    )
    return rating.rate(incidents, conditions, model, time).iloc[0]


def _series(time, wind=5.0, night_wind=None) -> pd.DataFrame:
    index = pd.date_range(time + pd.Timedelta(hours=1), periods=24, freq="h")
    frame = pd.DataFrame(
        {"temperature_c": 25.0, "relative_humidity_pct": 30.0, "wind_speed_m_s": wind, "rain_mm": 0.0}, index=index
    )
    if night_wind is not None:
        frame.iloc[14, 2] = night_wind
    return frame


def test_a_windy_hour_at_night_counts(make, time):
    model = large_fire_model.load(large_fire_model.shipped_path())
    calm = _rated(make, time, _series(time), model)
    windy = _rated(make, time, _series(time, night_wind=14.0), model)
    assert windy["wind_speed_m_s"] == 14.0 and windy["probability"] > calm["probability"]


def test_missing_hours_are_skipped_and_too_few_are_imputed(make, time):
    model = large_fire_model.load(large_fire_model.shipped_path())
    gappy = _series(time)
    gappy.iloc[::2, 0] = np.nan
    assert _rated(make, time, gappy, model)["imputed"] == ""
    gappy.iloc[:20, 0] = np.nan
    row = _rated(make, time, gappy, model)
    assert row["imputed"] == "temperature_c,relative_humidity_pct,wind_speed_m_s"
    assert row["probability"] > 0.01


def test_drought_is_carried_on_from_the_state_of_the_grid(time):
    hours = pd.date_range(time - pd.Timedelta(hours=71), time, freq="h")
    series = pd.DataFrame({"temperature_c": 30.0, "rain_mm": 0.0}, index=hours)
    expected, _ = indices.kbdi([0.0] * 3, [30.0] * 3, 400.0, 80.0)
    since = time - pd.Timedelta(days=3)
    assert rating.carried_drought(80.0, 400.0, series, since, time) == pytest.approx(float(expected.ravel()[-1]))
    series.iloc[30, 1] = 40.0
    assert rating.carried_drought(80.0, 400.0, series, since, time) < 60
    assert rating.carried_drought(80.0, 400.0, series.iloc[:10], since, time) == 80.0
    assert np.isnan(rating.carried_drought(np.nan, 400.0, series, since, time))


def test_weather_beyond_the_training_fires_is_flagged(make, time):
    model = large_fire_model.load(large_fire_model.shipped_path())
    row = _rated(make, time, _series(time, wind=35.0), model)
    assert row["out_of_domain"] and "wind_speed_m_s" in row["outside_training"]
    assert not _rated(make, time, _series(time), model)["out_of_domain"]


def test_model_with_land_columns_cannot_rate(make, time, model):
    from dataclasses import replace

    land = large_fire_model.LargeFireModel(model.booster, replace(model.calibration, schema="full"))
    with pytest.raises(DomainError) as caught:
        _rated(make, time, _series(time), land)
    assert caught.value.field == "model"


def test_rating_is_skilful_on_real_fires(real_data):
    table = features.from_victoria(
        pd.read_csv(real_data / "large_fire" / "victoria_2008_2018.csv.gz", low_memory=False)
    )
    fires = validation.checked(table, "uncontrolled_within_100_ha", "season", "full")
    folds = [fold for fold in validation.folds(fires, "full") if fold.name >= "2013-14"]
    result = evaluation.evaluate(fires, folds, "full", resamples=5)
    assert result["auc"] > 0.85
    assert result["mcc"] > 1.3 * result["natural"][result["best_index_by_mcc"]]["mcc"]
    assert result["brier_skill"] > 0.12
    assert 0.8 < result["calibration_slope"] < 1.2


def test_us_table_gives_one_early_day_a_fire(real_data):
    table = pd.read_csv(real_data / "large_fire" / "us_gridmet_ics209.csv")
    fires = features.from_us(table)
    assert len(fires) == 324 and fires["large_1000ac"].sum() == 45
    assert fires["ics_id"].is_unique and fires["days_from_ignition"].max() <= 3
    assert fires["temperature_c"].between(-20, 50).all()
    assert set(fires["region"]) == {*features.US_REGIONS, features.US_OTHER_REGION}
