"""The one reward scale of targets (r of the paper's equation 1, before the factor 10 of active fires).

Active: r = 0.1 + 0.9 sqrt(p) w s, in 0.1..1, with p the rating's probability, w what the place is worth to the fire
(front, ring ahead, uncertainty) and s the staleness. Pre-fire: r = 0.9 g s, in 0..0.9, with g half from WFSP (1 -
exp(-WFSP/20 %)) and half from WLFP (1 - exp(-WLFP/15 per million km2-days)). So 10 r of any active target, at least 1,
exceeds any pre-fire r. Staleness: s = 0.3 just after a good observation, back to 1 with a time constant of 24 h
(active) or 72 h (pre-fire).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ACTIVE_FLOOR = 0.1
PREFIRE_CEILING = 0.9
STALENESS_FLOOR = 0.3
STALENESS_H = {"active": 24.0, "prefire": 72.0}
WFSP_SCALE_PCT = 20.0
WLFP_SCALE = 15.0


def active_reward(probability: Array, worth: Array, staleness: Array) -> Array:
    """r of active targets in 0.1..1 (see the module)."""
    return ACTIVE_FLOOR + (1 - ACTIVE_FLOOR) * np.sqrt(np.clip(probability, 0, 1)) * np.clip(worth * staleness, 0, 1)


def danger_worth(wfsp_pct: Array, wlfp_per_million_km2_day: Array) -> Array:
    """g in 0..1 of pre-fire places."""
    spread = 1 - np.exp(-np.maximum(wfsp_pct, 0) / WFSP_SCALE_PCT)
    fires = 1 - np.exp(-np.maximum(wlfp_per_million_km2_day, 0) / WLFP_SCALE)
    return 0.5 * spread + 0.5 * fires


def prefire_reward(worth: Array, staleness: Array) -> Array:
    """r of pre-fire targets in 0..0.9."""
    return PREFIRE_CEILING * np.clip(worth, 0, 1) * np.clip(staleness, 0, 1)


def staleness(age_h: Array, kind: str) -> Array:
    """s by hours since the last good observation; 1 where there never was one (NaN)."""
    fresh = STALENESS_FLOOR + (1 - STALENESS_FLOOR) * -np.expm1(-np.maximum(age_h, 0) / STALENESS_H[kind])
    return np.where(np.isnan(age_h), 1.0, fresh)
