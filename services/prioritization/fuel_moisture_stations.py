"""Stations that measure 10-h fuel moisture: which of their values can be true, and how the filter sees their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.weather import WeatherGrid
from shared.errors import DomainError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FilterNoise:
    """Variances of the filter, per cent squared (per hour for the process noise); one value a state component.

    Components: 1-h, 10-h, 100-h moisture, equilibrium error. ``gate``: innovations beyond so many standard deviations
    are a station gone mad, which then owes ``probation`` plausible values before it is believed again. ``reach_km``:
    how far a station speaks; its error grows by ``km_sd_pct`` per 10 km.
    """

    initial: tuple[float, float, float, float] = (9.0, 16.0, 25.0, 4.0)
    process: tuple[float, float, float, float] = (0.5, 0.1, 0.01, 0.03)
    observation_sd_pct: float = 1.5
    gate: float = 4.0
    reach_km: float = 75.0
    km_sd_pct: float = 0.4
    stuck_hours: int = 24
    probation: int = 3


@dataclass(frozen=True)
class StationObservations:
    """10-h moisture at stations: per observation its hour index in the run, place, value and standard deviation."""

    hour: npt.NDArray[np.int64]
    longitude_deg: Array
    latitude_deg: Array
    moisture_pct: Array
    sd_pct: Array


def screened(
    observations: StationObservations | None, noise: FilterNoise
) -> tuple[StationObservations | None, dict[str, int]]:
    """Observations that can be true: finite, 1-120 %, and not one value repeated for a day (a stuck sensor)."""
    if observations is None:
        return None, {}
    frame = pd.DataFrame({name: getattr(observations, name) for name in StationObservations.__dataclass_fields__})
    impossible = ~frame["moisture_pct"].between(1, 120)
    frame = frame[~impossible].sort_values(["longitude_deg", "latitude_deg", "hour"], kind="stable")
    place = frame.groupby(["longitude_deg", "latitude_deg"], sort=False).ngroup()
    change = (frame["moisture_pct"].diff() != 0) | (place.diff() != 0)
    run_length = frame.groupby(change.cumsum())["hour"].transform("size")
    stuck = run_length >= noise.stuck_hours
    kept = frame[~stuck].sort_values(["hour", "longitude_deg", "latitude_deg"], kind="stable")
    screened = StationObservations(**{name: kept[name].to_numpy() for name in kept.columns})
    return screened, {"impossible": int(impossible.sum()), "stuck sensor": int(stuck.sum())}


def at_hours(
    table: pd.DataFrame, grid: WeatherGrid, time: pd.Timestamp, noise: FilterNoise
) -> tuple[StationObservations, dict[str, int]]:
    """Observations up to ``time`` at the grid's hours and on it, and how many were left out for what reason."""
    for name in ("time", "geometry", "fuel_moisture_10h_pct"):
        if name not in table.columns:
            raise DomainError(
                f"The observations lack the column '{name}'.",
                field="observations",
                value=name,
                accepted="time, geometry, fuel_moisture_10h_pct, optionally fuel_moisture_sd_pct",
            )
    known = table[table["time"] <= time]
    instants = known["time"].dt.tz_convert("UTC").dt.tz_localize(None).to_numpy().astype("datetime64[ns]")
    index = np.searchsorted(grid.time + np.timedelta64(30, "m"), instants)
    near = index < len(grid.time)
    near[near] &= np.abs(grid.time[index[near]] - instants[near]) <= np.timedelta64(30, "m")
    x, y = known.geometry.x.to_numpy(), known.geometry.y.to_numpy()
    beside = ~(_within(x, grid.longitude_deg) & _within(y, grid.latitude_deg))
    unused = {
        "after the cut-off": len(table) - len(known),
        "no weather at that hour": int((~near & ~beside).sum()),
        "outside the grid": int(beside.sum()),
    }
    near &= ~beside
    rows = known[near]
    sd = rows.get("fuel_moisture_sd_pct", pd.Series(noise.observation_sd_pct, index=rows.index))
    observations = StationObservations(
        index[near].astype(np.int64),
        rows.geometry.x.to_numpy(),
        rows.geometry.y.to_numpy(),
        rows["fuel_moisture_10h_pct"].to_numpy(dtype=np.float64),
        sd.to_numpy(dtype=np.float64),
    )
    return observations, unused


def _within(place: Array, axis: Array) -> npt.NDArray[np.bool_]:
    """Whether places lie on a grid's axis, half a cell beyond its ends included."""
    half = np.abs(np.diff(axis)).max() / 2 if len(axis) > 1 else 0.5
    return (place >= axis.min() - half) & (place <= axis.max() + half)
