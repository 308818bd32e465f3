"""Fire arrival time: `python -m tests.bench.bench_arrival` prints one JSON object a line.

The default method beside the support vector machine on unseen synthetic fires, and with SMOKEGLINT_DATA on WRF-SFIRE
maps and real outlines; cost; the next 24 hours. `--long` adds the paper's network, ablations, Table 2 and the value of
burned-area looks.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import torch

from services.arrival.field import FieldSettings, fit_field
from services.arrival.fires import map_case
from services.arrival.inference import DEFAULT_METHOD
from services.arrival.network import parameter_count
from services.arrival.paper_method import PaperSettings, fit_paper
from tests.bench.arrival.accuracy import accuracy
from tests.bench.arrival.front24 import front24
from tests.bench.arrival.fusion import fusion
from tests.bench.arrival.network_export import network_export
from tests.services.arrival.scored import case_of
from tests.services.arrival.seeds import BENCH
from tests.services.arrival.synthetic_fires import make_fire


def show(name: str, value: float, unit: str, bar: float | str | None = None) -> None:
    print(json.dumps({"name": name, "value": round(float(value), 5), "unit": unit, "bar": bar}), flush=True)


def _seconds(work: Callable[[], object], repeats: int) -> float:
    """Median wall-clock seconds of a call."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def cost() -> None:
    """Time of a fire of 20,000 looks (default method, fit and map), and inference of the paper's network as it is
    shipped (one thread) and of the default's fitted field."""
    case = case_of(make_fire(BENCH[-1], observations=20_000))
    show("fire_20k_s", _seconds(lambda: map_case(case, DEFAULT_METHOD, 0), 1), "s", 60.0)
    network = fit_paper(case.looks, PaperSettings(epochs=1), 0)
    plain = network.folded()
    one, many = np.zeros(1), np.linspace(-5.0, 5.0, 10_000)
    source_one, source_many = np.zeros(1, np.int8), np.zeros(many.size, np.int8)
    plain(one, one, source_one)
    show("infer_single_ms", 1e3 * _seconds(lambda: plain(one, one, source_one), 500), "ms", 0.17)
    batch = _seconds(lambda: plain(many, many, source_many), 20) / many.size
    show("infer_batch_ms", 1e3 * batch, "ms", 0.02)
    show("nn_mb", 4 * parameter_count(network.network) / 1e6, "MB", 0.08)
    field = fit_field(case.looks, case.grid, case.ignition, FieldSettings(steps=5), 0)
    field.at(one, one)
    show("field_infer_single_ms", 1e3 * _seconds(lambda: field.at(one, one), 500), "ms", 0.17)
    show("field_infer_batch_ms", 1e3 * _seconds(lambda: field.at(many, many), 20) / many.size, "ms", 0.02)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--long", action="store_true", help="also the network, ablations, Table 2 and value rows")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    cost()
    network_export(show)
    front24(show)
    accuracy(show)
    if chosen.long:
        fusion(show)


if __name__ == "__main__":
    main()
