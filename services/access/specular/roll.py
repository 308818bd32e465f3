"""The roll of satellites over time, as a table gives it: how far the beams are turned at each instant."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from shared.errors import DomainError

Array = NDArray[np.float64]

LARGEST_DEG = 90.0


@dataclass(frozen=True)
class Roll:
    """Roll angles (n,) in degrees at rising seconds after the start; positive takes starboard down."""

    time_s: Array
    roll_deg: Array

    def at(self, t_s: Array) -> Array:
        """Roll (k,): straight lines between the given times, the first and last angle held beyond them."""
        return np.interp(t_s, self.time_s, self.roll_deg)


def read_rolls(table: pd.DataFrame, satellites: Collection[str], start: datetime) -> dict[str, Roll]:
    """Rolls by satellite from a table ``satellite, time, roll_deg``; satellites without rows do not roll.

    DomainError naming the row for a missing column or value, a satellite that is no receiver, an angle over 90 degrees,
    or two angles for a satellite at one time.
    """
    for name in ("satellite", "time", "roll_deg"):
        if name not in table.columns:
            raise _fault(f"the table lacks the column {name}", None)
    try:
        time = pd.to_datetime(table["time"], utc=True, format="ISO8601")
        angle = pd.to_numeric(table["roll_deg"]).to_numpy(np.float64)
    except (TypeError, ValueError) as error:
        raise _fault(f"times or angles cannot be read ({error})", None) from error
    seconds = ((time - pd.Timestamp(start)) / pd.Timedelta(seconds=1)).to_numpy(np.float64)
    bad = ~(np.isfinite(seconds) & (np.abs(angle) <= LARGEST_DEG))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise _fault(f"row {row}: time {table['time'].iloc[row]}, roll_deg {table['roll_deg'].iloc[row]}", row)
    unnamed = [row for row, satellite in enumerate(table["satellite"]) if not isinstance(satellite, str)]
    if unnamed:
        raise _fault(f"row {unnamed[0]}: {table['satellite'].iloc[unnamed[0]]} is no satellite's name", unnamed[0])
    rolls: dict[str, Roll] = {}
    for satellite, rows in table.reset_index(drop=True).groupby("satellite", sort=True).groups.items():
        index = np.asarray(rows)
        if satellite not in satellites:
            raise _fault(f"row {index[0]}: {satellite} is not among the receivers", int(index[0]))
        order = index[np.argsort(seconds[index], kind="stable")]
        twice = np.flatnonzero(np.diff(seconds[order]) == 0)
        if len(twice):
            row = int(order[twice[0] + 1])
            raise _fault(f"row {row}: a second angle for {satellite} at {table['time'].iloc[row]}", row)
        rolls[str(satellite)] = Roll(seconds[order], angle[order])
    return rolls


def _fault(what: str, row: int | None) -> DomainError:
    return DomainError(
        f"satellite_roll: {what}.",
        field="satellite_roll",
        value=row,
        accepted="satellite (a receiver), time (UTC), roll_deg (-90..90); one angle a satellite and time",
    )
