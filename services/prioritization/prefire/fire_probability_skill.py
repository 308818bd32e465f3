"""How reliable a refit is: leave-one-year-out predictions in the bins of the USGS, beside what the USGS observed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.prefire import fire_probability, fire_probability_fit
from shared import figures
from shared.errors import DomainError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class UsgsBins:
    """Edges of forecast bins and what the USGS observed in each (leave one year out, published in its reliability)."""

    name: str
    edges: tuple[float, ...]
    observed: tuple[float, ...]
    years: str


WFSP_BINS = UsgsBins(
    "wfsp_pct",
    (0, 0.5, 1, 2, 5, 10, 20, 30, 100),
    (0.19, 0.83, 1.35, 3.56, 6.95, 13.86, 20.63, 34.19),
    "2001-2015",
)
WLFP_BINS = UsgsBins(
    "wlfp_per_million_km2_day",
    (0, 0.1, 0.5, 1, 2, 3, 5, 7, np.inf),
    (0.04, 0.26, 0.72, 1.38, 2.40, 3.88, 5.57, 9.78),
    "2001-2017",
)


def left_out_predictions(
    table: pd.DataFrame,
    outcome: str,
    model: fire_probability.SmoothLogit,
    penalty: float,
    at: pd.DataFrame | None = None,
) -> Array:
    """Probability of each row (of ``at``, else of the table) by a fit of the other years, in the box of ``model``.

    The penalty is that of the fit of all years. DomainError with fewer than two years.
    """
    years = table["time"].dt.year.to_numpy()
    if len(np.unique(years)) < 2:
        raise DomainError(
            "Leave-one-year-out needs at least two years.", field="time", value=str(years[:1]), accepted="2 years"
        )
    matrix, events = fire_probability_fit.design(table, _box(model)), table[outcome].to_numpy(float)
    wanted = matrix if at is None else fire_probability_fit.design(at, _box(model))
    wanted_years = years if at is None else at["time"].dt.year.to_numpy()
    offset = fire_probability_fit.sampling_offset(table, outcome)
    whole = fire_probability_fit.coefficients_of(model)
    predicted = np.full(len(wanted), np.nan)
    for year in np.unique(wanted_years):
        kept, out = years != year, wanted_years == year
        left = fire_probability_fit.regress(matrix[kept], events[kept], offset[kept], penalty, whole)
        predicted[out] = fire_probability.sigmoid(wanted[out] @ left.coefficients)
    return predicted


def _box(model: fire_probability.SmoothLogit) -> fire_probability_fit.Box:
    return fire_probability_fit.Box(model.place.west, model.place.south, model.place.east, model.place.north)


def reliability(predicted: Array, observed: Array, weight: Array, bins: UsgsBins, scale: float) -> list[dict[str, Any]]:
    """Per bin: rows, mean forecast and observed rate with its 90 % interval, beside the USGS's observed.

    ``weight`` says for how many cases a row stands; ``scale`` turns probabilities into the bins' unit (100 for per
    cent, 10^6 for fires per million km2 and day). The interval is Gamma (Poisson events) about the observed.
    """
    from scipy.stats import gamma

    index = np.digitize(predicted * scale, bins.edges[1:-1])
    rows = []
    for number, usgs in enumerate(bins.observed):
        inside = index == number
        cases, events = float(weight[inside].sum()), float(observed[inside].sum())
        per_case = scale / cases if cases else float("nan")
        low = gamma.ppf(0.05, events) if events else 0.0
        rows.append(
            {
                "from": bins.edges[number],
                "to": bins.edges[number + 1],
                "rows": int(inside.sum()),
                "events": int(events),
                "forecast": float((predicted[inside] * weight[inside]).sum()) * per_case,
                "observed": events * per_case,
                "observed_low": float(low) * per_case,
                "observed_high": min(float(gamma.ppf(0.95, events + 1)) * per_case, scale),
                "usgs_observed": usgs,
            }
        )
    return rows


def against_usgs(refit: fire_probability_fit.Refit, fires: pd.DataFrame, voxels: pd.DataFrame) -> dict[str, Any]:
    """Reliability of both probabilities, each left-out year predicted by the others; ``bins_held`` of ``bins``.

    A bin holds where the mean forecast lies in the 90 % interval of what was observed. WLFP is that of the voxels, its
    large fires those ignitions that the table marks ``large``; without that column WLFP is not held against anything.
    """
    spread = left_out_predictions(fires, "large", refit.model.spread, refit.spread_penalty)
    ones = np.ones(len(fires))
    report = {"wfsp": reliability(spread, fires["large"].to_numpy(float), ones, WFSP_BINS, 100.0)}
    if "large" in voxels:
        report["wlfp"] = _wlfp(refit, fires, voxels)
    held = {
        name: {"bins_held": sum(_holds(row) for row in rows), "bins": sum(row["rows"] > 0 for row in rows)}
        for name, rows in report.items()
    }
    return {"reliability": report, "summary": held}


def _holds(row: dict[str, Any]) -> bool:
    return bool(row["rows"]) and row["observed_low"] <= row["forecast"] <= row["observed_high"]


def _wlfp(refit: fire_probability_fit.Refit, fires: pd.DataFrame, voxels: pd.DataFrame) -> list[dict[str, Any]]:
    lit = left_out_predictions(voxels, "ignition", refit.model.ignition, refit.ignition_penalty)
    grows = left_out_predictions(fires, "large", refit.model.spread, refit.spread_penalty, at=voxels)
    background = voxels["ignition"].to_numpy() == 0
    weight = np.where(background, 1 / voxels["sampling_rate"].to_numpy(float), 1.0)
    return reliability(lit * grows, voxels["large"].to_numpy(float), weight, WLFP_BINS, 1e6)


def draw(report: dict[str, Any], path: Path, attributes: dict[str, Any]) -> None:
    """Observed against forecast in the USGS's bins, with the USGS's own observed values, as PNG."""
    from matplotlib.figure import Figure

    labels = {"wfsp": "WFSP (%)", "wlfp": "WLFP (per million km² and day)"}
    panels = report["reliability"]
    figure = Figure(figsize=(6.2 * len(panels), 6))
    for axis, (name, rows) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels.items(), strict=True):
        filled = [row for row in rows if row["rows"]]
        forecast, observed, low, high, usgs = (
            np.array([row[key] for row in filled])
            for key in ("forecast", "observed", "observed_low", "observed_high", "usgs_observed")
        )
        span = [0.8 * float(min(forecast.min(), usgs.min())), 1.3 * float(max(high.max(), usgs.max()))]
        axis.plot(span, span, color="0.6", linewidth=1, label="perfect")
        axis.errorbar(
            forecast, observed, [observed - low, high - observed], fmt="o", color="#b5331b", label="refit, 90 %"
        )
        axis.plot(forecast, usgs, "s", mfc="none", color="#1f4e79", label="USGS observed in the bin")
        axis.set(xscale="log", yscale="log", xlim=span, ylim=span, xlabel=f"forecast {labels[name]}", ylabel="observed")
        axis.set_title(f"{labels[name]}: each year predicted by the others", fontsize=11)
        axis.legend(fontsize=8)
    figure.subplots_adjust(left=0.08, right=0.97, top=0.92, bottom=0.14, wspace=0.22)
    figures.save(figure, path, attributes)
