"""CCSDS orbit ephemeris messages (502.0-B-3), KVN and XML."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from services.access.orbits import ndm
from services.access.orbits.ndm import Keywords
from services.access.orbits.orientation import eme2000_to_gcrs, gcrs_to_itrf, orientation_at, teme_to_itrf
from services.access.orbits.tabulated import (
    Segment,
    TabulatedOrbit,
    as_datetime,
    refuse_impossible_radius,
    seconds_since,
)
from services.access.orbits.time_scales import SCALES, to_utc
from shared.errors import DomainError

Array = NDArray[np.float64]

EARTH_FIXED_FRAMES = ("ITRF", "ITRS", "IGS", "WGS84")  # with or without the year of a realisation: decimetres apart
MEAN_OF_2000 = ("EME2000", "J2000", "EARTHMJ2000EQ")  # the last is GMAT's name
CELESTIAL_FRAMES = ("EME2000", "J2000", "GCRF", "ICRF", "ICRF2", "ICRF3", "TEME")
FEWEST_STATES = 4
STATE_TAGS = ("EPOCH", "X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")


@dataclass
class _Part:
    """A segment as written: its metadata, and epoch and numbers of each state with their line."""

    meta: Keywords
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def read_oem_kvn(text: str, name: str) -> list[TabulatedOrbit]:
    """The orbits of an OEM text, one for each OBJECT_NAME, in ITRF.

    Frames EME2000, GCRF/ICRF, TEME and every ITRF; time scales UTC, GPS, TAI, TT, TDB. Raises DomainError naming
    ``name`` and the line: a missing or unknown keyword, a broken state, epochs that do not increase, velocities that
    do not belong to the positions, segments of one object that overlap.
    """
    header = Keywords(1)
    parts: list[_Part] = []
    mode = "header"
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        word = stripped.upper()
        if not stripped or word.startswith("COMMENT"):
            continue
        if word == "META_START":
            parts.append(_Part(Keywords(number)))
            mode = "meta"
        elif word == "META_STOP":
            mode = "data"
        elif word in ("COVARIANCE_START", "COVARIANCE_STOP"):
            mode = "covariance" if word.endswith("START") else "data"
        elif mode == "data" and "=" not in stripped:
            parts[-1].rows.append(stripped.split())
            parts[-1].lines.append(number)
        elif mode in ("header", "meta"):
            (header if mode == "header" else parts[-1].meta).put(*ndm.keyword_line(line, number, name), number)
        elif mode == "data":
            raise _fault(name, number, "a keyword among the states", stripped, "META_START before the next segment")
    return _orbits(header, parts, name)


def read_oem_xml(text: str, name: str) -> list[TabulatedOrbit]:
    """The same from an ``oem`` document, or the ``oem`` elements of an ``ndm`` one."""
    header = Keywords(1)
    parts: list[_Part] = []
    state: dict[str, str] | None = None
    for event in ndm.xml_events(text, name):
        tag = event.tag.upper()
        if event.kind == "start" and event.tag == "segment":
            parts.append(_Part(Keywords(event.line)))
        elif event.tag == "stateVector" and parts:
            if event.kind == "start":
                state = {}
            elif state is not None:
                parts[-1].rows.append([state.get(key, "") for key in STATE_TAGS])
                parts[-1].lines.append(event.line)
                state = None
        elif event.kind == "end" and event.text:
            if state is not None:
                state[tag] = event.text
            else:
                (parts[-1].meta if parts else header).put(tag, event.text, event.line)
    return _orbits(header, parts, name)


def _orbits(header: Keywords, parts: Sequence[_Part], name: str) -> list[TabulatedOrbit]:
    if not parts:
        raise _fault(name, 1, "an OEM without a segment", "", "META_START … META_STOP and states")
    made = _made(header, name)
    by_object: dict[str, list[_Part]] = {}
    for part in parts:
        for key in ("OBJECT_NAME", "REF_FRAME", "TIME_SYSTEM"):
            if not part.meta.get(key):
                raise _fault(name, part.meta.line, f"the segment lacks {key}", "", "the metadata of CCSDS OEM")
        by_object.setdefault(part.meta.get("OBJECT_NAME"), []).append(part)
    return [_orbit(title, of_object, made, name) for title, of_object in by_object.items()]


def _made(header: Keywords, name: str) -> datetime | None:
    text = header.get("CREATION_DATE")
    return as_datetime(ndm.epochs([text], [header.lines["CREATION_DATE"]], name)[0]) if text else None


def _orbit(title: str, parts: Sequence[_Part], made: datetime | None, name: str) -> TabulatedOrbit:
    _refuse_two_objects(parts, name)
    timed = sorted(((_utc(part, name), part) for part in parts), key=lambda pair: pair[0][0])
    reference = timed[0][0][0]
    segments = [_segment(part, times, reference, name) for times, part in timed]
    for before, after in itertools.pairwise(segments):
        if after.first_s < before.last_s - 1e-6:
            raise DomainError(
                f"{name}: {after.where}: the states of {title} overlap those of {before.where}.",
                field=name,
                value=title,
                accepted="one state of a satellite at a time; USEABLE_START_TIME and USEABLE_STOP_TIME to part them",
            )
    return TabulatedOrbit(title, "oem", made, as_datetime(reference), tuple(segments), segments[0].where)


def _refuse_two_objects(parts: Sequence[_Part], name: str) -> None:
    first = parts[0].meta
    for part in parts[1:]:
        if part.meta.get("OBJECT_ID") != first.get("OBJECT_ID"):
            raise _fault(
                name,
                part.meta.lines.get("OBJECT_ID", part.meta.line),
                f"{first.get('OBJECT_NAME')} is {first.get('OBJECT_ID')} in {first.where('OBJECT_ID')} and "
                f"{part.meta.get('OBJECT_ID') or 'not named'} here",
                part.meta.get("OBJECT_ID"),
                "one OBJECT_ID for each OBJECT_NAME",
            )


def _utc(part: _Part, name: str) -> NDArray[np.datetime64]:
    """Epochs of a segment's states in UTC, increasing."""
    meta = part.meta
    scale = meta.get("TIME_SYSTEM").upper()
    if scale not in SCALES:
        raise _fault(name, meta.lines["TIME_SYSTEM"], f"TIME_SYSTEM {scale} is not known", scale, ", ".join(SCALES))
    if meta.get("CENTER_NAME", "EARTH").upper() != "EARTH":
        raise _fault(name, meta.lines["CENTER_NAME"], "the centre is not the Earth", meta.get("CENTER_NAME"), "EARTH")
    if len(part.rows) < FEWEST_STATES:
        raise _fault(
            name, meta.line, f"a segment of {len(part.rows)} states", "", f"at least {FEWEST_STATES} states a segment"
        )
    times = to_utc(ndm.epochs([row[0] for row in part.rows], part.lines, name), scale)
    back = np.flatnonzero(np.diff(times) <= np.timedelta64(0, "us"))
    if len(back):
        row = int(back[0]) + 1
        raise _fault(name, part.lines[row], "the epoch does not lie after the one before", part.rows[row][0], "order")
    return times


def _segment(part: _Part, times: NDArray[np.datetime64], reference: np.datetime64, name: str) -> Segment:
    states = _numbers(part, name) * 1000.0
    t_s = seconds_since(reference, times)
    _refuse_foreign_velocity(t_s, states, part.lines, name)
    refuse_impossible_radius(states[:, :3], part.lines, name)
    position = _to_itrf(states, times, part.meta, name)
    first, last = float(t_s[0]), float(t_s[-1])
    for key in ("USEABLE_START_TIME", "USEABLE_STOP_TIME"):
        if part.meta.get(key):
            written = ndm.epochs([part.meta.get(key)], [part.meta.lines[key]], name)
            at = float(seconds_since(reference, to_utc(written, part.meta.get("TIME_SYSTEM").upper()))[0])
            first, last = (max(first, at), last) if "START" in key else (first, min(last, at))
    return Segment(t_s, position, first, last, f"lines {part.lines[0]} to {part.lines[-1]}")


def _numbers(part: _Part, name: str) -> Array:
    """Positions and velocities (n, 6); accelerations are left aside."""
    for row, line in zip(part.rows, part.lines, strict=True):
        if len(row) not in (7, 10):
            raise _fault(name, line, f"a state of {len(row)} columns", " ".join(row), "epoch, 3 km, 3 km/s")
    try:
        numbers = np.array([row[1:7] for row in part.rows], dtype=np.float64)
    except ValueError:
        numbers = np.array([[_number(text) for text in row[1:7]] for row in part.rows])
    bad = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    if len(bad):
        first = int(bad[0])
        text = " ".join(part.rows[first])
        raise _fault(name, part.lines[first], "a state that is no numbers", text, "epoch and numbers")
    return numbers


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _refuse_foreign_velocity(t_s: Array, states: Array, lines: Sequence[int], name: str) -> None:
    """The chord between neighbours must be the way that their velocities make, within what their curvature allows."""
    step = np.diff(t_s)[:, np.newaxis]
    mean = 0.5 * (states[1:, 3:] + states[:-1, 3:])
    chord = np.diff(states[:, :3], axis=0) / step
    allowed = 0.05 * np.linalg.norm(mean, axis=1) + np.linalg.norm(np.diff(states[:, 3:], axis=0), axis=1)
    bad = np.flatnonzero(~(np.linalg.norm(chord - mean, axis=1) <= allowed + 0.1))
    if len(bad):
        row = int(bad[0])
        raise _fault(
            name,
            lines[row + 1],
            f"the satellite moves {np.linalg.norm(chord[row]) / 1000.0:.3f} km/s to this state, and the velocities say "
            f"{np.linalg.norm(mean[row]) / 1000.0:.3f} km/s",
            None,
            "positions in km and velocities in km/s of one frame",
        )


def _to_itrf(states: Array, times: NDArray[np.datetime64], meta: Keywords, name: str) -> Array:
    frame = meta.get("REF_FRAME").upper().replace("-", "").replace("_", "")
    if frame.startswith(EARTH_FIXED_FRAMES):
        return states[:, :3]
    t_s = seconds_since(times[0], times)
    orientation = orientation_at(as_datetime(times[0]), float(t_s[-1]))
    position, velocity = states[:, :3], states[:, 3:]
    if frame in ("TEME", "TEMEOFDATE"):
        return teme_to_itrf(position, velocity, t_s, orientation)[0]
    if frame in MEAN_OF_2000:
        position, velocity = eme2000_to_gcrs(position), eme2000_to_gcrs(velocity)
    elif frame not in CELESTIAL_FRAMES:
        accepted = ", ".join((*CELESTIAL_FRAMES, "ITRF…"))
        raise _fault(name, meta.lines["REF_FRAME"], f"REF_FRAME {meta.get('REF_FRAME')} is not known", frame, accepted)
    return gcrs_to_itrf(position, velocity, t_s, orientation)[0]


def _fault(name: str, line: int, what: str, value: str | None, accepted: str) -> DomainError:
    return DomainError(f"{name}: line {line}: {what}.", field=name, value=(value or "")[:80], accepted=accepted)
