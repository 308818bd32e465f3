"""Skill of the large-fire model on unseen seasons of real fires, and the time of a rating and of a danger grid.

``python -m tests.bench.bench_prioritization`` prints one JSON object a line. Skill needs SMOKEGLINT_DATA (the
Victorian fires); without it only the timings are printed. ``auc`` … are of the model with land columns; those ending
in ``_loop`` of the shipped one, which has only what every case of the loop carries.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from tests.bench.prioritization.active_fires import skill_of_real_fires, time_of_64_ratings
from tests.bench.prioritization.prefire_danger import conus_day_at_1_km, time_of_a_danger_grid


def report(name: str, value: float, unit: str, bar: float | None) -> None:
    """One metric as one line."""
    print(json.dumps({"name": name, "value": round(float(value), 4), "unit": unit, "bar": bar}), flush=True)


if __name__ == "__main__":
    if os.environ.get("SMOKEGLINT_DATA"):
        for metric in skill_of_real_fires(Path(os.environ["SMOKEGLINT_DATA"])):
            report(*metric)
    for metric in time_of_64_ratings():
        report(*metric)
    for metric in time_of_a_danger_grid():
        report(*metric)
    vegetation = Path(os.environ["SMOKEGLINT_DATA"]) / "vegetation" if os.environ.get("SMOKEGLINT_DATA") else None
    for metric in conus_day_at_1_km(vegetation):
        report(*metric)
