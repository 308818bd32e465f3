"""Conformal quantiles grouped by site: coverage at new sites, monotone estimates, files that are not believed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from services.retrieval.soil_moisture import boosted_normal, raw_if_training
from services.retrieval.soil_moisture.boosted_normal import fit_boosted_normal
from services.retrieval.soil_moisture.conformal import grouped_quantile, independent_scores, site_folds
from services.retrieval.soil_moisture.quantiles import FEATURES, RawIfModel, load_raw_if, train_raw_if
from shared.errors import DomainError


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """NGBoost takes its time; what is tested does not hang on the number of its rounds."""
    monkeypatch.setattr(boosted_normal, "ROUNDS", 40)
    monkeypatch.setattr(boosted_normal, "LEARNING_RATE", 0.15)


def _table(sites: int, per_site: int, seed: int) -> tuple[pd.DataFrame, np.ndarray]:
    """Cell-days whose departure from the regression follows the anomaly, with an error of the site and of the look."""
    rng = np.random.default_rng(seed)
    site = np.repeat(np.arange(sites), per_site)
    table = pd.DataFrame(rng.standard_normal((site.size, len(FEATURES))), columns=list(FEATURES))
    table["anomaly_db"] = 3.0 * rng.standard_normal(site.size)
    table["estimate"] = rng.uniform(0.1, 0.3, site.size)
    error = 0.02 * rng.standard_normal(sites)[site] + 0.02 * rng.standard_normal(site.size)
    return table.assign(soil_moisture=table["estimate"] + 0.01 * table["anomaly_db"] + error), site


@pytest.mark.parametrize("method", ["cqr", "ngboost"])
def test_interval_covers_nine_in_ten_at_sites_never_seen(method: str) -> None:
    table, site = _table(60, 25, 0)
    new, _ = _table(200, 25, 1)
    low, middle, high = train_raw_if(table, site, method).interval(new).T
    inside = np.mean((new["soil_moisture"] >= low) & (new["soil_moisture"] <= high))
    assert 0.87 < inside < 0.95
    assert ((low <= middle) & (middle <= high)).all()
    assert np.std(middle - new["soil_moisture"]) < 0.9 * np.std(new["estimate"] - new["soil_moisture"])


def test_estimate_rises_with_reflectivity() -> None:
    table, site = _table(30, 20, 2)
    model = train_raw_if(table, site)
    rise = np.linspace(-10.0, 10.0, 41)
    one = pd.concat([table.iloc[[3]]] * 41, ignore_index=True)
    moved = {name: one[name] + rise for name in ("anomaly_db", "reflectivity_db", "snr_db")}
    one = one.assign(**moved, estimate=one["estimate"] + 0.002 * rise)
    assert (np.diff(model.interval(one), axis=0) >= -1e-7).all()
    assert model.interval(one)[-1, 1] > model.interval(one)[0, 1] + 0.02


def test_grouped_quantile_weighs_groups_alike() -> None:
    """Nineteen small groups of score 0 and one huge group of score 1: a twentieth of the groups, whatever its size."""
    score = np.concatenate([np.zeros(19), np.ones(10_000)])
    group = np.concatenate([np.arange(19), np.full(10_000, 19)])
    assert grouped_quantile(score, group, 0.90) == 0.0
    assert grouped_quantile(score, group, 0.95) == 1.0
    alone = np.random.default_rng(0).random(99)
    assert grouped_quantile(alone, np.arange(99)) == np.sort(alone)[89]  # ceil(0.9 x 100) of 99: split conformal
    assert grouped_quantile(np.array([1.0, 2.0]), np.array([0, 1])) == 2.0


@pytest.mark.parametrize(("groups", "alike"), [(12, 0.0), (12, 0.5), (25, 0.0), (25, 0.9), (60, 0.3)])
def test_few_sites_neither_fall_short_nor_overshoot(groups: int, alike: float) -> None:
    """Coverage at new sites over repeated draws, whatever the sites have in common and however few they are."""
    rng = np.random.default_rng(groups)

    def draw(index: np.ndarray) -> np.ndarray:
        site = rng.standard_normal(index.max() + 1)[index]
        return np.abs(np.sqrt(alike) * site + np.sqrt(1.0 - alike) * rng.standard_normal(index.size))

    found = []
    for _ in range(150):
        index = np.repeat(np.arange(groups), rng.integers(3, 25, groups))
        found.append(np.mean(draw(np.repeat(np.arange(200), 10)) <= grouped_quantile(draw(index), index)))
    assert 0.89 < np.mean(found) < 0.925


def test_independent_scores_lie_between_groups_and_looks() -> None:
    rng = np.random.default_rng(2)
    index = np.repeat(np.arange(40), 10)
    assert independent_scores(rng.standard_normal(40)[index], index) == pytest.approx(40, rel=0.02)
    assert independent_scores(rng.standard_normal(400), index) > 300
    assert independent_scores(rng.standard_normal(7), np.arange(7)) == 7


def test_a_model_is_judged_at_sites_it_has_not_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each site's later days by a model of other sites' earlier days; skill beside regression and cell mean."""
    both = []
    for seed in (0, 1):
        table, site = _table(40, 12, seed)
        table = table.assign(row=6 * (site // 8), column=6 * (site % 8), day=seed, soil_moisture_mean=0.2)
        both.append(table)
    seen: list[set[int]] = []

    def watched(table: pd.DataFrame, site: np.ndarray, method: str) -> RawIfModel:
        seen.append(set(site))
        return train_raw_if(table, site, method)

    monkeypatch.setattr(raw_if_training, "train_raw_if", watched)
    found = raw_if_training.judged_elsewhere(*both, "cqr", 9)
    assert len(seen) == raw_if_training.OUTER_FOLDS
    held = [set(raw_if_training.sites(both[1])) - one for one in seen]
    assert sum(map(len, held)) == 40 and len(set.union(*held)) == 40
    assert found["model"]["count"] == found["regression"]["count"] == len(both[1])
    assert found["model"]["ubrmse"] < found["regression"]["ubrmse"]
    assert 0.85 < found["model"]["interval90_coverage"] < 0.98


def test_sites_stay_together_in_folds() -> None:
    site = np.random.default_rng(0).integers(0, 23, 400)
    fold = site_folds(site, 5)
    assert all(np.unique(fold[site == one]).size == 1 for one in range(23)) and set(fold) == set(range(5))


def test_boosted_normal_in_arrays_equals_ngboost() -> None:
    from ngboost import NGBRegressor
    from sklearn.tree import DecisionTreeRegressor

    rng = np.random.default_rng(5)
    values = rng.standard_normal((400, 4))
    target = values[:, 0] + np.exp(0.4 * values[:, 1]) * rng.standard_normal(400)
    base = DecisionTreeRegressor(
        criterion="squared_error", max_depth=boosted_normal.DEPTH, min_samples_leaf=20, random_state=3
    )
    theirs = NGBRegressor(
        Base=base,
        n_estimators=boosted_normal.ROUNDS,
        learning_rate=boosted_normal.LEARNING_RATE,
        random_state=3,
        verbose=False,
    ).fit(values, target)
    mean, sd = fit_boosted_normal(values, target, 3).mean_sd(values)
    expected = theirs.pred_dist(values)
    assert mean == pytest.approx(expected.loc, abs=1e-9)
    assert sd == pytest.approx(expected.scale, rel=1e-9)


@pytest.mark.parametrize("method", ["cqr", "ngboost"])
def test_a_model_comes_back_from_its_file(tmp_path: Path, method: str) -> None:
    table, site = _table(20, 10, 6)
    model = train_raw_if(table, site, method)
    model.save(tmp_path / "one", {"simulated": True})
    train_raw_if(table, site, method).save(tmp_path / "two", {"simulated": True})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    assert b"simulated" in (tmp_path / "one").read_bytes()
    again = load_raw_if(tmp_path / "one")
    assert again.method == method
    assert again.interval(table) == pytest.approx(model.interval(table), abs=1e-12)


def test_what_is_no_model_is_named(tmp_path: Path) -> None:
    table, site = _table(20, 10, 6)
    train_raw_if(table, site, "cqr").save(tmp_path / "whole.ubj", {})
    train_raw_if(table, site, "ngboost").save(tmp_path / "whole.json", {})
    document = json.loads((tmp_path / "whole.json").read_text())
    document["trees"]["left"][0][0] = 10_000
    broken = {
        "cut.ubj": (tmp_path / "whole.ubj").read_bytes()[:-40],
        "noise": bytes(range(256)),
        "empty": b"",
        "pointer.json": json.dumps(document).encode(),
        "other.json": b'{"a": 1}',
    }
    for name, content in broken.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DomainError) as error:
            load_raw_if(tmp_path / name)
        assert error.value.field == "raw_if_model"


def test_too_few_looks_or_sites_are_refused() -> None:
    table, site = _table(20, 10, 7)
    for few in (table["estimate"].index < 90, site < 5):
        with pytest.raises(DomainError) as error:
            train_raw_if(table[few].reset_index(drop=True), site[few])
        assert error.value.field == "observations"
