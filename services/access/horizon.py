"""The time that a prediction covers."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from shared.errors import DomainError

FIRST_YEAR, LAST_YEAR = 1957, 2200


@dataclass(frozen=True)
class Horizon:
    """The time predicted: whole seconds from ``start`` (UTC), an image at every ``step_s``."""

    start: datetime
    duration_s: int = 86400
    step_s: int = 1

    def __post_init__(self) -> None:
        if not FIRST_YEAR <= self.start.year <= LAST_YEAR:
            raise DomainError(
                f"start {self.start.isoformat()} is no time of satellites.",
                field="start",
                value=self.start.isoformat(),
                accepted=f"years {FIRST_YEAR} to {LAST_YEAR}",
            )
        if self.start.tzinfo is None or self.start.microsecond:
            raise DomainError(
                f"start {self.start.isoformat()} is not a whole second with a time zone.",
                field="start",
                value=self.start.isoformat(),
                accepted="e.g. 2022-05-14T00:00:00Z",
            )
        if self.step_s < 1 or self.duration_s < self.step_s or self.duration_s % self.step_s:
            raise DomainError(
                f"step_s {self.step_s} does not divide duration_s {self.duration_s}.",
                field="step_s",
                value=self.step_s,
                accepted="whole seconds, at least 1, that divide duration_s",
            )
        object.__setattr__(self, "start", self.start.astimezone(UTC))

    @property
    def count(self) -> int:
        """Images: the steps in [start, end)."""
        return self.duration_s // self.step_s

    @property
    def days(self) -> int:
        """Days begun: 1 for a horizon of a day."""
        return -(-self.duration_s // 86400)

    def times(self, index: NDArray[np.int32]) -> pd.DatetimeIndex:
        """Times (UTC, ms) of step numbers."""
        return self.at(index.astype(np.int64) * (self.step_s * 1000))

    def at(self, milliseconds: NDArray[np.int64]) -> pd.DatetimeIndex:
        """Times (UTC, ms) of milliseconds after the start."""
        start_ms = np.datetime64(self.start.replace(tzinfo=None), "ms")
        return pd.DatetimeIndex(start_ms + milliseconds.astype("timedelta64[ms]")).tz_localize("UTC")
