"""Two-line elements, checked line by line."""

from __future__ import annotations

from sgp4.api import Satrec
from sgp4.conveniences import sat_epoch_datetime

from services.access.orbits.elements import ElementSet, refuse_impossible
from shared.errors import DomainError

LINE_LENGTH = 69
Line = tuple[int, str]


def read_tle(text: str, field: str) -> list[ElementSet]:
    """The element sets of a text of line pairs, names before them optional, in order; lines that begin with ``# `` are
    comments.

    Kelso's format description, checksum modulo 10 with ``-`` as 1. Raises DomainError naming ``field`` and the line
    for a bad checksum, a broken or missing line, a name without elements, or elements that make no orbit.
    """
    lines = [(number, line.rstrip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("# ")]
    found: list[ElementSet] = []
    name: Line | None = None
    index = 0
    while index < len(lines):
        number, line = lines[index]
        if line.startswith("1 ") and len(line) > LINE_LENGTH - 20:
            following = lines[index + 1] if index + 1 < len(lines) else (number + 1, "")
            found.append(_pair(name[1] if name else "", lines[index], following, field))
            name, index = None, index + 2
            continue
        if line.startswith("2 ") and len(line) > LINE_LENGTH - 20:
            raise _fault(field, number, line, "a line 2 stands without its line 1")
        if name:
            raise _fault(field, *name, "neither a name followed by elements nor an element line")
        name, index = (number, line.removeprefix("0 ").strip()), index + 1
    if name:
        raise _fault(field, *name, "a name without elements after it")
    return found


def _pair(name: str, first: Line, second: Line, field: str) -> ElementSet:
    for (number, line), digit in ((first, "1"), (second, "2")):
        if not line.startswith(f"{digit} "):
            raise _fault(field, number, line, f"expected line {digit} of an element set here")
        if len(line) != LINE_LENGTH:
            raise _fault(field, number, line, f"the line has {len(line)} characters, not {LINE_LENGTH}")
        computed = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
        if line[68] != str(computed):
            raise _fault(field, number, line, f"checksum {line[68]} where the line adds up to {computed}")
    if first[1][2:7] != second[1][2:7]:
        raise _fault(field, second[0], second[1], "the catalogue number differs from that of line 1")
    try:
        record = Satrec.twoline2rv(first[1], second[1])
        epoch = sat_epoch_datetime(record)
    except (ValueError, OverflowError) as error:
        raise _fault(field, first[0], first[1], f"unreadable elements ({error})") from error
    refuse_impossible(record, f"line {second[0]}", field)
    return ElementSet(name or f"{record.satnum}", record.satnum, epoch, record, f"line {first[0]}")


def _fault(field: str, number: int, line: str, what: str) -> DomainError:
    return DomainError(
        f"{field}: line {number}: {what}.", field=field, value=line, accepted="69-character TLE lines, checksums right"
    )
