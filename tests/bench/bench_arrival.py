"""Fire arrival time: `python -m tests.bench.bench_arrival` prints one JSON object a line.

Synthetic fires of the bench seeds, the plain baseline and the paper's network beside the default method; with
SMOKEGLINT_DATA two real fires against airborne-infrared perimeters.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from services.arrival.extent import gather
from services.arrival.field import FieldSettings, fit_field
from services.arrival.fires import map_case
from services.arrival.inference import ArrivalMap
from services.arrival.paper_method import PaperSettings
from tests.bench.arrival.front24 import front24
from tests.bench.arrival.network_export import network_export
from tests.services.arrival.airborne import FIRES as AIRBORNE
from tests.services.arrival.airborne import sorensen_against_perimeter
from tests.services.arrival.scored import Score, case_of, run
from tests.services.arrival.seeds import BENCH
from tests.services.arrival.synthetic_fires import make_fire

FIRES = 10
PAPER_FIRES = 2


def show(name: str, value: float, unit: str, bar: float | str | None = None) -> None:
    print(json.dumps({"name": name, "value": round(float(value), 5), "unit": unit, "bar": bar}), flush=True)


def accuracy() -> None:
    """Errors over the bench seeds, the plain baseline and the paper's network beside the default."""
    results: dict[str, list[Score]] = {"": [], "nearest_": [], "paper_": []}
    for index, seed in enumerate(BENCH[:FIRES]):
        fire = make_fire(seed)
        results[""].append(run(fire)[1])
        results["nearest_"].append(run(fire, "nearest-detection")[1])
        if index < PAPER_FIRES:
            results["paper_"].append(run(fire, "fusion-nn-paper", PaperSettings())[1])
    for prefix, scores in results.items():
        bars = {"mae": 3.0, "bias": 1.0, "f1": 0.95, "coverage": "0.85-0.95"} if not prefix else {}
        show(f"{prefix}synthetic_mae_h", np.mean([s.mae_h for s in scores]), "h", bars.get("mae"))
        show(f"{prefix}synthetic_bias_h", np.mean([s.bias_h for s in scores]), "h", bars.get("bias"))
        show(f"{prefix}synthetic_f1", np.mean([s.f1 for s in scores]), "1", bars.get("f1"))
        if not prefix:
            show("interval90_coverage", np.mean([s.coverage90 for s in scores]), "1", bars["coverage"])
            show("crps_h", np.mean([s.crps_h for s in scores]), "h", None)


def _seconds(work: Callable[[], object], repeats: int) -> float:
    """Median wall-clock seconds of a call."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def cost() -> None:
    """Time of a fire of 20,000 looks (fit and map), and of the fitted field's inference; one member is one network."""
    case = case_of(make_fire(BENCH[-1], observations=20_000))
    maps: list[ArrivalMap] = []
    show("fire_20k_s", _seconds(lambda: maps.append(map_case(case, "fusion-nn", 0)), 1), "s", 60.0)
    settings = FieldSettings(members=1, steps=20)
    field = fit_field(case.looks, case.grid, gather(case.grid, case.looks), case.ignition, settings, 0)
    one, many = np.zeros(1), np.linspace(-5.0, 5.0, 10_000)
    field.at(one, one)
    show("infer_single_ms", 1e3 * _seconds(lambda: field.at(one, one), 200), "ms", 0.17)
    show("infer_batch_ms", 1e3 * _seconds(lambda: field.at(many, many), 10) / many.size, "ms", 0.02)
    show("nn_mb", maps[0].model_bytes / 1e6, "MB", 0.08)


def real() -> None:
    """Mean Sorensen over Bobcat and Mineral, default and plain baseline."""
    folder = os.environ.get("SMOKEGLINT_DATA")
    if not folder:
        return
    for prefix, method, bar in (("", "fusion-nn", 0.80), ("nearest_", "nearest-detection", None)):
        values = [sorensen_against_perimeter(Path(folder), name, method) for name in AIRBORNE]
        show(f"{prefix}ir_perimeter_sorensen", np.mean(values), "1", bar)


if __name__ == "__main__":
    torch.set_num_threads(1)
    cost()
    network_export(show)
    front24(show)
    accuracy()
    real()
