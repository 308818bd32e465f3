"""Skill of the large-fire model on unseen seasons of real fires, and the time of a rating and of a danger grid.

``python -m tests.bench.bench_prioritization`` prints one JSON object a line. Skill needs SMOKEGLINT_DATA (the
Victorian fires); without it only the timings are printed. ``auc`` … are of the model with land columns; those ending
in ``_loop`` of the shipped one, which has only what every case of the loop carries; ``us_`` … are of US fires, one
region left out at a time. ``--long`` adds the ablation and five years of fuel moisture.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from tests.bench.prioritization import active_fires
from tests.bench.prioritization.prefire_danger import conus_day_at_1_km, time_of_a_danger_grid


def report(name: str, value: float, unit: str, bar: float | None) -> None:
    """One metric as one line."""
    print(json.dumps({"name": name, "value": round(float(value), 4), "unit": unit, "bar": bar}), flush=True)


if __name__ == "__main__":
    if os.environ.get("SMOKEGLINT_DATA"):
        folder = Path(os.environ["SMOKEGLINT_DATA"])
        for metric in active_fires.skill_of_real_fires(folder):
            report(*metric)
        if "--long" in sys.argv[1:]:
            for part in (active_fires.ablation_of_real_fires, active_fires.fuel_moisture_of_five_years):
                for metric in part(folder):
                    report(*metric)
    for metric in active_fires.time_of_64_ratings():
        report(*metric)
    for metric in time_of_a_danger_grid():
        report(*metric)
    vegetation = Path(os.environ["SMOKEGLINT_DATA"]) / "vegetation" if os.environ.get("SMOKEGLINT_DATA") else None
    for metric in conus_day_at_1_km(vegetation):
        report(*metric)
