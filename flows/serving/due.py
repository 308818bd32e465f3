"""Which cycles and ratings are due at a moment. No clock here: the moment is given."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime, timedelta
from typing import Literal

Missed = Literal["catch-up", "skip"]


def cycles_begun(first_cutoff: datetime, cycle_hours: int, now: datetime) -> int:
    """How many cycles have had their cut-off by ``now``: the number of the current one; 0 before the first."""
    return max(0, (now - first_cutoff) // timedelta(hours=cycle_hours) + 1) if now >= first_cutoff else 0


def cycles_to_run(begun: int, planned: Collection[int], missed: Missed) -> list[int]:
    """The numbers of the cycles to go through, in order, ending with the current one.

    Those that have a plan already are gone through again (their finished steps answer from the store), so that what
    they brought in the meantime is retrieved. One that was missed, having no plan, is caught up or left out.
    """
    if missed == "catch-up":
        return list(range(1, begun + 1))
    return [number for number in range(1, begun + 1) if number in planned or number == begun]


def hour_of(now: datetime) -> datetime:
    """The full hour that has begun."""
    return now.replace(minute=0, second=0, microsecond=0)
