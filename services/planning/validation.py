"""What a planning case must satisfy before anything is solved; every refusal names the field, the row and the cure."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from services.planning.problem import SatelliteLimits
from shared.errors import DomainError

LONGEST_HORIZON_S = 14 * 86_400
"""Plans are exact to the second: beyond two weeks memory, not the solver, would be what fails."""


def seconds_from(start: pd.Timestamp, times: pd.Series) -> np.ndarray:
    """Seconds (float, exact to the microsecond) from ``start`` to each time."""
    stamps = pd.to_datetime(times, utc=True).dt.as_unit("us").to_numpy("datetime64[us]")
    if np.isnat(stamps).any():
        raise DomainError(f"column '{times.name}' holds a missing time", field=str(times.name), accepted="UTC times")
    origin = start.tz_convert("UTC").tz_localize(None).to_datetime64().astype("datetime64[us]")
    return np.asarray((stamps - origin).astype("int64") / 1e6)


def check_horizon(horizon_s: int) -> None:
    """A horizon of at least a second and at most two weeks."""
    if horizon_s <= 0:
        raise DomainError("the horizon is empty", field="spacecraft.horizon_s", value=horizon_s, accepted="> 0 seconds")
    if horizon_s > LONGEST_HORIZON_S:
        raise DomainError(
            "the horizon is too long to plan to the second", field="spacecraft.horizon_s", value=horizon_s,
            accepted=f"<= {LONGEST_HORIZON_S} seconds",
        )  # fmt: skip


def check_limits(limits: SatelliteLimits) -> SatelliteLimits:
    """Battery between floor and capacity, storage not overfull, every figure finite."""
    name = limits.name
    for field, value in vars(limits).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise DomainError(f"{name} has no usable {field}", field=f"spacecraft.{field}", value=value,
                              accepted="a finite number")  # fmt: skip
    if limits.battery_initial_wh < limits.battery_min_wh:
        raise DomainError(
            f"the battery of {name} starts below its floor", field="spacecraft.battery_initial_wh",
            value=limits.battery_initial_wh, accepted=f">= battery_min_wh ({limits.battery_min_wh:g} Wh)",
        )  # fmt: skip
    if limits.battery_initial_wh > limits.battery_capacity_wh:
        raise DomainError(
            f"the battery of {name} starts above its capacity", field="spacecraft.battery_initial_wh",
            value=limits.battery_initial_wh, accepted=f"<= battery_capacity_wh ({limits.battery_capacity_wh:g} Wh)",
        )  # fmt: skip
    if not 0 <= limits.stored_images_initial <= limits.storage_images:
        raise DomainError(
            f"{name} starts with more images than it can store", field="spacecraft.stored_images_initial",
            value=limits.stored_images_initial, accepted=f"0..{limits.storage_images}",
        )  # fmt: skip
    for begin, end in limits.unavailable:
        if end <= begin:
            raise DomainError(
                f"a window in which {name} is unavailable ends before it starts", field="spacecraft.unavailable",
                value=f"{end - begin:g} s long", accepted="end > start",
            )  # fmt: skip
    return limits


def check_windows(table: pd.DataFrame, name: str, *, empty_allowed: bool = True) -> None:
    """No row of a table of intervals ends before it starts."""
    bad = (table["end"] < table["start"]) if empty_allowed else (table["end"] <= table["start"])
    if bad.any():
        row = int(np.flatnonzero(bad.to_numpy())[0])
        raise DomainError(
            f"row {row} of {name} ends before it starts", field=f"{name}.end", value=str(table["end"].iloc[row]),
            accepted=f"{'>=' if empty_allowed else '>'} its start, {table['start'].iloc[row]}",
        )  # fmt: skip


def check_overlaps(contacts: pd.DataFrame) -> None:
    """Contacts of one satellite with one station do not overlap."""
    frame = contacts.sort_values(["satellite", "station", "start", "end"])
    satellite, station = frame["satellite"].astype(str), frame["station"].astype(str)
    same = (satellite == satellite.shift()) & (station == station.shift())
    overlap = same & (frame["start"] < frame["end"].shift())
    if overlap.any():
        row = frame[overlap].iloc[0]
        raise DomainError(
            f"contacts of {row['satellite']} with {row['station']} overlap", field="contacts.start",
            value=pd.Timestamp(row["start"]).isoformat(),
            accepted="one contact of a satellite with a station at a time",
        )  # fmt: skip


def check_slews(slew: Mapping[str, Mapping[str, int]] | None, pointings: tuple[str, ...]) -> None:
    """Every turn between two pointings of the opportunities has its seconds."""
    for source in pointings:
        for target in pointings:
            if source != target and (slew or {}).get(source, {}).get(target) is None:
                raise DomainError(
                    f"the slew table has no time for {source} to {target}", field="spacecraft.slew",
                    value=f"{source} -> {target}", accepted=f"seconds for every turn between {', '.join(pointings)}",
                )  # fmt: skip
