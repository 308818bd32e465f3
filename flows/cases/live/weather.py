"""HRRR surface fields as the weather of a case: on a regular grid over its box, hour by hour."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial import cKDTree

from flows.cases.nature.setting import FloatArray
from flows.ingest.taking import Taken
from shared.errors import DomainError

FIELDS = {"2t": "temperature_k", "2r": "relative_humidity_pct", "10u": "east", "10v": "north", "tp": "rain_mm"}
FARTHEST_DEG = 0.5  # a node with no field value this near lies off the model's grid
_ZERO_C = 273.15


@dataclass(frozen=True)
class Moment:
    """The fields of one lead hour on the case's grid (latitude, longitude); ``rain_mm`` since the run began."""

    run: datetime
    valid: datetime
    fields: dict[str, FloatArray]


def read_moment(taken: Taken, longitude: FloatArray, latitude: FloatArray) -> Moment:
    """The GRIB messages of a kept lead hour at the nodes of a grid; DomainError where one of the fields is missing.

    Winds along the model's own axes are turned to east and north.
    """
    import eccodes

    fields: dict[str, FloatArray] = {}
    valid = taken.data_time
    nearest: np.ndarray | None = None
    with taken.path.open("rb") as stream:
        while (handle := eccodes.codes_grib_new_from_file(stream)) is not None:
            try:
                name = FIELDS.get(eccodes.codes_get(handle, "shortName"))
                if name is None:
                    continue
                if nearest is None:
                    nearest = _nearest(eccodes, handle, longitude, latitude)
                values = eccodes.codes_get_values(handle)[nearest]
                fields[name] = values.reshape(len(latitude), len(longitude))
                if name == "north" and eccodes.codes_get(handle, "uvRelativeToGrid"):
                    fields |= _turned(eccodes, handle, fields, longitude)
                if name == "temperature_k":
                    valid = _valid(eccodes, handle)
            finally:
                eccodes.codes_release(handle)
    lacking = [name for name in FIELDS.values() if name not in fields and name != "rain_mm"]
    if lacking:
        raise DomainError(f"{taken.path.name} lacks {', '.join(lacking)}.", field="weather", accepted=", ".join(FIELDS))
    fields.setdefault("rain_mm", np.zeros((len(latitude), len(longitude))))
    return Moment(taken.data_time, valid, fields)


def _valid(eccodes: Any, handle: Any) -> datetime:
    date, clock = (eccodes.codes_get(handle, name) for name in ("validityDate", "validityTime"))
    return datetime.strptime(f"{date:08d}{clock:04d}", "%Y%m%d%H%M").replace(tzinfo=UTC)


def _nearest(eccodes: Any, handle: Any, longitude: FloatArray, latitude: FloatArray) -> np.ndarray:
    """Index of the field value nearest to each node; DomainError where the box lies off the model's grid."""
    shrink = float(np.cos(np.radians(latitude.mean())))
    along = (eccodes.codes_get_array(handle, "longitudes") + 180) % 360 - 180
    tree = cKDTree(np.stack([along * shrink, eccodes.codes_get_array(handle, "latitudes")], axis=1))
    x, y = np.meshgrid(longitude, latitude)
    distance, found = tree.query(np.stack([x.ravel() * shrink, y.ravel()], axis=1))
    if distance.max() > FARTHEST_DEG:
        raise DomainError("The box lies off the weather model's grid.", field="area", accepted="a box inside its grid")
    return np.asarray(found)


def _turned(eccodes: Any, handle: Any, fields: dict[str, FloatArray], longitude: FloatArray) -> dict[str, FloatArray]:
    """Lambert conformal: the grid's north is turned from true north by sin(latitude of the cone) times the offset."""
    if eccodes.codes_get(handle, "gridType") != "lambert" or "east" not in fields:
        return {}
    cone = np.sin(np.radians(eccodes.codes_get(handle, "Latin1InDegrees")))
    offset = (longitude - eccodes.codes_get(handle, "LoVInDegrees") + 180) % 360 - 180
    turn = np.radians(cone * offset)[None, :]
    east, north = fields["east"], fields["north"]
    return {"east": east * np.cos(turn) + north * np.sin(turn), "north": north * np.cos(turn) - east * np.sin(turn)}


def hourly(moments: list[Moment]) -> tuple[list[datetime], dict[str, FloatArray]]:
    """Whole hours from the first moment to the last, straight lines between them, in the weather contract's terms."""
    ordered = sorted({moment.valid: moment for moment in sorted(moments, key=lambda m: m.run)}.values(), key=_when)
    at = np.array([_seconds(moment.valid) for moment in ordered])
    hours = np.arange(at[0], at[-1] + 1.0, 3600.0)
    stacks = {name: np.stack([moment.fields[name] for moment in ordered]) for name in ordered[0].fields}
    lines = {name: _between(at, stack, hours) for name, stack in stacks.items() if name != "rain_mm"}
    values = {
        "temperature_c": lines["temperature_k"] - _ZERO_C,
        "relative_humidity_pct": np.clip(lines["relative_humidity_pct"], 0.0, 100.0),
        "wind_speed_m_s": np.hypot(lines["east"], lines["north"]),
        "wind_direction_deg": np.degrees(np.arctan2(-lines["east"], -lines["north"])) % 360.0,
        "rain_mm": _rain(ordered, hours),
    }
    return [datetime.fromtimestamp(hour, UTC) for hour in hours], values


def _rain(ordered: list[Moment], hours: FloatArray) -> FloatArray:
    """Rain of the hour before each hour: what fell between two moments of one run, evenly; before it, none is known."""
    rain = np.zeros((len(hours), *ordered[0].fields["rain_mm"].shape))
    for before, after in pairwise(ordered):
        start = before.fields["rain_mm"] if before.run == after.run else np.zeros_like(before.fields["rain_mm"])
        first, last = _seconds(before.valid if before.run == after.run else after.run), _seconds(after.valid)
        fell = np.clip(after.fields["rain_mm"] - start, 0.0, None) / max((last - first) / 3600.0, 1.0)
        rain[(hours > _seconds(before.valid)) & (hours <= last)] = fell
    return rain


def _between(at: FloatArray, stack: FloatArray, hours: FloatArray) -> FloatArray:
    if len(at) == 1:
        return stack
    after = np.clip(np.searchsorted(at, hours, side="left"), 1, len(at) - 1)
    share = ((hours - at[after - 1]) / (at[after] - at[after - 1]))[:, None, None]
    return np.asarray((1 - share) * stack[after - 1] + share * stack[after])


def weather_datasets(
    moments: list[Moment], longitude: FloatArray, latitude: FloatArray
) -> tuple[xr.Dataset, xr.Dataset]:
    """Analysis (the newest run's first hour) and forecast (all its hours) of the weather contract's case form."""
    times, values = hourly(moments)
    issue = max(moment.run for moment in moments)
    axes = {"latitude": latitude, "longitude": longitude}
    rounded = {name: field.astype(np.float32) for name, field in values.items()}
    first = xr.Dataset(
        {name: (("time", *axes), field[:1]) for name, field in rounded.items()},
        coords={**axes, "time": [_plain(times[0])], "issued_at": ("time", [_plain(issue)])},
    )
    leads = np.arange(float(len(times)))
    ahead = xr.Dataset(
        {name: (("issue", "lead", *axes), field[None]) for name, field in rounded.items()},
        coords={
            **axes,
            "issue": [_plain(issue)],
            "lead": leads,
            "valid_at": (("issue", "lead"), [[_plain(time) for time in times]]),
        },
    )
    for dataset, names in ((first, ("time", "issued_at")), (ahead, ("issue", "valid_at"))):
        for name in names:
            dataset[name].encoding = {"units": "seconds since 2000-01-01 00:00:00", "dtype": "int64"}
    return first, ahead


def _plain(time: datetime) -> np.datetime64:
    return np.datetime64(time.astimezone(UTC).replace(tzinfo=None), "ns")


def _seconds(time: datetime) -> float:
    return time.timestamp()


def _when(moment: Moment) -> datetime:
    return moment.valid


def lead_files(folder: Path) -> list[str]:
    """The names of the kept lead hours: hrrr-f00, hrrr-f06, …"""
    return sorted(path.name for path in folder.glob("hrrr-f*") if path.is_dir())
