"""Synthetic fires cut off a day before their end, and how well the next day was foreseen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from services.arrival.assignment import assign
from services.arrival.fires import build_case, map_case
from services.arrival.front.forecast import constant_rate, forecast_front, persistence
from services.arrival.inference import DEFAULT_METHOD
from services.arrival.metrics import sorensen
from tests.services.arrival.scored import truth_on
from tests.services.arrival.synthetic_fires import SyntheticFire


@dataclass(frozen=True)
class FrontScore:
    """F1 of the area burned 24 h after the cut: ours, nothing more burns, the outline moves on as it did; and the
    Brier score of ours where the map had nothing burned."""

    f1: float
    f1_persistence: float
    f1_constant_rate: float
    brier: float


def score_front(fire: SyntheticFire, cut_h: float, method: str = DEFAULT_METHOD, settings: Any = None) -> FrontScore:
    """Map the fire from what had been seen by `cut_h` hours after its start, and forecast the 24 h after."""
    end = fire.start + pd.Timedelta(hours=cut_h)
    seen = fire.detections[fire.detections["time"] <= end].reset_index(drop=True)
    assignment = assign(seen, fire.incidents)
    case = build_case(fire.incidents.iloc[0], seen, fire.burned_area.iloc[:0], assignment, end, 500.0, 10.0, 0)
    arrival = map_case(case, method, 0, settings)
    front = forecast_front(arrival, case.end_h)
    truth = truth_on(case, fire) <= case.end_h + 24.0
    open_land = ~np.isfinite(arrival.arrival_h)
    return FrontScore(
        sorensen(front.burned_by_then(arrival), truth),
        sorensen(persistence(arrival), truth),
        sorensen(constant_rate(arrival, case.end_h), truth),
        float(((front.probability - truth) ** 2)[open_land].mean()),
    )
