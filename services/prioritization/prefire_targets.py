"""Pre-fire targets: the danger grid on its lattice, priced by the worst day within the horizon and by staleness."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization import observation_age, reward
from services.prioritization.lattice import KM_PER_DEGREE, Lattice
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

SMALLEST_PRIORITY = 1e-4
REACH_KM = 5.0


def prefire_targets(
    danger: xr.Dataset,
    active: pd.DataFrame,
    observed: pd.DataFrame | None,
    area: tuple[float, float, float, float],
    time: pd.Timestamp,
    horizon_h: float,
    lattice: Lattice,
    keep_out_km: float,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Target rows as for active fires, and a report. Masked and unknown places give none, nor do those of a fire.

    The reward rests on the ``_x`` layers, the worst of the lead days within ``horizon_h``; low and high are the
    smallest and largest over those days, with and without the satellites, and over the grid cells of the place.
    """
    cells = _cells(danger, area, lead_days(danger, time, horizon_h))
    frame = _places(cells, lattice, area)
    clear = ~_near_fire(frame, active, keep_out_km)
    in_fire = int((~clear).sum())
    frame = _priced(frame[clear].reset_index(drop=True), observed, time, lattice)
    report = {
        "targets": len(frame),
        "grid_cells_masked_or_unknown": int(cells.attrs["left_out"]),
        "places_left_to_active_fires": in_fire,
        "priority_largest": float(frame["priority"].max()) if len(frame) else 0.0,
        "lately_observed": int((frame["staleness"] < 0.999).sum()),
    }
    return frame, report


def _places(cells: pd.DataFrame, lattice: Lattice, area: tuple[float, float, float, float]) -> pd.DataFrame:
    """The lattice's places within the area, each with the mean worth of its grid cells and their extremes."""
    row, column = lattice.locate(cells["longitude_deg"].to_numpy(), cells["latitude_deg"].to_numpy())
    places = cells.assign(row=row, column=column).groupby(["row", "column"], as_index=False)
    frame = places.agg(
        worth=("worth", "mean"),
        worth_low=("worth_low", "min"),
        worth_high=("worth_high", "max"),
        grid_cells=("worth", "size"),
    ).reset_index(drop=True)
    frame["longitude_deg"], frame["latitude_deg"] = lattice.centre(frame["row"].to_numpy(), frame["column"].to_numpy())
    west, south, east, north = area
    return frame[frame["longitude_deg"].between(west, east) & frame["latitude_deg"].between(south, north)]


def _priced(frame: pd.DataFrame, observed: pd.DataFrame | None, time: pd.Timestamp, lattice: Lattice) -> pd.DataFrame:
    """Places as targets: reward with its interval, staleness, id; those worth next to nothing left out."""
    at = (frame["longitude_deg"].to_numpy(), frame["latitude_deg"].to_numpy())
    age = observation_age.age_h(*at, observed, time, max(REACH_KM, 0.71 * lattice.spacing_km))
    fresh = reward.staleness(age, "prefire")
    for name, worth in (("priority", "worth"), ("priority_low", "worth_low"), ("priority_high", "worth_high")):
        frame[name] = reward.prefire_reward(frame[worth].to_numpy(), fresh)
    frame["staleness"], frame["observed_age_h"] = fresh, age
    frame["target_id"] = lattice.target_id(frame["row"].to_numpy(), frame["column"].to_numpy())
    frame["source"] = "danger"
    return frame[frame["priority"] >= SMALLEST_PRIORITY].sort_values("target_id").reset_index(drop=True)


def lead_days(danger: xr.Dataset, time: pd.Timestamp, horizon_h: float) -> npt.NDArray[np.int64]:
    """Indices of the lead days (24 h each) that meet the ``horizon_h`` after ``time``; the first of an undated grid.

    DomainError if the grid begins after ``time`` (it knows what nobody knew) or ended before it.
    """
    if "lead_day_start" not in danger.variables:
        return np.arange(min(max(1, int(np.ceil(horizon_h / 24))), danger.sizes["lead_day"]))
    starts = pd.DatetimeIndex(danger["lead_day_start"].to_numpy()).tz_localize("UTC")
    end = time + pd.Timedelta(hours=horizon_h)
    days = np.flatnonzero((starts < end) & (starts + pd.Timedelta(days=1) > time))
    if starts[0] > time or not len(days):
        raise DomainError(
            f"The lead days of the danger grid, from {starts[0].isoformat()} to {starts[-1].isoformat()}, do not hold "
            f"{time.isoformat()}.",
            field="danger",
            value=starts[0].isoformat(),
            accepted="a danger grid made at or before the time, of lead days that reach it",
        )
    return days


def _cells(danger: xr.Dataset, area: tuple[float, float, float, float], days: npt.NDArray[np.int64]) -> pd.DataFrame:
    """Known, burnable grid cells within the area with their worth on those lead days and its extremes."""
    part = danger.isel(lead_day=days).transpose("lead_day", "latitude", "longitude", ...)
    seen = _worth(part, "_x")
    plain = _worth(part, "")
    latitude, longitude = np.meshgrid(part["latitude"].to_numpy(), part["longitude"].to_numpy(), indexing="ij")
    west, south, east, north = area
    margin = 0.5
    inside = (longitude >= west - margin) & (longitude <= east + margin)
    inside &= (latitude >= south - margin) & (latitude <= north + margin)
    known = np.isfinite(seen).any(axis=0) & (part["mask_code"].to_numpy() < 248)
    use = inside & known
    both = np.concatenate([seen, plain])[:, use]
    cells = pd.DataFrame(
        {
            "longitude_deg": longitude[use].astype(np.float64),
            "latitude_deg": latitude[use].astype(np.float64),
            "worth": np.nanmax(seen[:, use], axis=0, initial=0.0),
            "worth_low": np.nanmin(both, axis=0, initial=1.0),
            "worth_high": np.nanmax(both, axis=0, initial=0.0),
        }
    )
    cells.attrs["left_out"] = int((inside & ~known).sum())
    return cells


def _worth(part: xr.Dataset, suffix: str) -> Array:
    wfsp = part["wfsp" + suffix].to_numpy().astype(np.float64)
    return reward.danger_worth(wfsp, part["wlfp" + suffix].to_numpy().astype(np.float64))


def _near_fire(frame: pd.DataFrame, active: pd.DataFrame, keep_out_km: float) -> npt.NDArray[np.bool_]:
    if active.empty or frame.empty:
        return np.zeros(len(frame), dtype=bool)
    from scipy.spatial import cKDTree

    shrink = np.cos(np.radians(frame["latitude_deg"].mean()))
    scale = np.array([KM_PER_DEGREE * shrink, KM_PER_DEGREE])
    columns = ["longitude_deg", "latitude_deg"]
    distance_km, _ = cKDTree(active[columns].to_numpy() * scale).query(frame[columns].to_numpy() * scale)
    return distance_km <= keep_out_km
