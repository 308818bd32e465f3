"""What a result says of the orbits it rests on: their age, how exact they are where that is known, and warnings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

from services.access.orbits.elements import ElementSet
from services.access.orbits.formats import Orbit
from services.access.orbits.tabulated import TabulatedOrbit

OLD_DAYS = 7.0
# Elements of 2022-12-03..05, day of 2022-12-04, 31 satellites, nearly all of it along the track (2.2 km rms; 0.15 km
# across and upwards) and alike at all ages measured; tests/bench/bench_access.py measures the median again.
GPS_POSITION_ERROR = {
    "median_km": 1.3,
    "p95_km": 4.2,
    "max_km": 4.9,
    "against": "IGS rapid orbits of 2022-12-04, 31 satellites by SGP4",
}
GPS_AGES_DAYS = (-1.5, 1.5)  # measured from -1.0 to 1.3


def orbit_row(orbit: Orbit, start: datetime, interpolation_m: Mapping[str, float]) -> dict[str, Any]:
    """One satellite in the report. ``age_days`` is signed: negative where the epoch lies after the start.

    The epoch of elements is their own; of a table the time it was made (OEM) or until which it rests on observations
    (SP3), null where the file does not say. ``expected_position_error_km`` is null where nothing is known.
    """
    age = orbit.age_days(start)
    row: dict[str, Any] = {
        "satellite": orbit.name,
        "catalogue_number": orbit.catalogue_number,
        "source": orbit.source,
        "where": orbit.where,
        "epoch": None if orbit.epoch is None else orbit.epoch.isoformat(),
        "age_days": None if age is None else round(age, 3),
        "newer_than_start": age is not None and age < 0.0,
        "expected_position_error_km": expected_error_km(orbit, start),
    }
    if isinstance(orbit, TabulatedOrbit):
        row |= {
            "ephemeris_start": orbit.first.isoformat(),
            "ephemeris_end": orbit.last.isoformat(),
            "interpolation_error_m": round(interpolation_m.get(orbit.name, 0.0), 4),
        }
    return row


def expected_error_km(orbit: Orbit, start: datetime) -> dict[str, Any] | None:
    """How far from the truth the positions are expected to lie; None where that is not known.

    Known: GPS by SGP4 at the ages that were measured, and SP3 tables.
    """
    if isinstance(orbit, TabulatedOrbit):
        error = orbit.position_error_km
        return None if error is None else {"max_km": error, "against": "agreement of the analysis centres of the IGS"}
    measured = GPS_AGES_DAYS[0] <= orbit.age_days(start) <= GPS_AGES_DAYS[1]
    is_gps = orbit.name[:1] == "G" and orbit.name[1:].isdigit()
    return dict(GPS_POSITION_ERROR) if is_gps and measured else None


def orbit_warnings(orbits: Iterable[Orbit], start: datetime) -> list[str]:
    """A line for each satellite whose elements are older than a week or newer than the start of the horizon."""
    found = []
    for orbit in orbits:
        age = orbit.age_days(start)
        if age is None:
            continue
        if age < 0.0:
            found.append(_newer(orbit, age))
        elif age > OLD_DAYS:
            found.append(f"{orbit.name}: {_what(orbit)} ({orbit.where}) is {age:.1f} days old at the start")
    return found


def _newer(orbit: Orbit, age: float) -> str:
    return (
        f"{orbit.name}: {_what(orbit)} ({orbit.where}) is newer than the start of the horizon (age {age:+.3f} days): "
        "it was not known then"
    )


def _what(orbit: Orbit) -> str:
    when = f"{orbit.epoch:%Y-%m-%dT%H:%M:%SZ}"
    if isinstance(orbit, ElementSet):
        return f"the element set of {when}"
    return f"the ephemeris made at {when}" if orbit.source == "oem" else f"the orbit observed until {when}"
