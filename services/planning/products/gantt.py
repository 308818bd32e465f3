"""The constellation's commands over time, a band per satellite."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem
from shared import figures

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import Patch

STATION_COLOURS = ("#1b7837", "#762a83", "#2166ac", "#b35806", "#01665e", "#8c510a")
COLLECT, CONTACT, ECLIPSE = "#d6301d", "#cfcfcf", "#3b3b3b"


def _runs(mask: np.ndarray) -> list[tuple[float, float]]:
    """(start h, length h) of the true runs of a mask over seconds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(begin / 3600, (end - begin) / 3600) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def write_gantt(
    path: Path, problem: PlanningProblem, timeline: Timeline, title: str, attributes: Mapping[str, Any]
) -> None:
    """One band per satellite: contacts, umbra, images and downlinks over hours from the horizon's start (UTC)."""
    count = len(problem.satellites)
    figure, axes = plt.subplots(figsize=(14, 1.9 + 0.62 * max(1, count)))
    for s in range(count):
        _band(axes, problem, timeline, s)
    axes.set_yticks(range(count), [limits.name for limits in problem.satellites])
    axes.set_ylim(count - 0.4, -0.6)
    axes.set_xlim(0, problem.horizon_s / 3600)
    axes.set_xlabel(f"hours from {problem.horizon_start:%Y-%m-%d %H:%M:%S} UTC")
    axes.set_title(title)
    handles = [
        Patch(color=COLLECT, label="image"),
        Patch(color=CONTACT, label="contact"),
        Patch(color=ECLIPSE, label="umbra"),
    ]
    for station, name in enumerate(problem.stations):
        colour = STATION_COLOURS[station % len(STATION_COLOURS)]
        handles.append(Patch(color=colour, label=f"downlink {name}"))
    axes.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.25 / (1.9 + 0.62 * max(1, count))),
        ncol=9,
        frameon=False,
        bbox_transform=figure.transFigure,
        fontsize=9,
    )
    height = 1.9 + 0.62 * max(1, count)
    figure.subplots_adjust(left=0.08, right=0.985, top=1 - 0.45 / height, bottom=1.15 / height)
    figures.save(figure, path, attributes)
    plt.close(figure)


def _band(axes: Any, problem: PlanningProblem, timeline: Timeline, s: int) -> None:
    passes = [p for p in problem.passes if p.satellite == s]
    axes.broken_barh([(p.start_s / 3600, (p.end_s - p.start_s) / 3600) for p in passes], (s - 0.35, 0.7), color=CONTACT)
    axes.broken_barh(_runs(~problem.sunlit[s]), (s + 0.36, 0.08), color=ECLIPSE)
    for station in range(len(problem.stations)):
        colour = STATION_COLOURS[station % len(STATION_COLOURS)]
        axes.broken_barh(_runs(timeline.downlink[s] == station), (s - 0.35, 0.33), color=colour)
    own = timeline.images[problem.images.satellite[timeline.images] == s]
    seconds = np.concatenate([problem.images.second[own], problem.frozen.second[problem.frozen.satellite == s]])
    axes.vlines(np.unique(seconds) / 3600, s + 0.02, s + 0.34, color=COLLECT, linewidth=0.4)
