"""SP3 orbit files (versions a to d; Hilla 2016, The Extended Standard Product 3 Orbit Format) of GNSS and others."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from services.access.horizon import FIRST_YEAR, LAST_YEAR
from services.access.orbits.tabulated import (
    SLACK_S,
    Segment,
    TabulatedOrbit,
    as_datetime,
    refuse_impossible_radius,
    seconds_since,
)
from services.access.orbits.time_scales import SCALES, to_utc
from shared.errors import DomainError

GAP_STEPS = 1.5  # states further apart than that many steps have a gap between them
FEWEST_STATES = 10  # what a spline of degree 9 needs; fewer are no orbit on a step of 15 minutes
PREDICTED_COLUMN = 79
_CODE = re.compile(r"[A-Z ][A-Z0-9 ][A-Z0-9]$")  # G07, L12; " 7" is GPS in version a
# What the International GNSS Service states for its rapid and final orbits of GPS (2.5 cm); other centres agree with
# them to about 0.1 m, so the table's own error is put there for every file.
POSITION_ERROR_KM = 1e-4


@dataclass
class _Table:
    """The positions of one satellite as written, with the line of each; and the line that names it first."""

    first_line: int
    epoch: list[int] = field(default_factory=list)
    position: list[list[float]] = field(default_factory=list)
    line: list[int] = field(default_factory=list)
    predicted: list[bool] = field(default_factory=list)


def read_sp3(text: str, name: str) -> list[TabulatedOrbit]:
    """The orbits of an SP3 file, or of several one after the other, one for each satellite, in ITRF.

    A missing position (all zeros, or no record) begins a new segment: a gap. A satellite without a run of ten positions
    has no segment. An epoch repeated where one file ends and the next begins counts once. Raises DomainError naming
    ``name`` and the line: a broken epoch or position, epochs that do not increase, a satellite twice at one epoch, an
    unknown time scale.
    """
    epochs: list[str] = []
    epoch_lines: list[int] = []
    tables: dict[str, _Table] = {}
    scale = "GPS"
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("%c") and line[9:12].strip() not in ("", "ccc"):
            scale = _scale(line[9:12], number, name)
        elif line.startswith("*"):
            epochs.append(_epoch(line, number, name))
            epoch_lines.append(number)
        elif line.startswith("P"):
            if not epochs:
                raise _fault(name, number, "a position before the first epoch", line)
            _record(tables, line, number, len(epochs) - 1, name)
    if not epochs or not tables:
        raise DomainError(f"{name}: an SP3 file without positions.", field=name, accepted="epoch and P records")
    times = _times(epochs, epoch_lines, scale, name)
    step_s = float(np.median(np.diff(times).astype(np.int64))) / 1e6 if len(times) > 1 else 0.0
    return [_orbit(code, table, times, step_s, name) for code, table in sorted(tables.items())]


def join_files(orbits: Iterable[TabulatedOrbit]) -> list[TabulatedOrbit]:
    """Orbits from several files, daily ones say: those of one name that follow each other as one orbit.

    Runs of positions go on over the join where no more than a step lies between; a state at the same time in both
    counts once. Orbits that overlap by more stay apart, to be refused as given twice.
    """
    by_name: dict[str, list[TabulatedOrbit]] = {}
    for orbit in orbits:
        by_name.setdefault(orbit.name, []).append(orbit)
    return [joined for same in by_name.values() for joined in _joined(same)]


def _joined(same: list[TabulatedOrbit]) -> list[TabulatedOrbit]:
    parts = sorted((orbit for orbit in same if orbit.segments), key=lambda orbit: orbit.first)
    slack = timedelta(seconds=SLACK_S)
    if not parts or any(after.first < before.last - slack for before, after in itertools.pairwise(parts)):
        return same
    reference = parts[0].reference
    segments: list[Segment] = []
    for orbit in parts:
        shift_s = (orbit.reference - reference) / timedelta(seconds=1)
        for segment in orbit.segments:
            moved = replace(
                segment,
                times_s=segment.times_s + shift_s,
                first_s=segment.first_s + shift_s,
                last_s=segment.last_s + shift_s,
            )
            segments[-1:] = _one_run(segments[-1], moved) if segments else [moved]
    known = max((orbit.epoch for orbit in parts if orbit.epoch is not None), default=None)
    where = " and ".join(orbit.where for orbit in parts)
    return [replace(parts[0], epoch=known, segments=tuple(segments), where=where)]


def _one_run(before: Segment, after: Segment) -> list[Segment]:
    """Two runs as one where no more than a step lies between; else the two."""
    step_s = float(np.median(np.diff(before.times_s)))
    if after.first_s - before.last_s > GAP_STEPS * step_s:
        return [before, after]
    new = after.times_s > before.last_s + SLACK_S
    return [
        Segment(
            np.concatenate([before.times_s, after.times_s[new]]),
            np.concatenate([before.position_m, after.position_m[new]]),
            before.first_s,
            after.last_s,
            f"{before.where} and {after.where}",
        )
    ]


def _scale(text: str, number: int, name: str) -> str:
    if text not in SCALES:
        raise DomainError(
            f"{name}: line {number}: time scale {text} is not known.",
            field=name,
            value=text,
            accepted=", ".join(SCALES),
        )
    return text


def _epoch(line: str, number: int, name: str) -> str:
    try:
        year, month, day, hour, minute = (int(part) for part in line[1:].split()[:5])
        seconds = float(line[1:].split()[5])
        moment = datetime(year, month, day, hour, minute) + timedelta(seconds=seconds)
        if not FIRST_YEAR <= moment.year <= LAST_YEAR:
            raise ValueError("no time of satellites")
    except (ValueError, IndexError, OverflowError) as error:
        raise _fault(name, number, "not an epoch", line) from error
    return moment.isoformat()


def _record(tables: dict[str, _Table], line: str, number: int, epoch: int, name: str) -> None:
    if not _CODE.match(line[1:4]):
        raise _fault(name, number, f"'{line[1:4]}' is not a satellite's code", line)
    code = line[1:4].replace(" ", "0") if line[1] != " " else "G" + line[2:4].replace(" ", "0")
    try:
        position = [float(line[column : column + 14]) * 1000.0 for column in (4, 18, 32)]
    except ValueError as error:
        raise _fault(name, number, "not a position", line) from error
    table = tables.setdefault(code, _Table(number))
    if table.epoch and table.epoch[-1] == epoch:
        raise _fault(name, number, f"{code} is given twice at one epoch, first in line {table.line[-1]}", line)
    if not any(position) or not np.all(np.isfinite(position)):
        return  # the format's way to say that there is none
    table.epoch.append(epoch)
    table.position.append(position)
    table.line.append(number)
    table.predicted.append(line[PREDICTED_COLUMN : PREDICTED_COLUMN + 1] == "P")


def _times(epochs: Sequence[str], lines: Sequence[int], scale: str, name: str) -> NDArray[np.datetime64]:
    times = to_utc(np.array(epochs, dtype="datetime64[us]"), scale)
    back = np.flatnonzero(np.diff(times) < np.timedelta64(0, "us"))
    if len(back):
        raise _fault(name, lines[int(back[0]) + 1], "an epoch before the one above", epochs[int(back[0]) + 1])
    return times


def _orbit(code: str, table: _Table, times: NDArray[np.datetime64], step_s: float, name: str) -> TabulatedOrbit:
    if not table.epoch:
        return TabulatedOrbit(
            code, "sp3", None, as_datetime(times[0]), (), f"line {table.first_line}", POSITION_ERROR_KM
        )
    own = times[table.epoch]
    kept = np.flatnonzero(np.diff(own, prepend=own[0] - np.timedelta64(1, "s")) > np.timedelta64(0, "us"))
    position, line = np.array(table.position)[kept], np.array(table.line)[kept]
    refuse_impossible_radius(position, line.tolist(), name)
    reference = own[0]
    t_s = seconds_since(reference, own[kept])
    breaks = np.flatnonzero(np.diff(t_s) > GAP_STEPS * step_s) + 1
    runs = [rows for rows in np.split(np.arange(len(t_s)), breaks) if len(rows) >= FEWEST_STATES]
    segments = [
        Segment(
            t_s[rows],
            position[rows],
            float(t_s[rows[0]]),
            float(t_s[rows[-1]]),
            f"lines {line[rows[0]]} to {line[rows[-1]]}",
        )
        for rows in runs
    ]
    observed = np.flatnonzero(~np.array(table.predicted)[kept])
    known = own[kept][observed[-1]] if len(observed) else own[0]
    where = f"lines {line[0]} to {line[-1]}"
    return TabulatedOrbit(
        code, "sp3", as_datetime(known), as_datetime(reference), tuple(segments), where, POSITION_ERROR_KM
    )


def _fault(name: str, number: int, what: str, line: str) -> DomainError:
    return DomainError(
        f"{name}: line {number}: {what}.", field=name, value=line.strip()[:80], accepted="records of the SP3 format"
    )
