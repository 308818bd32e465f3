"""Hourly: how likely each active fire is to become large, from what is known now."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from flows.loop_types import CaseInputs
from flows.runner import Runner
from flows.stages import rate_active


def ratings_label(hour: datetime) -> str:
    """The name under which an hour's ratings lie in the store; no cycle bears such a name."""
    return hour.strftime("%Y%m%dT%H%MZ-ratings")


def rate_hour(runner: Runner, case: CaseInputs, hour: datetime) -> dict[str, Any]:
    """Ratings of every active fire known at the hour, and their report."""
    steps = rate_active(runner, case, hour)
    return dict(steps["rate-active-fires"])
