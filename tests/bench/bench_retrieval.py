"""Benchmark of the retrieval service: one JSON object a line, {"name", "value", "unit", "bar"}.

Burned-area figures are of simulated worlds that the shipped model has not seen (seeds, places and days of their own):
``burned_auc_nominal`` and ``burned_auc_raw_if`` by what a map alone tells (no baseline), ``burned_auc_change`` with the
change against the place's own past, both modes. ``burned_recall_nominal`` and ``burned_recall_joint``: recall over the
looks of both modes, at 5 % false alarms, by a model trained on nominal looks only and by one trained on both;
``texture_gain_*``: relative gain in that recall by texture, within a mode (tests/bench/retrieval/burned_claims.py;
``--long`` adds the second case, a day of level-1 and a second of raw-IF). Soil moisture over Texas is real CYGNSS
against SMAP: days, blocks, seasons held out, beside the cell mean; it needs SMOKEGLINT_DATA and is left out
without.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OMP_NUM_THREADS", "2")

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from services.retrieval.burned_area.model import FEATURES, auc, load_model, train
from services.retrieval.burned_area.shipped_model import world_examples
from services.retrieval.looks.texture import quantise, texture
from services.retrieval.processes import MODEL_PATH
from services.retrieval.simulation.observations import simulate_nominal
from services.retrieval.simulation.training_world import DAY_MS, WorldPlan, make_specular_points, make_surface
from tests.bench.retrieval import burned_claims, soil_moisture_trial, throughput

WORLDS = [WorldPlan(7001 + n, 31.0 + 5 * n, -105.0 - 4 * n, first_day="2024-02-10") for n in range(2)]


def emit(name: str, value: float | None, unit: str, bar: float | None) -> None:
    print(json.dumps({"name": name, "value": value, "unit": unit, "bar": bar}), flush=True)


def best_of(runs: int, work: Callable[[], Any]) -> float:
    """The shortest of several timings, s."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def measure_maps() -> None:
    """Simulation from specular points to maps (surface look-up, scattering, noise; no file), texture of those maps."""
    plan = WorldPlan(7100, 38.0, -110.0)
    surface = make_surface(plan)
    points = make_specular_points(plan, plan.first_ms, plan.first_ms + 15 * DAY_MS, 0)
    made = simulate_nominal(points, surface, 1)
    seconds = best_of(3, lambda: simulate_nominal(points, surface, 1))
    emit("simulate_maps_per_s", round(len(made.maps) / seconds), "1/s", 10_000)
    texture(quantise(made.maps[:10]))
    seconds = best_of(3, lambda: texture(quantise(made.maps)))
    emit("texture_maps_per_s", round(len(made.maps) / seconds), "1/s", 100_000)


def measure_model() -> None:
    """Training on 200,000 looks x 30 with the shipped settings, prediction of 100, size on disk."""
    rng = np.random.default_rng(0)
    names = (*FEATURES, "height_m", "slope_deg")  # thirty
    table = pd.DataFrame(rng.standard_normal((200_000, len(names))).astype(np.float32), columns=list(names))
    burned = rng.random(len(table)) < 1 / (1 + np.exp(3.0 - table["change_near_db"] - 0.5 * table["coherence"] ** 2))
    held = np.arange(len(table)) % 10 == 0
    start = time.perf_counter()
    train(table, burned.to_numpy(), held, names)
    emit("train_200k_s", round(time.perf_counter() - start, 2), "s", 30)
    model, hundred = load_model(MODEL_PATH), table.head(100)
    emit("predict_100_ms", round(1e3 * best_of(20, lambda: model.probability(hundred)), 2), "ms", 20)
    emit("model_mib", round(MODEL_PATH.stat().st_size / 2**20, 3), "MiB", 1)


def measure_burned() -> None:
    """The shipped model on worlds of the benchmark's own."""
    with tempfile.TemporaryDirectory() as folder:
        worlds = [world_examples(plan, Path(folder)) for plan in WORLDS]
    table = pd.concat([world.table for world in worlds], ignore_index=True)
    burned = np.concatenate([world.burned for world in worlds])
    raw_if = np.concatenate([world.raw_if for world in worlds])
    model = load_model(MODEL_PATH)
    alone = table.copy()
    alone[[name for name in FEATURES if "change" in name or name.startswith("baseline")]] = np.nan
    single = model.probability(alone)
    emit("burned_auc_nominal", round(auc(single[~raw_if], burned[~raw_if]), 4), "1", None)
    emit("burned_auc_raw_if", round(auc(single[raw_if], burned[raw_if]), 4), "1", None)
    emit("burned_auc_change", round(auc(model.probability(table), burned), 4), "1", None)


def measure_claims() -> None:
    """The paper's claims on worlds of the benchmark's own."""
    for name, value in burned_claims.headline().items():
        emit(name, round(value, 4) if np.isfinite(value) else None, "1", None)


def measure_long() -> None:
    """Both cases with the ablation, a day of level-1, a second of raw-IF."""
    for case, found in burned_claims.measure().items():
        for name, score in found.items():
            label = name.replace(", ", "_").replace(" ", "_")
            emit(f"burned_auc_{case}_{label}", round(score.auc, 4), "1", None)
            emit(f"burned_recall_{case}_{label}", round(score.recall, 4), "1", None)
    seconds, mebibytes = throughput.day_of_level1()
    emit("level1_day_s", round(seconds, 1), "s", None)
    emit("level1_day_peak_mib", round(mebibytes), "MiB", None)
    seconds, error_chips = throughput.second_of_raw_if()
    emit("raw_if_second_s", round(seconds, 2), "s", None)
    emit("raw_if_code_phase_error_chips", round(error_chips, 4), "chip", None)


def measure_soil_moisture() -> None:
    """Held out on simulation at 9 km (a world and both modes), and on real looks over Texas at 36 km."""
    reports = soil_moisture_trial.simulated()
    ways = {"": "leave_a_day_out", "_block_out": "leave_a_block_out", "_forward": "forward_in_time"}
    for suffix, way in ways.items():
        coverage = soil_moisture_trial.mean_coverage(reports, "nominal", way, "regression")
        emit(f"sm_interval90_coverage{suffix}", round(coverage, 3), "1", 0.9)
    path = "raw_if", "held_out_places_and_dates", "model"
    emit("sm_interval90_coverage_raw_if", round(soil_moisture_trial.mean_coverage(reports, *path), 3), "1", 0.9)
    folder = os.environ.get("SMOKEGLINT_DATA")
    if folder:
        for name, value, unit, bar in soil_moisture_trial.texas_figures(Path(folder)):
            emit(name, round(value, 4), unit, bar)


if __name__ == "__main__":
    measure_maps()
    measure_model()
    measure_burned()
    measure_claims()
    measure_soil_moisture()
    if "--long" in sys.argv:
        measure_long()
