"""Which seconds of which contact a plan may use: outages, bookings, acquisition and nominal data's share taken off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from services.planning.options.rules import OperationRules
from services.planning.problem import Frozen, Pass


@dataclass(frozen=True)
class OpenPass:
    """A usable stretch of a contact: its first data second and end, and how many seconds raw-IF data may take."""

    satellite: int
    station: int
    start_s: int
    end_s: int
    tracked_from_s: int
    raw_if_s: int

    def whole(self) -> Pass:
        """All its data seconds."""
        return Pass(self.satellite, self.station, self.start_s, self.end_s)


def usable_contacts(contacts: pd.DataFrame, rules: OperationRules) -> pd.DataFrame:
    """Contacts cut by outages of their station or satellite, and to their bookings where those are demanded.

    Acquisition and nominal data do not shorten them: an uplink can use the whole of what is left here.
    """
    frame = _intervals(contacts)
    if rules.booked is not None:
        slots = _intervals(rules.booked).rename(columns={"start": "from", "end": "to"})
        frame = frame.merge(slots, on=["satellite", "station"])
        frame["start"], frame["end"] = frame[["start", "from"]].max(axis=1), frame[["end", "to"]].min(axis=1)
        frame = frame[frame["end"] > frame["start"]].drop(columns=["from", "to"])
    for outage in rules.outages:
        hit = frame["satellite"] == outage.satellite if outage.satellite else frame["station"] == outage.station
        end = frame["end"].max() if outage.end is None else outage.end
        head = frame[hit].assign(end=frame.loc[hit, "end"].clip(upper=outage.start))
        tail = frame[hit].assign(start=frame.loc[hit, "start"].clip(lower=end))
        parts = pd.concat([head, tail])
        frame = pd.concat([frame[~hit], parts[parts["end"] > parts["start"]]])
    return frame.drop_duplicates().sort_values(["satellite", "station", "start"]).reset_index(drop=True)


def _intervals(table: pd.DataFrame) -> pd.DataFrame:
    names = table[["satellite", "station"]].astype(str)
    times = {name: pd.to_datetime(table[name], utc=True) for name in ("start", "end")}
    return names.assign(**times).reset_index(drop=True)


def open_passes(
    starts: np.ndarray, ends: np.ndarray, satellite: np.ndarray, station: np.ndarray, rules: OperationRules,
    horizon_s: int,
) -> list[OpenPass]:  # fmt: skip
    """Passes of at least one whole data second inside the horizon; ``starts`` and ``ends`` in seconds."""
    passes = []
    for begin, end, s, g in zip(starts, ends, satellite, station, strict=True):
        first, last = max(0, math.ceil(begin + rules.acquisition_s)), min(horizon_s, math.floor(end))
        if last > first:
            raw_if = math.floor((1.0 - rules.nominal_share) * (end - begin) + 1e-9)
            passes.append(OpenPass(int(s), int(g), first, last, max(0, math.ceil(begin)), raw_if))
    return sorted(passes, key=lambda p: (p.satellite, p.start_s, p.station))


def shared_with_nominal(passes: list[OpenPass], frozen: Frozen) -> tuple[Pass, ...]:
    """Passes cut to one stretch of the seconds that nominal data leave, where fewest other satellites want the station.

    Seconds that the previous plan already downlinks in count against the share.
    """
    demand: dict[int, np.ndarray] = {}
    for p in passes:
        line = demand.setdefault(p.station, np.zeros(frozen.downlink.shape[1] + 1, np.int64))
        line[p.start_s] += 1
        line[p.end_s] -= 1
    load = {station: np.concatenate([[0], np.cumsum(np.cumsum(line))]) for station, line in demand.items()}
    narrowed = []
    for p in passes:
        own = np.flatnonzero(frozen.downlink[p.satellite, p.tracked_from_s : p.end_s] == p.station)
        begin = max(p.start_s, p.tracked_from_s + int(own[-1]) + 1) if len(own) else p.start_s
        room = min(p.raw_if_s - len(own), p.end_s - begin)
        if room <= 0:
            continue
        places = np.arange(begin, p.end_s - room + 1)
        wanted = load[p.station][places + room] - load[p.station][places]
        at = int(places[np.argmin(wanted)])
        narrowed.append(Pass(p.satellite, p.station, at, at + room))
    return tuple(narrowed)
