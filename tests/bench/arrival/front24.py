"""The next 24 hours on the bench seeds: the forecast beside persistence and a constant rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.services.arrival.front.forecast_cases import score_front
from tests.services.arrival.seeds import BENCH
from tests.services.arrival.synthetic_fires import make_fire

Show = Callable[..., None]
CUT_H = 96.0


def front24(show: Show, fires: int = 8) -> None:
    """F1 of the area burned 24 h after the fourth day, over the first `fires` bench seeds."""
    scores = [score_front(make_fire(seed), CUT_H) for seed in BENCH[:fires]]
    plain = float(np.mean([score.f1_persistence for score in scores]))
    steady = float(np.mean([score.f1_constant_rate for score in scores]))
    show("front24_f1", np.mean([score.f1 for score in scores]), "1", f"> {max(plain, steady):.4f}, both below")
    show("front24_f1_persistence", plain, "1")
    show("front24_f1_constant_rate", steady, "1")
    show("front24_brier", np.mean([score.brier for score in scores]), "1")
