"""Held-out estimates for people: against the soil moisture they should be, and over time beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from services.retrieval.looks.observation_report import screening_note
from services.retrieval.soil_moisture.conformal import Z90
from services.retrieval.soil_moisture.skill import skill
from shared.figures import save

MAX_POINTS = 4000
ESTIMATE, BASELINE, TRUTH = "#1b6ca8", "#c98a2b", "#222222"


def skill_figure(path: Path, held: pd.DataFrame, attributes: Mapping[str, Any]) -> None:
    """Two panels (PNG): estimates of ``hold_out`` against soil moisture, and the means of days."""
    from matplotlib.figure import Figure  # no pyplot: no global state, no display

    figure = Figure(figsize=(11.0, 5.2))
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.07, right=0.98, top=0.86, bottom=0.17, wspace=0.2)
    figure.suptitle("Soil moisture from reflectivity, each day predicted from the others", fontsize=11)
    if len(held):
        _scatter(left, held)
        _series(right, held)
    else:
        left.text(0.5, 0.5, "too few days to hold one out", ha="center", transform=left.transAxes)
    figure.text(0.008, 0.03, screening_note(attributes, 215), fontsize=5.5, color="0.35", va="bottom")
    save(figure, path, attributes)


def _scatter(axes: Any, held: pd.DataFrame) -> None:
    shown = held.iloc[:: max(1, len(held) // MAX_POINTS)]
    axes.scatter(shown["soil_moisture"], shown["baseline"], s=5, color=BASELINE, alpha=0.35, lw=0, label="cell mean")
    axes.scatter(shown["soil_moisture"], shown["estimate"], s=5, color=ESTIMATE, alpha=0.5, lw=0, label="regression")
    top = float(max(held["soil_moisture"].max(), held["estimate"].max())) * 1.05
    axes.plot([0, top], [0, top], color="0.6", lw=0.8)
    truth = held["soil_moisture"].to_numpy()
    found = skill(truth, held["estimate"].to_numpy(), held["sd"].to_numpy())
    mean = skill(truth, held["baseline"].to_numpy())
    axes.set_title(
        f"regression: R {found['r']:.2f}, ubRMSE {found['ubrmse']:.3f}, bias {found['bias']:+.3f}, "
        f"90 % interval holds {100 * found['interval90_coverage']:.0f} %\n"
        f"cell mean: R {mean['r']:.2f}, ubRMSE {mean['ubrmse']:.3f}, bias {mean['bias']:+.3f}; {len(held)} cell-days",
        fontsize=8.5,
    )
    axes.set(xlim=(0, top), ylim=(0, top), xlabel="soil moisture given (m³/m³)", ylabel="estimate (m³/m³)")
    axes.legend(fontsize=8, markerscale=2.5)


def _series(axes: Any, held: pd.DataFrame) -> None:
    days = held.groupby("day")[["soil_moisture", "estimate", "baseline", "sd"]].mean()
    labels = pd.to_datetime(days.index.to_numpy(), unit="D").strftime("%Y-%m-%d")
    place = np.arange(len(days))  # evenly spaced: seasons may lie months apart
    reach = Z90 * days["sd"]
    axes.fill_between(place, days["estimate"] - reach, days["estimate"] + reach, color=ESTIMATE, alpha=0.15, lw=0,
                      label="90 % interval of a cell")  # fmt: skip
    axes.plot(place, days["soil_moisture"], "o-", color=TRUTH, ms=4, lw=1, label="given")
    axes.plot(place, days["estimate"], "s-", color=ESTIMATE, ms=4, lw=1, label="regression")
    axes.plot(place, days["baseline"], "^--", color=BASELINE, ms=4, lw=1, label="cell mean")
    step = max(1, len(days) // 8)
    axes.set_xticks(place[::step], labels[::step], rotation=30, ha="right", fontsize=7)
    axes.set(ylabel="mean over cells (m³/m³)")
    axes.set_title("means of the days", fontsize=8.5)
    axes.legend(fontsize=8)
