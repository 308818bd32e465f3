"""What the satellites do with a schedule: images collected, sent down first in first out, or lost; the battery."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from shared.contracts.spacecraft import SatelliteState, Spacecraft

AS_RUN_COLUMNS = ["satellite", "start", "end", "image_id", "status", "downlinked_at", "station"]


@dataclass(frozen=True)
class Execution:
    """The schedule as executed (contract ``as_run``) and each satellite's state at the end."""

    as_run: pd.DataFrame
    states: dict[str, SatelliteState]


def execute_schedule(
    schedule: pd.DataFrame,
    carried: pd.DataFrame,
    eclipses: pd.DataFrame,
    spacecraft: Spacecraft,
    duration_s: int,
    loss_share: float,
    fleet: Iterable[str] = (),
) -> Execution:
    """Execute the first ``duration_s`` seconds after ``spacecraft.horizon_start``.

    ``carried`` holds the images still on board from before (contract ``as_run``, status ``collected``). A share of the
    downlinked images is lost in transmission, chosen by a hash of satellite and time, so that it is the same each time.
    A downlink that the end cuts short starts anew in the next span. ``fleet`` names satellites that may have no
    command: their batteries run on all the same. Images that a satellite holds from before the first cycle (its
    ``stored_images_initial``) are sent first, and known to nobody here.
    """
    commanded = set(schedule["satellite"]) | set(carried["satellite"])
    satellites = sorted(commanded | set(spacecraft.satellites) | set(fleet))
    rows: list[dict[str, Any]] = []
    states = {}
    for name in satellites:
        commands = _commands(schedule, name, spacecraft.horizon_start, duration_s)
        images, stored = _run_images(name, commands, carried[carried["satellite"] == name], spacecraft, loss_share)
        rows += images
        charge = battery_after(commands, eclipses[eclipses["satellite"] == name], spacecraft, name, duration_s)
        state = {"stored_images_initial": stored, "battery_initial_wh": round(charge, 6)}
        states[name] = spacecraft.satellites.get(name, SatelliteState()).model_copy(update=state)
    as_run = pd.DataFrame(rows, columns=AS_RUN_COLUMNS).sort_values(["satellite", "start"], ignore_index=True)
    return Execution(as_run, states)


def _commands(schedule: pd.DataFrame, satellite: str, start: datetime, duration_s: int) -> pd.DataFrame:
    """The satellite's commands with seconds from the start as ``first`` and ``last`` (half-open), cut at the end."""
    own = schedule[schedule["satellite"] == satellite].sort_values("start")
    origin = pd.Timestamp(start)
    first = ((own["start"] - origin) / pd.Timedelta(seconds=1)).round().astype(int)
    last = ((own["end"] - origin) / pd.Timedelta(seconds=1)).round().astype(int).clip(upper=duration_s)
    own = own.assign(first=first, last=last)
    return own[(own["first"] >= 0) & (own["first"] < own["last"])]


def _run_images(
    satellite: str, commands: pd.DataFrame, carried: pd.DataFrame, spacecraft: Spacecraft, loss_share: float
) -> tuple[list[dict[str, Any]], int]:
    rows = [_image(satellite, row.start, row.end, row.image_id) for row in carried.sort_values("start").itertuples()]
    unknown = (spacecraft.for_satellite(satellite).stored_images_initial or 0) - len(rows)
    before = pd.Timestamp(spacecraft.horizon_start)
    queue: deque[dict[str, Any]] = deque([_image(satellite, before, before, -1) for _ in range(max(unknown, 0))] + rows)
    progress_s = 0
    for command in commands.itertuples():
        if command.command == "collect":
            image = _image(satellite, command.start, command.end, command.image_id)
            rows.append(image)
            if len(queue) < spacecraft.storage_images:
                queue.append(image)
            else:
                image["status"] = "lost"  # only a plan made without knowing what is on board fills storage twice
            continue
        for second in range(command.first, command.last):
            if not queue:
                break  # the plan was checked; a lost image cannot empty the queue early, so nothing is left to send
            progress_s += 1
            if progress_s == spacecraft.downlink_s_per_image:
                progress_s = 0
                image = queue.popleft()
                lost = is_lost(satellite, image["start"], loss_share)
                at = pd.Timestamp(spacecraft.horizon_start) + pd.Timedelta(seconds=second + 1)
                image.update(status="lost" if lost else "downlinked", downlinked_at=at, station=command.station)
    return rows, len(queue)


def _image(satellite: str, start: pd.Timestamp, end: pd.Timestamp, image_id: int) -> dict[str, Any]:
    row = {"satellite": satellite, "start": start, "end": end, "image_id": int(image_id), "status": "collected"}
    return {**row, "downlinked_at": pd.NaT, "station": None}


def is_lost(satellite: str, start: pd.Timestamp, loss_share: float) -> bool:
    """Whether this image is lost in transmission: a fixed draw for satellite and time."""
    digest = hashlib.sha256(f"{satellite} {start.isoformat()}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2**64 < loss_share


def battery_after(
    commands: pd.DataFrame, eclipses: pd.DataFrame, spacecraft: Spacecraft, satellite: str, duration_s: int
) -> float:
    """Charge in Wh after the span: min(capacity, b + net/3600) second by second, in closed form.

    With the running sum c of the net charge, b(t) = c(t) + min(b0, min over s <= t of (capacity - c(s))).
    """
    net_w = np.full(duration_s, spacecraft.generation_w - spacecraft.nominal_w)
    net_w[_umbra_seconds(eclipses, spacecraft.horizon_start, duration_s)] -= spacecraft.generation_w
    for command in commands.itertuples():
        extra = spacecraft.collect_w if command.command == "collect" else spacecraft.downlink_w
        net_w[command.first : command.last] -= extra
    running = np.cumsum(net_w) / 3600.0
    initial = spacecraft.for_satellite(satellite).battery_initial_wh
    assert initial is not None
    if duration_s == 0:
        return float(initial)
    return float(running[-1] + min(initial, float(np.min(spacecraft.battery_capacity_wh - running))))


def _umbra_seconds(eclipses: pd.DataFrame, start: datetime, duration_s: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Seconds of which any part lies in umbra."""
    dark = np.zeros(duration_s, dtype=bool)
    umbra = eclipses if "kind" not in eclipses else eclipses[eclipses["kind"] != "penumbra"]
    origin = pd.Timestamp(start)
    for row in umbra.itertuples():
        first = np.floor((row.start - origin) / pd.Timedelta(seconds=1))
        last = np.ceil((row.end - origin) / pd.Timedelta(seconds=1))
        dark[max(int(first), 0) : max(int(last), 0)] = True
    return dark
