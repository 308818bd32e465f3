"""The time it is, or the one that the environment sets."""

from __future__ import annotations

import os
from datetime import UTC, datetime

CLOCK = "SMOKEGLINT_CLOCK"  # a fixed time instead of the machine's: for tests, and to go through a past season


def now_utc() -> datetime:
    """The time it is, or the one that the environment sets."""
    fixed = os.environ.get(CLOCK, "")
    return datetime.fromisoformat(fixed).astimezone(UTC) if fixed else datetime.now(UTC)
