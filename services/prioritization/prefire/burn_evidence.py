"""What a burned-area look says beyond the share of land that burns anyway."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

Array = npt.NDArray[np.float64]

EVEN_ODDS = 0.5  # prior of a table that does not state its own
LIMIT = 5.0  # no single look is taken for more than odds of 150 to 1


def _prior(table: pd.DataFrame) -> Any:
    return table["prior_probability"].to_numpy(float) if "prior_probability" in table else EVEN_ODDS


def log_likelihood_ratio(table: pd.DataFrame) -> Array:
    """Natural logarithm of P(look | burned) / P(look | unburned), (n,), from the probability and its prior (Bayes)."""
    probability = np.clip(table["burned_probability"].to_numpy(float), 1e-9, 1 - 1e-9)
    prior = np.clip(_prior(table), 1e-9, 1 - 1e-9)
    ratio = np.log(probability / (1 - probability)) - np.log(prior / (1 - prior))
    return np.clip(ratio, -LIMIT, LIMIT)


def excess_probability(table: pd.DataFrame) -> Array:
    """How far the probability lies above its prior, as a share 0..1 of what there is above it, (n,)."""
    prior = _prior(table)
    return np.clip((table["burned_probability"].to_numpy(float) - prior) / (1 - prior), 0.0, 1.0)
