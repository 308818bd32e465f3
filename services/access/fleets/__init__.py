"""Lists of receiving satellites: who belongs to a fleet, and what it receives. Two are shipped beside this module."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from services.access.orbits.constellations import CONSTELLATIONS, letters_of
from services.access.orbits.elements import refuse_duplicates
from services.access.orbits.formats import Orbit
from shared.errors import DomainError

SHIPPED = ("cygnss", "example_commercial")
ACCEPTED = (
    '{"fleet": name, "example": false, "constellations": ["GPS", …] or null, "satellites": '
    '[{"satellite": name, "catalogue_number": 41884}, …]}'
)


@dataclass(frozen=True)
class Fleet:
    """A list of receivers: names by catalogue number; names alone have None. ``example``: made up, not a real fleet.

    ``constellations``: letters of those whose signals it receives, None where not said.
    """

    name: str
    satellites: tuple[tuple[str, int | None], ...]
    constellations: tuple[str, ...] | None = None
    example: bool = False

    def pick(self, orbits: Sequence[Orbit], field: str = "receivers") -> tuple[list[Orbit], dict[str, str]]:
        """The fleet's own among ``orbits``, under its names, and those of it that are not there: name -> reason.

        A satellite is known by its catalogue number, or by its name where the list or the orbit has no number.
        DomainError where none is there.
        """
        by_number = {orbit.catalogue_number: orbit for orbit in orbits if orbit.catalogue_number is not None}
        by_name: dict[str, list[Orbit]] = {}
        for each in orbits:
            by_name.setdefault(each.name, []).append(each)
        picked: list[Orbit] = []
        missing: dict[str, str] = {}
        for name, number in self.satellites:
            orbit = by_number.get(number) if number is not None else None
            named = [each for each in by_name.get(name, []) if number is None or each.catalogue_number is None]
            if orbit is None and named:
                refuse_duplicates(named, field, "name", lambda each: each.name)
                orbit = named[0]
            if orbit is None:
                missing[name] = f"it is on the list of {self.name}, but {field} hold no orbit of it"
            else:
                picked.append(replace(orbit, name=name))
        if not picked:
            raise DomainError(
                f"{field}: not one of the {len(orbits)} orbits is of a satellite on the list of {self.name}.",
                field=field,
                accepted=", ".join(f"{name} ({number})" for name, number in self.satellites[:12]),
            )
        return picked, missing


def shipped_fleet(name: str) -> Fleet:
    """One of the lists in ``SHIPPED``."""
    return read_fleet(json.loads((Path(__file__).parent / f"{name}.json").read_text(encoding="utf-8")))


def read_fleet(document: Any, field: str = "fleet") -> Fleet:
    """A fleet from its JSON document; DomainError naming the satellite (counted from 0) or key at fault."""
    if not isinstance(document, dict) or not isinstance(document.get("satellites"), list) or not document["satellites"]:
        raise DomainError(f"{field}: not a list of satellites.", field=field, accepted=ACCEPTED)
    satellites: list[tuple[str, int | None]] = []
    for row, entry in enumerate(document["satellites"]):
        satellites.append(_satellite(entry, row, field))
        name, number = satellites[-1]
        if any(name == other or (number == its and number is not None) for other, its in satellites[:-1]):
            raise DomainError(
                f"{field}: satellite {name} ({number}) is given twice, the second in row {row}.",
                field=field,
                value=name,
                accepted="one row for each satellite",
            )
    received = document.get("constellations")
    known = tuple(CONSTELLATIONS.values())
    listed = isinstance(received, list) and received and all(name in known for name in received)
    if received is not None and not listed:
        raise DomainError(
            f"{field}: constellations {received} are not known.", field=field, value=received, accepted=", ".join(known)
        )
    title = str(document.get("fleet") or "fleet")
    return Fleet(title, tuple(satellites), letters_of(received), bool(document.get("example", False)))


def _satellite(entry: Any, row: int, field: str) -> tuple[str, int | None]:
    name = entry.get("satellite") if isinstance(entry, dict) else None
    number = entry.get("catalogue_number") if isinstance(entry, dict) else None
    if not isinstance(name, str) or not name.strip() or not (number is None or type(number) is int):
        raise DomainError(f"{field}: row {row} names no satellite.", field=field, value=entry, accepted=ACCEPTED)
    return name.strip(), number
