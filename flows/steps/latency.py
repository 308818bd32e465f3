"""How long it takes from an observation to what is made of it, step by step, in the cycle's own time.

An observation is on the ground when its downlink ends, and level-1 data some hours later (nominal mode; raw-IF data
are processed with the product). Products are made of what is there when the cycle ends; the next plan is made of those
products, released some time after, and on board of a satellite after its first contact from then on. What computing
takes is not in here: it depends on the machine, and is told by ``flows.timings``.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import timedelta
from typing import Any

import numpy as np
import pandas as pd

TIMES = ("observed", "downlinked", "ready")
PAPER_H = 30.0  # the upper end of the paper's 6 to 30 h from observation to product


def latency_budget(
    observed: dict[str, pd.DataFrame],
    contacts: pd.DataFrame,
    satellites: Iterable[str],
    end: pd.Timestamp,
    release_after: timedelta,
) -> dict[str, Any]:
    """Hours of each step, for each mode.

    ``observed`` holds by mode the observations that went into this cycle's products: columns ``observed``,
    ``downlinked`` and ``ready`` (level-1 data), all UTC. ``contacts`` must reach beyond ``end``; one of ``satellites``
    without a contact after the release is counted as not reached. ``observed_to_next_plan_h`` is of every pair of an
    observation and a satellite that is reached: each observation enters the plan of each of them. It is None where
    none is.
    """
    release = end + release_after
    waits = uplink_waits_h(contacts, satellites, release)
    board_h = release_after / timedelta(hours=1) + waits.dropna()
    return {
        "products_at": end.isoformat(),
        "next_plan_released_at": release.isoformat(),
        "next_plan": {"released_h": release_after / timedelta(hours=1), "to_uplink_h": spread(waits)},
        "satellites_not_reached": int(waits.isna().sum()),
        "modes": {mode: _budget(table, end, board_h) for mode, table in observed.items()},
    }


def _budget(given: pd.DataFrame, end: pd.Timestamp, board_h: pd.Series[float]) -> dict[str, Any]:
    # Columns without rows may come without a time zone.
    table = pd.DataFrame({name: pd.to_datetime(given[name], utc=True) for name in TIMES})
    product_h = hours(end - table["observed"])
    aboard_h = np.add.outer(product_h.to_numpy(), board_h.to_numpy()).ravel()
    return {
        "observations": len(table),
        "observed_to_downlinked_h": spread(hours(table["downlinked"] - table["observed"])),
        "downlinked_to_level1_h": spread(hours(table["ready"] - table["downlinked"])),
        "level1_to_product_h": spread(hours(end - table["ready"])),
        "observed_to_product_h": spread(product_h),
        "observed_to_next_plan_h": spread(pd.Series(aboard_h)),
        "share_within_30_h": round(float((product_h <= PAPER_H).mean()), 4) if len(table) else None,
    }


def uplink_waits_h(contacts: pd.DataFrame, satellites: Iterable[str], release: pd.Timestamp) -> pd.Series[float]:
    """Hours from release to each satellite's first contact after it; NaN where there is none."""
    following = contacts[contacts["start"] >= release].groupby("satellite")["start"].min()
    return hours(following.reindex(sorted(satellites)) - release)


def hours(spans: Any) -> Any:
    """Time spans in hours."""
    return spans / pd.Timedelta(hours=1)


def spread(values: pd.Series[float]) -> dict[str, float | None]:
    """Median, 95th percentile and longest, hours to two digits; None where there is nothing."""
    known = values.dropna()
    if known.empty:
        return {"median": None, "p95": None, "longest": None}
    told = {"median": known.median(), "p95": known.quantile(0.95), "longest": known.max()}
    return {name: round(float(value), 2) for name, value in told.items()}
