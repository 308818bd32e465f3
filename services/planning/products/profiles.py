"""Storage and battery of every satellite through the horizon, as a table by the minute and as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd

from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem
from services.planning.timeline import battery_wh, collected_seconds, stored_images
from shared import figures
from shared.contracts.schema import Column, TableSchema

matplotlib.use("Agg")
from matplotlib import pyplot as plt

STEP_S = 60
PROFILES = TableSchema(
    "profiles",
    (
        Column("satellite", "string"), Column("time", "time"), Column("stored_images", "int32", minimum=0),
        Column("stored_images_high", "int32", minimum=0), Column("battery_wh", "float64", minimum=0),
        Column("battery_low_wh", "float64", minimum=0), Column("collect_s", "int32", minimum=0),
        Column("downlink_s", "int32", minimum=0), Column("umbra_s", "int32", minimum=0),
    ),
    unique=("satellite", "time"),
)  # fmt: skip
STORED, CHARGE, FLOOR, UMBRA = "#b35806", "#2166ac", "#b30000", "0.85"


def profile_table(problem: PlanningProblem, timeline: Timeline) -> pd.DataFrame:
    """A row per satellite and minute: figures at its end, the worst within it, and seconds spent on what."""
    stored = stored_images(problem, timeline.images, timeline.downlink)
    battery = battery_wh(problem, timeline.images, timeline.downlink)
    collect = collected_seconds(problem, timeline.images)
    begins = np.arange(0, problem.horizon_s, STEP_S)
    ends = np.minimum(begins + STEP_S, problem.horizon_s)
    frames = []
    for s, limits in enumerate(problem.satellites):
        frames.append(pd.DataFrame({
            "satellite": limits.name, "time": problem.horizon_start + pd.to_timedelta(ends, unit="s"),
            "stored_images": stored[s, ends - 1], "stored_images_high": np.maximum.reduceat(stored[s], begins),
            "battery_wh": battery[s, ends - 1], "battery_low_wh": np.minimum.reduceat(battery[s], begins),
            "collect_s": np.add.reduceat(collect[s].astype(np.int64), begins),
            "downlink_s": np.add.reduceat((timeline.downlink[s] >= 0).astype(np.int64), begins),
            "umbra_s": np.add.reduceat((~problem.sunlit[s]).astype(np.int64), begins),
        }))  # fmt: skip
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame({c.name: [] for c in PROFILES.columns})


def draw_profiles(path: Path, problem: PlanningProblem, table: pd.DataFrame, attributes: Mapping[str, Any]) -> None:
    """One panel per satellite: images stored (left) and charge (right) over hours, umbra shaded, limits dashed."""
    count = max(1, len(problem.satellites))
    height = 1.2 + 1.25 * count
    figure, panels = plt.subplots(count, 1, figsize=(14, height), sharex=True, squeeze=False)
    for s, limits in enumerate(problem.satellites):
        mine = table[table["satellite"] == limits.name]
        hours = (mine["time"] - problem.horizon_start).dt.total_seconds().to_numpy() / 3600
        left = panels[s, 0]
        right = left.twinx()
        left.fill_between(hours, 0, limits.storage_images, where=mine["umbra_s"].to_numpy() > STEP_S / 2, color=UMBRA,
                          linewidth=0, step="pre")  # fmt: skip
        left.step(hours, mine["stored_images_high"], where="pre", color=STORED, linewidth=1.1)
        left.axhline(limits.storage_images, color=STORED, linestyle="--", linewidth=0.7)
        left.set_ylim(0, 1.08 * limits.storage_images)
        left.set_ylabel(limits.name, rotation=0, ha="right", va="center")
        left.tick_params(axis="y", colors=STORED, labelsize=8)
        right.plot(hours, mine["battery_low_wh"], color=CHARGE, linewidth=1.1)
        right.axhline(limits.battery_min_wh, color=FLOOR, linestyle="--", linewidth=0.7)
        span = max(1e-6, limits.battery_capacity_wh - limits.battery_min_wh)
        right.set_ylim(limits.battery_min_wh - 0.1 * span, limits.battery_capacity_wh + 0.08 * span)
        right.tick_params(axis="y", colors=CHARGE, labelsize=8)
    panels[-1, 0].set_xlim(0, problem.horizon_s / 3600)
    panels[-1, 0].set_xlabel(f"hours from {problem.horizon_start:%Y-%m-%d %H:%M:%S} UTC")
    figure.suptitle("images stored (orange, left), charge in Wh (blue, right), battery floor (red), umbra (grey)",
                    y=1 - 0.25 / height, fontsize=11)  # fmt: skip
    figure.subplots_adjust(left=0.09, right=0.95, top=1 - 0.5 / height, bottom=0.75 / height, hspace=0.14)
    figures.save(figure, path, attributes)
    plt.close(figure)
