"""Skill of the large-fire model on unseen seasons of real fires, and the time of a rating and of a danger grid.

``python -m tests.bench.bench_prioritization`` prints one JSON object a line. Skill needs SMOKEGLINT_DATA (the
Victorian fires); without it only the timings are printed. ``auc`` … are of the model with land columns; those ending
in ``_loop`` of the shipped one, which has only what every case of the loop carries.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import numpy as np

from services.prioritization.prefire import danger
from services.prioritization.prefire.fire_potential import MASK_CODES
from tests.bench.prioritization.active_fires import START, made_up_weather, skill_of_real_fires, time_of_64_ratings


def report(name: str, value: float, unit: str, bar: float | None) -> None:
    """One metric as one line."""
    print(json.dumps({"name": name, "value": round(float(value), 4), "unit": unit, "bar": bar}), flush=True)


def time_of_a_danger_grid() -> None:
    """60 x 60 cells, eight lead days, soil moisture none; the second run."""
    grid = made_up_weather(30, 192)
    cells = 60
    axis = np.linspace(0, 3, cells)
    flat = np.ones((cells, cells))
    mask = np.zeros((cells, cells), dtype=np.uint8)
    mask[0, 0] = max(MASK_CODES)
    fuels = danger.Fuels(
        32 + axis, -109 + axis, 0.4 * flat, 0.7 * flat, flat, flat, 25 * flat, mask, flat * 0.05, flat * 0.3
    )
    seconds = 0.0
    for _ in range(2):
        began = time.perf_counter()
        conditions = danger.conditions_on_fuels(grid, None, START, fuels)
        seen = danger.seen_land(fuels, [], [], START, danger.DangerEffects())
        result = danger.danger(fuels, conditions, seen, START)
        seconds = time.perf_counter() - began
        assert int(np.isfinite(result["wfpi"].to_numpy()).sum()) == 8 * (cells * cells - 1)
    report("danger_60x60_8_days_s", seconds, "s", 2.0)


if __name__ == "__main__":
    if os.environ.get("SMOKEGLINT_DATA"):
        for metric in skill_of_real_fires(Path(os.environ["SMOKEGLINT_DATA"])):
            report(*metric)
    for metric in time_of_64_ratings():
        report(*metric)
    time_of_a_danger_grid()
