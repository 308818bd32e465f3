"""Mean orbital elements: two-line elements and CCSDS OMM (JSON), checked line by line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

from sgp4 import omm
from sgp4.api import Satrec
from sgp4.conveniences import sat_epoch_datetime

from services.access.orbits.constellations import transmitter_code
from shared.errors import DomainError

LINE_LENGTH = 69


@dataclass(frozen=True)
class ElementSet:
    """One satellite's elements: its name here, catalogue number, epoch (UTC), SGP4 record and place in the file."""

    name: str
    catalogue_number: int
    epoch: datetime
    record: Satrec
    where: str

    def age_days(self, when: datetime) -> float:
        """Days from the epoch to ``when``; negative where the epoch lies after it."""
        return (when - self.epoch) / timedelta(days=1)


def read_elements(text: str, field: str = "elements") -> list[ElementSet]:
    """The element sets of a TLE text (names optional) or an OMM JSON text, in the file's order.

    Raises DomainError, naming ``field`` and the line or row, for a bad checksum, a broken line, a missing or
    unreadable OMM keyword, a satellite given twice, or a text without elements. TLE: Kelso's format description,
    checksum modulo 10 with ``-`` as 1. OMM: CCSDS 502.0-B, as in CelesTrak's and Space-Track's JSON lists.
    """
    stripped = text.lstrip("\ufeff \t\r\n")
    found = _read_omm(stripped, field) if stripped[:1] in ("[", "{") else _read_tle(text, field)
    if not found:
        raise DomainError(
            f"{field}: the file holds no element sets.", field=field, accepted="TLE pairs or an OMM JSON list"
        )
    _refuse_duplicates(found, field, "satellite", lambda element: str(element.catalogue_number))
    _refuse_duplicates(found, field, "name", lambda element: element.name)
    return found


def name_transmitters(
    elements: Iterable[ElementSet], when: datetime, field: str = "transmitters"
) -> tuple[list[ElementSet], dict[str, str]]:
    """The GNSS satellites under their codes (``G07``) at ``when``, and those left out: name -> reason."""
    named: list[ElementSet] = []
    dropped: dict[str, str] = {}
    for element in elements:
        code = transmitter_code(element.name, element.catalogue_number, when)
        if code is None:
            dropped[element.name] = (
                f"no ranging code is known for catalogue number {element.catalogue_number} on {when:%Y-%m-%d}"
            )
        else:
            named.append(replace(element, name=code))
    _refuse_duplicates(named, field, "ranging code", lambda element: element.name)
    if not named:
        raise DomainError(
            f"{field}: not one of {len(dropped)} satellites has a known ranging code on {when:%Y-%m-%d}.",
            field=field,
            accepted="names with '(PRN 13)', codes such as G13, or catalogue numbers of GPS and Galileo satellites",
        )
    return sorted(named, key=lambda element: element.name), dropped


def within_age(
    elements: Iterable[ElementSet], start: datetime, max_age_days: float, field: str
) -> tuple[list[ElementSet], dict[str, str]]:
    """The element sets whose epoch lies within ``max_age_days`` of ``start``, and the others: name -> reason.

    Raises DomainError naming the nearest epoch and its line where none is near enough.
    """
    every = list(elements)
    near = [element for element in every if abs(element.age_days(start)) <= max_age_days]
    if not near:
        best = min(every, key=lambda element: abs(element.age_days(start)))
        raise DomainError(
            f"{field}: every epoch is far from the start {start:%Y-%m-%dT%H:%M:%SZ}; the nearest, of {best.name} in "
            f"{best.where}, is {best.epoch:%Y-%m-%dT%H:%M:%SZ}, {abs(best.age_days(start)):.1f} days away.",
            field=field,
            value=best.epoch.isoformat(),
            accepted=f"an epoch within {max_age_days:g} days of the start",
        )
    dropped = {
        element.name: f"the epoch in {element.where} lies {abs(element.age_days(start)):.1f} days from the start"
        for element in every
        if element not in near
    }
    return near, dropped


def _read_tle(text: str, field: str) -> list[ElementSet]:
    lines = [(number, line.rstrip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    found: list[ElementSet] = []
    name = ""
    index = 0
    while index < len(lines):
        number, line = lines[index]
        if not line.startswith("1 ") or len(line) < LINE_LENGTH - 20:
            if line.startswith("2 ") and len(line) > LINE_LENGTH - 20:
                raise _line_fault(field, number, line, "a line 2 stands without its line 1")
            name = line.removeprefix("0 ").strip()
            index += 1
            continue
        following = lines[index + 1] if index + 1 < len(lines) else (number + 1, "")
        found.append(_tle_pair(name, (number, line), following, field))
        name = ""
        index += 2
    if name and found == []:
        raise _line_fault(field, lines[0][0], lines[0][1], "neither a name followed by elements nor an element line")
    return found


def _tle_pair(name: str, first: tuple[int, str], second: tuple[int, str], field: str) -> ElementSet:
    for (number, line), digit in ((first, "1"), (second, "2")):
        if not line.startswith(f"{digit} "):
            raise _line_fault(field, number, line, f"expected line {digit} of an element set here")
        if len(line) != LINE_LENGTH:
            raise _line_fault(field, number, line, f"the line has {len(line)} characters, not {LINE_LENGTH}")
        computed = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
        if line[68] != str(computed):
            raise _line_fault(field, number, line, f"checksum {line[68]} where the line adds up to {computed}")
    if first[1][2:7] != second[1][2:7]:
        raise _line_fault(field, second[0], second[1], "the catalogue number differs from that of line 1")
    try:
        record = Satrec.twoline2rv(first[1], second[1])
        epoch = sat_epoch_datetime(record)
    except (ValueError, OverflowError) as error:
        raise _line_fault(field, first[0], first[1], f"unreadable elements ({error})") from error
    return ElementSet(name or f"{record.satnum}", record.satnum, epoch, record, f"line {first[0]}")


def _line_fault(field: str, number: int, line: str, what: str) -> DomainError:
    return DomainError(
        f"{field}: line {number}: {what}.", field=field, value=line, accepted="69-character TLE lines, checksums right"
    )


def _read_omm(text: str, field: str) -> list[ElementSet]:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise DomainError(
            f"{field}: line {error.lineno}: malformed JSON ({error.msg}).", field=field, accepted="an OMM JSON list"
        ) from error
    rows = document if isinstance(document, list) else [document]
    return [_omm_row(row, number, field) for number, row in enumerate(rows)]


def _omm_row(row: Any, number: int, field: str) -> ElementSet:
    if not isinstance(row, dict):
        raise DomainError(f"{field}: row {number}: not an OMM object.", field=field, value=row, accepted="an object")
    fields = {"EPHEMERIS_TYPE": "0", "CLASSIFICATION_TYPE": "U", "ELEMENT_SET_NO": "999", "REV_AT_EPOCH": "0", **row}
    record = Satrec()
    try:
        epoch = datetime.fromisoformat(str(fields["EPOCH"]).removesuffix("Z")).replace(tzinfo=UTC)
        fields["EPOCH"] = f"{epoch:%Y-%m-%dT%H:%M:%S.%f}"
        omm.initialize(record, fields)
    except KeyError as error:
        raise DomainError(
            f"{field}: row {number}: the OMM lacks {error.args[0]}.", field=field, accepted="the keywords of CCSDS OMM"
        ) from error
    except (ValueError, TypeError) as error:
        raise DomainError(
            f"{field}: row {number}: unreadable OMM ({error}).", field=field, accepted="numbers and ISO epochs"
        ) from error
    name = str(fields.get("OBJECT_NAME") or record.satnum).strip()
    return ElementSet(name, int(fields["NORAD_CAT_ID"]), epoch, record, f"row {number}")


def _refuse_duplicates(elements: list[ElementSet], field: str, what: str, key: Callable[[ElementSet], str]) -> None:
    seen: dict[str, ElementSet] = {}
    for element in elements:
        first = seen.setdefault(key(element), element)
        if first is not element:
            raise DomainError(
                f"{field}: {what} {key(element)} is given twice, in {first.where} and {element.where}.",
                field=field,
                value=key(element),
                accepted="one element set per satellite",
            )
