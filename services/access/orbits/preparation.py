"""From what the files hold to what a prediction uses: who is meant, who is usable, and what was left out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from services.access.orbits.constellations import CONSTELLATIONS, transmitter_code
from services.access.orbits.elements import ElementSet, refuse_duplicates, within_age
from services.access.orbits.ephemeris import Ephemeris, propagate
from services.access.orbits.formats import Orbit
from services.access.orbits.tabulated import TabulatedOrbit, interpolate
from shared.errors import DomainError

REASONS_TOLD = 3


@dataclass(frozen=True)
class Prepared:
    """The orbits used, in order of name, with their states; those left out: name -> reason; and the bounds (m) of the
    interpolation between given states, by name."""

    used: list[Orbit]
    ephemerides: list[Ephemeris]
    dropped: dict[str, str] = field(default_factory=dict)
    interpolation_m: dict[str, float] = field(default_factory=dict)


def name_transmitters(
    orbits: Iterable[Orbit], when: datetime, field: str = "transmitters"
) -> tuple[list[Orbit], dict[str, str]]:
    """The GNSS satellites under their codes (``G07``) at ``when``, and those left out: name -> reason.

    Raises DomainError where two satellites hold one code, or none has a known one.
    """
    named: list[Orbit] = []
    dropped: dict[str, str] = {}
    for orbit in orbits:
        code = transmitter_code(orbit.name, orbit.catalogue_number, when)
        if code is None:
            key = orbit.name if orbit.name not in dropped else f"{orbit.name} ({orbit.where})"
            dropped[key] = (
                f"no ranging code is known for catalogue number {orbit.catalogue_number} on {when:%Y-%m-%d}"
                if orbit.catalogue_number is not None
                else "its name is no ranging code"
            )
        else:
            named.append(replace(orbit, name=code))
    refuse_duplicates(named, field, "ranging code", lambda orbit: orbit.name)
    if not named:
        raise DomainError(
            f"{field}: not one of {len(dropped)} satellites has a known ranging code on {when:%Y-%m-%d}.",
            field=field,
            accepted="names with '(PRN 13)' or '(C19)', codes such as G13, or catalogue numbers of GNSS satellites",
        )
    return sorted(named, key=lambda orbit: orbit.name), dropped


def choose_constellations(
    named: Sequence[Orbit], letters: Sequence[str] | None, field: str = "constellations"
) -> list[Orbit]:
    """Those whose code begins with one of ``letters`` (``G``, ``E``, ``C``, ``J``); all where it is None.

    Raises DomainError where that leaves none.
    """
    if letters is None:
        return list(named)
    chosen = [orbit for orbit in named if orbit.name[0] in letters]
    if not chosen:
        held = sorted({CONSTELLATIONS[orbit.name[0]] for orbit in named})
        asked = ", ".join(CONSTELLATIONS[letter] for letter in letters)
        raise DomainError(
            f"{field}: the transmitters hold no satellite of {asked}.",
            field=field,
            value=asked,
            accepted=", ".join(held),
        )
    return chosen


def missing_constellations(used: Iterable[Orbit], letters: Sequence[str] | None) -> list[str]:
    """Warnings: constellations asked for of which no satellite is used."""
    held = {orbit.name[0] for orbit in used}
    return [
        f"constellations: {CONSTELLATIONS[letter]} is asked for, but no satellite of it is used"
        for letter in letters or ()
        if letter not in held
    ]


def prepare(
    orbits: Sequence[Orbit], start: datetime, duration_s: float, node_s: float, max_age_days: float, name: str
) -> Prepared:
    """States of every usable orbit on nodes at most ``node_s`` apart from ``start`` (UTC) to the horizon's end.

    Left out with the reason: elements too far from the start, satellites that have come down or for which SGP4 fails,
    tables that do not reach over the horizon. Raises DomainError with the reasons where that leaves none, and where two
    share a name.
    """
    refuse_duplicates(orbits, name, "name", lambda orbit: orbit.name)
    sets = [orbit for orbit in orbits if isinstance(orbit, ElementSet)]
    tables = [orbit for orbit in orbits if isinstance(orbit, TabulatedOrbit)]
    fresh, old = within_age(sets, start, max_age_days, name, others=bool(tables))
    propagated, failed = propagate(fresh, start, duration_s, node_s)
    tabulated, uncovered, bounds = interpolate(tables, start, duration_s, node_s)
    states = {ephemeris.name: ephemeris for ephemeris in (*propagated, *tabulated)}
    dropped = old | failed | uncovered
    if not states:
        told = [f"{satellite}: {why}" for satellite, why in dropped.items()]
        more = [f"and so on for {len(told) - REASONS_TOLD} more"] if len(told) > REASONS_TOLD else []
        reasons = "; ".join(told[:REASONS_TOLD] + more)
        raise DomainError(
            f"{name}: no satellite can be used over the horizon ({reasons}).",
            field=name,
            accepted="orbits of satellites that hold over the whole horizon",
        )
    used = sorted((orbit for orbit in orbits if orbit.name in states), key=lambda orbit: orbit.name)
    return Prepared(used, [states[orbit.name] for orbit in used], dropped, bounds)


def left_out_warnings(dropped: Mapping[str, str]) -> list[str]:
    """One line for each satellite that is not used."""
    return [f"{name} left out: {why}" for name, why in sorted(dropped.items())]
