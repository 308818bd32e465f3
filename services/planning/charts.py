"""Products for people: Gantt chart of the constellation and the planned targets as GeoJSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import Patch

STATION_COLOURS = ("#1b7837", "#762a83", "#2166ac", "#b35806", "#01665e", "#8c510a")
COLLECT, CONTACT, ECLIPSE = "#d6301d", "#cfcfcf", "#3b3b3b"


def _runs(mask: np.ndarray) -> list[tuple[float, float]]:
    """(start h, length h) of the true runs of a mask over seconds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(begin / 3600, (end - begin) / 3600) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def write_gantt(path: Path, problem: PlanningProblem, timeline: Timeline, title: str, footer: str) -> None:
    """One band per satellite: contacts, umbra, images and downlinks over hours from the horizon's start (UTC)."""
    count = len(problem.satellites)
    figure, axes = plt.subplots(figsize=(14, 1.6 + 0.62 * max(1, count)))
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
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.9 / (1.6 + 0.62 * count)), ncol=7, frameon=False
    )
    figure.text(0.01, 0.01, footer, fontsize=7, color="#555555")
    figure.savefig(path, dpi=110, bbox_inches="tight", metadata={"Software": None})
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


def write_footprints(
    path: Path, problem: PlanningProblem, timeline: Timeline, targets: pd.DataFrame, attributes: dict[str, Any]
) -> None:
    """Every planned target as a point with the first image that collects it (RFC 7946, lon/lat degrees)."""
    images = timeline.images[np.argsort(problem.images.second[timeline.images], kind="stable")]
    first: dict[int, int] = {}
    for image in images:
        for target in problem.images.covered(int(image)):
            first.setdefault(int(target), int(image))
    longitude, latitude = targets.geometry.x.to_numpy(), targets.geometry.y.to_numpy()
    features = []
    for target in sorted(first):
        image = first[target]
        satellite, second = int(problem.images.satellite[image]), int(problem.images.second[image])
        cycle = int(np.searchsorted(cycle_ends(problem, satellite), second, side="right"))
        moment = problem.horizon_start + pd.Timedelta(seconds=second)
        features.append({
            "type": "Feature",
            "geometry": {
                "type": "Point", "coordinates": [round(float(longitude[target]), 5), round(float(latitude[target]), 5)]
            },
            "properties": {
                "target_id": int(problem.targets.target_id[target]),
                "kind": "active" if problem.targets.active[target] else "prefire",
                "reward": float(problem.targets.value[target]), "satellite": problem.satellites[satellite].name,
                "image_id": int(problem.images.image_id[image]), "cycle": cycle,
                "time": moment.strftime("%Y-%m-%dT%H:%M:%SZ"),
            },
        })  # fmt: skip
    collection = {"type": "FeatureCollection", "features": features, "product": attributes}
    path.write_text(json.dumps(collection, sort_keys=True, default=str) + "\n", encoding="utf-8")
