"""What became of every image and every target: when it comes down, who sees it first, and why it is not seen."""

from __future__ import annotations

import numpy as np
import pandas as pd

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import IntArray, PlanningProblem
from services.planning.products.reasons import target_reasons
from services.planning.timeline import collected_seconds
from shared.contracts.schema import Column, TableSchema

IMAGES = TableSchema(
    "images",
    (
        Column("satellite", "string"), Column("start", "time"), Column("image_id", "int32"), Column("cycle", "int32"),
        Column("targets", "int32", minimum=0), Column("reward", "float64", minimum=0),
        Column("downlinked_at", "time", nullable=True), Column("station", "string", nullable=True),
        Column("latency_h", "float64", nullable=True, minimum=0),
    ),
    unique=("image_id",),
)  # fmt: skip
TARGETS = TableSchema(
    "target_outcomes",
    (
        Column("target_id", "int64"), Column("kind", "string", values=("active", "prefire")),
        Column("reward", "float64", minimum=0), Column("opportunities", "int64", minimum=0), Column("observed", "bool"),
        Column("image_id", "int32", nullable=True), Column("satellite", "string", nullable=True),
        Column("time", "time", nullable=True), Column("reason", "string"),
    ),
    unique=("target_id",),
)  # fmt: skip


def downlink_times(problem: PlanningProblem, timeline: Timeline, satellite: int) -> tuple[IntArray, IntArray]:
    """Second of collection and of the end of downlink (-1: still on board) of each image, first in first out."""
    limits = problem.satellites[satellite]
    taken = np.flatnonzero(collected_seconds(problem, timeline.images)[satellite])
    seconds = np.flatnonzero(timeline.downlink[satellite] >= 0) + 1
    last = limits.downlink_s_per_image * (limits.stored_images_initial + 1 + np.arange(len(taken))) - 1
    done = np.full(len(taken), -1, np.int64)
    done[last < len(seconds)] = seconds[last[last < len(seconds)]]
    return taken, done


def first_observers(problem: PlanningProblem, images: IntArray) -> IntArray:
    """The first of ``images`` in time that sees each target (-1: none)."""
    order = images[np.lexsort((problem.images.satellite[images], problem.images.second[images]))]
    first = np.full(len(problem.targets.value), -1, np.int64)
    for image in order[::-1]:
        first[problem.images.covered(int(image))] = image
    return first


def image_table(problem: PlanningProblem, timeline: Timeline) -> pd.DataFrame:
    """A row per planned image: targets that it sees first and their reward, end of its downlink, hours until then."""
    own = problem.images
    first = first_observers(problem, timeline.images)
    seen = first >= 0
    worth = np.bincount(first[seen], problem.targets.value[seen], minlength=len(own))
    count = np.bincount(first[seen], minlength=len(own))
    ids = {(int(own.satellite[i]), int(own.second[i])): (int(own.image_id[i]), int(i)) for i in timeline.images}
    for s, t, number in zip(problem.frozen.satellite, problem.frozen.second, problem.frozen.image_id, strict=True):
        ids.setdefault((int(s), int(t)), (int(number), -1))
    rows = []
    for s, limits in enumerate(problem.satellites):
        ends = cycle_ends(problem, s)
        for taken, done in zip(*downlink_times(problem, timeline, s), strict=True):
            number, image = ids[(s, int(taken))]
            station = problem.stations[timeline.downlink[s, done - 1]] if done >= 0 else None
            rows.append((
                limits.name, int(taken), number, int(np.searchsorted(ends, taken, side="right")),
                int(count[image]) if image >= 0 else 0, float(worth[image]) if image >= 0 else 0.0,
                int(done) if done >= 0 else None, station, (done - taken) / 3600 if done >= 0 else None,
            ))  # fmt: skip
    table = pd.DataFrame(rows, columns=[column.name for column in IMAGES.columns])
    for name in ("start", "downlinked_at"):
        seconds = pd.to_timedelta(pd.to_numeric(table[name]), unit="s")
        table[name] = problem.horizon_start + seconds
    return table


def target_table(problem: PlanningProblem, timeline: Timeline) -> pd.DataFrame:
    """A row per target: whether it is observed and by which image first, or the reason why not."""
    own = problem.images
    first = first_observers(problem, timeline.images)
    seen = first >= 0
    image = np.where(seen, first, 0)
    names = np.array([limits.name for limits in problem.satellites] or [""], object)
    satellite = own.satellite[image] if len(own) else np.zeros(len(first), np.int64)
    number = own.image_id[image] if len(own) else image
    second = own.second[image] if len(own) else image
    time = pd.Series(problem.horizon_start + pd.to_timedelta(second, unit="s"))
    return pd.DataFrame({
        "target_id": problem.targets.target_id, "kind": np.where(problem.targets.active, "active", "prefire"),
        "reward": problem.targets.value, "opportunities": problem.opportunity_count, "observed": seen,
        "image_id": pd.Series(number).where(seen).astype("Int32"),
        "satellite": pd.Series(names[satellite]).where(seen, None), "time": time.where(seen),
        "reason": target_reasons(problem, timeline),
    })  # fmt: skip
