"""Burned area: baseline and change, labels, calibration, and the shipped model on a world that it has not seen."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import fbeta_score, roc_auc_score

import services.retrieval
from services.retrieval.burned_area.labels import BURNED, UNBURNED, UNKNOWN, label_looks, labels_table
from services.retrieval.burned_area.model import (
    FEATURES,
    auc,
    best_threshold,
    confidence,
    feature_table,
    load_model,
    platt,
    train,
)
from services.retrieval.looks.baseline import CHANGE_FEATURES, build_baseline, change_features
from services.retrieval.looks.features import read_observations
from services.retrieval.processes import MODEL_PATH
from services.retrieval.simulation.observations import simulate_nominal, simulate_raw_if
from services.retrieval.simulation.training_world import make_images
from shared.errors import DomainError
from tests.services.retrieval import small_world

PACKAGE = Path(services.retrieval.__file__).parent


@dataclass(frozen=True)
class World:
    looks: pd.DataFrame
    baseline: pd.DataFrame
    burned: np.ndarray


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    """Pre-fire looks for the baseline, looks around and after the ignitions with labels; other tracks, days, noise."""
    folder = tmp_path_factory.mktemp("world")
    plan, surface = small_world.PLAN, small_world.surface()
    before = small_world.points(plan.first_ms, small_world.SPLIT_MS, 0)
    after = small_world.points(small_world.SPLIT_MS, plan.end_ms, 1)
    simulate_nominal(before, surface, 501).write(folder / "before.nc", {})
    simulate_nominal(after, surface, 502).write(folder / "after.nc", {})
    simulate_raw_if(after, make_images(after, 0.05, 1), surface, 503).write(folder / "raw.nc", {})
    looks = read_observations([folder / "after.nc", folder / "raw.nc"]).looks
    latitude, longitude = np.meshgrid(surface.burn_latitude_deg, surface.burn_longitude_deg, indexing="ij")
    label = label_looks(looks, labels_table(latitude, longitude, surface.burn_time))
    known = label != UNKNOWN
    baseline = build_baseline(read_observations([folder / "before.nc"]).looks)
    return World(looks[known].reset_index(drop=True), baseline, label[known] == BURNED)


def test_shipped_model_beats_chance_and_the_single_look_on_an_unseen_world(world: World) -> None:
    model = load_model(MODEL_PATH)
    with_change = auc(model.probability(feature_table(world.looks, world.baseline)), world.burned)
    without = auc(model.probability(feature_table(world.looks, None)), world.burned)
    assert world.burned.sum() > 50
    assert with_change > 0.6
    assert with_change > without + 0.05


def test_shipped_model_is_small_and_its_card_says_simulated() -> None:
    assert MODEL_PATH.stat().st_size < 2**20
    card = MODEL_PATH.with_suffix(".md").read_text()
    assert "simulated delay-Doppler maps only" in card and "best single feature" in card


def test_shipped_probabilities_are_calibrated_on_an_unseen_world(world: World) -> None:
    """Mean probability against burned share, over the looks called likely and over the rest."""
    probability = load_model(MODEL_PATH).probability(feature_table(world.looks, world.baseline))
    likely = probability > 0.2
    assert probability[likely].mean() == pytest.approx(world.burned[likely].mean(), abs=0.25)
    assert probability[~likely].mean() == pytest.approx(world.burned[~likely].mean(), abs=0.04)


def test_training_gives_the_same_bytes_and_survives_the_file(world: World, tmp_path: Path) -> None:
    table = feature_table(world.looks, world.baseline)
    held = np.arange(len(table)) % 3 == 0
    for name in ("a.ubj", "b.ubj"):
        model = train(table, world.burned, held, rounds=20)
        model.save(tmp_path / name)
    assert (tmp_path / "a.ubj").read_bytes() == (tmp_path / "b.ubj").read_bytes()
    read = load_model(tmp_path / "a.ubj")
    assert read.features == FEATURES and read.threshold == model.threshold
    assert np.array_equal(read.probability(table), model.probability(table))


def test_training_without_both_classes_is_refused(world: World) -> None:
    table = feature_table(world.looks, None)
    held = np.arange(len(table)) % 3 == 0
    with pytest.raises(DomainError) as error:
        train(table, np.zeros(len(table), dtype=bool), held)
    assert error.value.field == "labels"


@pytest.mark.parametrize(
    "content",
    [b"", b"{}", b"not a model" * 9, MODEL_PATH.read_bytes()[:-200], MODEL_PATH.read_bytes() + b"x"],
    ids=["nothing", "empty", "text", "truncated", "longer"],
)
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.ubj"
    path.write_bytes(content)
    with pytest.raises(DomainError) as error:
        load_model(path)
    assert error.value.field == "model"


def test_auc_is_scikit_learns() -> None:
    rng = np.random.default_rng(0)
    burned = rng.random(500) < 0.2
    score = np.round(rng.normal(burned * 0.8, 1.0), 1)  # with ties
    assert auc(score, burned) == pytest.approx(roc_auc_score(burned, score))
    assert np.isnan(auc(score, np.zeros(500, dtype=bool)))


def test_platt_is_logistic_regression() -> None:
    rng = np.random.default_rng(1)
    margin = rng.normal(-1.0, 1.5, 20_000)
    burned = rng.random(20_000) < 1 / (1 + np.exp(-(0.7 * margin - 0.4)))
    other = LogisticRegression(C=1e9).fit(margin[:, None], burned)
    slope, intercept = platt(margin, burned)
    assert (slope, intercept) == pytest.approx((other.coef_[0, 0], other.intercept_[0]), abs=2e-3)


def test_threshold_gives_the_best_f_score_and_confidence_counts_from_it() -> None:
    rng = np.random.default_rng(3)
    burned = rng.random(2000) < 0.2
    probability = np.clip(rng.normal(0.2 + 0.25 * burned, 0.12), 0.0, 1.0)
    for beta in (0.5, 1.0):
        threshold = best_threshold(probability, burned, beta)
        best = max(fbeta_score(burned, probability >= step, beta=beta) for step in np.arange(5, 96) / 100.0)
        assert fbeta_score(burned, probability >= threshold, beta=beta) == pytest.approx(best)
    found = confidence(np.array([0.0, threshold / 2, threshold, 1.0]), threshold)
    assert found == pytest.approx([100.0, 50.0, 0.0, 100.0])


def _one_cell(reflectivity: np.ndarray, latitude: float = 38.0) -> pd.DataFrame:
    from services.retrieval.ease_grid import row_column

    count = reflectivity.size
    position = np.full(count, latitude), np.full(count, -110.0)
    row, column = row_column(*position, 9)
    time = np.datetime64("2024-05-01", "ms") + np.arange(count) * np.timedelta64(20, "h")
    return pd.DataFrame(
        {
            "time": time,
            "latitude_deg": position[0],
            "longitude_deg": position[1],
            "row": row,
            "column": column,
            "reflectivity_db": reflectivity,
            "incidence_deg": 30.0,
            "coherence": 2.0,
            "mode": "nominal",
        }
    )


def test_baseline_holds_the_places_mean_sd_and_count() -> None:
    values = np.random.default_rng(0).normal(-20.0, 2.0, 400)
    table = build_baseline(_one_cell(values)).set_index("resolution_km")
    assert table.loc[9, "count"] == 400
    assert table.loc[9, "reflectivity_mean_db"] == pytest.approx(values.mean())
    assert table.loc[9, "reflectivity_sd_db"] == pytest.approx(values.std(ddof=1), rel=0.01)
    assert table.loc[3, "reflectivity_mean_db"] == pytest.approx(values.mean())


def test_change_is_against_the_place_and_local_change_takes_out_the_weather() -> None:
    """Rain lifts all cells by 3 dB; one of them has burned and lies 4 dB higher still."""
    rng = np.random.default_rng(0)
    before = pd.concat([_one_cell(rng.normal(-20.0 - k, 0.1, 30), 38.0 + 0.1 * k) for k in range(5)], ignore_index=True)
    lift = np.array([3.0, 3.0, 7.0, 3.0, 3.0])
    day = np.datetime64("2024-06-20T12:00", "ms")
    after = pd.concat([_one_cell(np.array([-20.0 - k + lift[k]]), 38.0 + 0.1 * k) for k in range(5)], ignore_index=True)
    found = change_features(after.assign(time=day), build_baseline(before))
    assert found["change_db"].to_numpy() == pytest.approx(lift, abs=0.1)
    assert found["change_local_db"].to_numpy() == pytest.approx(lift - 3.0, abs=0.15)
    assert found["change_near_db"].idxmax() == 2


def test_a_place_without_baseline_has_no_change() -> None:
    baseline = build_baseline(_one_cell(np.full(10, -20.0)))
    found = change_features(_one_cell(np.array([-18.0]), latitude=-30.0), baseline)
    assert found[list(CHANGE_FEATURES)].drop(columns="change_near_weight").isna().all(axis=None)
    assert change_features(_one_cell(np.array([-18.0])), None).isna().all(axis=None)


def test_incomplete_baseline_is_named() -> None:
    baseline = build_baseline(_one_cell(np.full(10, -20.0))).drop(columns="reflectivity_sd_db")
    with pytest.raises(DomainError) as error:
        change_features(_one_cell(np.array([-18.0])), baseline)
    assert error.value.field == "baseline.reflectivity_sd_db"


def test_labels_follow_place_and_time() -> None:
    looks = _one_cell(np.full(3, -20.0))
    looks["time"] = pd.to_datetime(["2024-05-01", "2024-05-03", "2024-05-03"]).astype("datetime64[ms]")
    looks.loc[2, "latitude_deg"] += 1.0
    place = pd.DataFrame({"longitude_deg": [-110.0], "latitude_deg": [38.005], "burn_time": ["2024-05-02"]})
    assert label_looks(looks, place).tolist() == [UNBURNED, BURNED, UNKNOWN]
    with pytest.raises(DomainError) as error:
        label_looks(looks, place.drop(columns="burn_time"))
    assert error.value.field == "labels.burn_time"


def test_retrieval_takes_nothing_from_the_simulator() -> None:
    """Only the process that simulates and the maker of the shipped model import the simulator."""
    allowed = {"processes.py", "shipped_model.py"}
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name in allowed or path.parent.name == "simulation":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any("simulation" in name for name in names), path.name


def test_simulator_takes_only_constants_formats_and_file_layout_from_the_retrieval() -> None:
    allowed = ("constants", "ancillary.burn_grid", "level1.writer", "simulation")
    for path in sorted((PACKAGE / "simulation").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("services.retrieval."):
                name = (node.module or "").removeprefix("services.retrieval.")
                assert name.startswith(allowed), (path.name, node.module)
