"""A synthetic fire run through the service's own steps and scored against its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.arrival import metrics
from services.arrival.assignment import assign
from services.arrival.fires import FireCase, build_case, map_case
from services.arrival.inference import DEFAULT_METHOD, ArrivalMap, Settings
from tests.services.arrival.synthetic_fires import SyntheticFire


@dataclass(frozen=True)
class Score:
    mae_h: float
    bias_h: float
    f1: float
    coverage90: float
    crps_h: float


def case_of(fire: SyntheticFire, cell_m: float = 500.0) -> FireCase:
    """The fire as the service sees it: tables only."""
    assignment = assign(fire.detections, fire.incidents)
    incident = fire.incidents.iloc[0]
    return build_case(incident, fire.detections, fire.burned_area, assignment, fire.end, cell_m, 5.0, 0)


def truth_on(case: FireCase, fire: SyntheticFire) -> np.ndarray:
    """True arrival, hours since the case's reference, at the cell centres of the case's grid; NaN unburned."""
    cell_m = fire.x_m[1] - fire.x_m[0]
    row = np.floor((case.grid.y_m - fire.y_m[0]) / cell_m + 0.5).astype(int)
    column = np.floor((case.grid.x_m - fire.x_m[0]) / cell_m + 0.5).astype(int)
    inside = ((row >= 0) & (row < fire.y_m.size))[:, None] & ((column >= 0) & (column < fire.x_m.size))
    picked = fire.arrival_h[np.clip(row, 0, fire.y_m.size - 1)][:, np.clip(column, 0, fire.x_m.size - 1)]
    lead_h = (fire.start - case.reference).total_seconds() / 3600.0
    return np.where(inside, picked + lead_h, np.nan)


def score(arrival: ArrivalMap, truth_h: np.ndarray) -> Score:
    mae, bias = metrics.mean_error_h(arrival.arrival_h, truth_h)
    f1 = metrics.sorensen(np.isfinite(arrival.arrival_h), np.isfinite(truth_h))
    coverage = metrics.interval_coverage(arrival.q05_h, arrival.q95_h, truth_h)
    return Score(mae, bias, f1, coverage, metrics.crps_normal_h(arrival.arrival_h, arrival.sd_h, truth_h))


def run(
    fire: SyntheticFire, method: str = DEFAULT_METHOD, settings: Settings | None = None, cell_m: float = 500.0
) -> tuple[ArrivalMap, Score]:
    case = case_of(fire, cell_m)
    arrival = map_case(case, method, 0, settings)
    return arrival, score(arrival, truth_on(case, fire))
