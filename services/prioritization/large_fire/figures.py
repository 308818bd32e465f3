"""Pictures of the large-fire model: how many large and small fires each index calls, and reliability."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from services.prioritization.large_fire import features
from shared import figures

NAMES = {"truth": "truth", "model": "model", "trees": "XGBoost alone", "logistic": "logistic alone"}
LARGE, SMALL = "#b2182b", "#4d7ea8"


def draw(skill: dict[str, Any], path: Path, attributes: Mapping[str, Any]) -> None:
    """PNG of the counts (as the paper's Figure 3) and of the reliability of the pooled forecasts."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.2), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.03, 1, 0.96))
    counts, reliability = figure.subplots(1, 2, width_ratios=(1.7, 1))
    _counts(counts, skill)
    _reliability(reliability, skill)
    figures.save(figure, path, attributes)


def _counts(axes: Any, skill: dict[str, Any]) -> None:
    singles = sorted((n for n in skill["counts"] if n not in NAMES), key=lambda n: -skill["natural"][n]["mcc"])
    order = [*(name for name in NAMES if name in skill["counts"]), *singles]
    labels = [NAMES.get(name) or features.BY_NAME[name].label for name in order]
    place = range(len(order))
    for offset, kind, colour in ((-0.2, "large", LARGE), (0.2, "small", SMALL)):
        values = [skill["counts"][name][kind] for name in order]
        bars = axes.barh([p + offset for p in place], values, 0.38, color=colour, label=f"called {kind}")
        axes.bar_label(bars, fontsize=7, padding=2)
    mcc = {name: skill["natural"][name]["mcc"] for name in order if name != "truth"}
    named = [f"{label}  (MCC {mcc[n]:.2f})" if n in mcc else label for n, label in zip(order, labels, strict=True)]
    axes.set_yticks(list(place), named)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set_xlabel(f"fires, of {skill['fires']} unseen ({skill['large_fires']} large)")
    axes.set_title("Large and small fires called at training thresholds", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


def _reliability(axes: Any, skill: dict[str, Any]) -> None:
    forecast = [100 * row["forecast"] for row in skill["reliability"]]
    observed = [100 * row["observed"] for row in skill["reliability"]]
    top = max(*forecast, *observed, 1.0) * 1.1
    axes.plot([0, top], [0, top], color="0.6", linewidth=1)
    axes.plot(forecast, observed, "o-", color=LARGE)
    axes.set(xlim=(0, top), ylim=(0, top), aspect="equal", xlabel="forecast, %", ylabel="observed, %")
    axes.set_title(f"Reliability by tenths,\ncalibration slope {skill['calibration_slope']:.2f}", fontsize=10)
