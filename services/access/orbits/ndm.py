"""What the CCSDS navigation data messages share: keyword lines, XML elements with their line numbers, and epochs."""

from __future__ import annotations

import re
import xml.sax
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import StringIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.access.horizon import FIRST_YEAR, LAST_YEAR
from shared.errors import DomainError

_UNIT = re.compile(r"\s*\[[^\]]*\]\s*$")
_EARLIEST, _LATEST = (np.datetime64(f"{year}-01-01", "us") for year in (FIRST_YEAR, LAST_YEAR + 1))
_DAY_OF_YEAR = re.compile(r"^(\d{4})-(\d{3})(T.*)?$")


@dataclass
class Keywords:
    """Keywords of one part of a message with the line of each, and the line on which the part begins."""

    line: int
    values: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def put(self, key: str, value: str, line: int) -> None:
        self.values[key] = value
        self.lines[key] = line

    def get(self, key: str, default: str = "") -> str:
        return self.values.get(key, default)

    def where(self, key: str) -> str:
        """``line 12`` of a keyword, or of the part where it is missing."""
        return f"line {self.lines.get(key, self.line)}"


@dataclass(frozen=True)
class XmlEvent:
    """The start or the end of an XML element, its text at the end, and the line of its start."""

    kind: str
    tag: str
    text: str
    line: int


def keyword_line(text: str, number: int, name: str) -> tuple[str, str]:
    """Keyword and value of a KVN line, a unit in brackets and the prefix of a user's own keyword taken off.

    DomainError naming the line if it is none.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise DomainError(
            f"{name}: line {number}: neither a keyword line nor data here.",
            field=name,
            value=text.strip()[:80],
            accepted="KEYWORD = value",
        )
    return key.strip().upper().removeprefix("USER_DEFINED_"), _UNIT.sub("", value).strip()


def xml_events(text: str, name: str) -> list[XmlEvent]:
    """Starts and ends of all elements in order; DomainError naming the line where the XML is broken.

    A document with a DOCTYPE is refused: messages have none, and entities in it could name files or grow without end.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        line = text[: text.find("<!")].count("\n") + 1
        raise DomainError(
            f"{name}: line {line}: XML with a document type.", field=name, accepted="CCSDS XML without DOCTYPE"
        )
    collector = _Collector()
    try:
        xml.sax.parse(StringIO(text), collector)
    except xml.sax.SAXParseException as error:
        raise DomainError(
            f"{name}: line {error.getLineNumber()}: malformed XML ({error.getMessage()}).",
            field=name,
            accepted="CCSDS OMM or OEM in XML",
        ) from error
    return collector.events


class _Collector(xml.sax.ContentHandler):
    def __init__(self) -> None:
        super().__init__()
        self.events: list[XmlEvent] = []
        self._open: list[tuple[str, int, list[str]]] = []
        self._locator: Any = None

    def setDocumentLocator(self, locator: Any) -> None:
        self._locator = locator

    def startElement(self, name: str, attrs: Any) -> None:
        line = int(self._locator.getLineNumber())
        tag = name.rpartition(":")[2]
        if tag == "USER_DEFINED":
            tag = attrs.get("parameter", tag)
        self._open.append((tag, line, []))
        self.events.append(XmlEvent("start", tag, "", line))

    def characters(self, content: str) -> None:
        if self._open:
            self._open[-1][2].append(content)

    def endElement(self, name: str) -> None:
        tag, line, text = self._open.pop()
        self.events.append(XmlEvent("end", tag, "".join(text).strip(), line))


def utc_datetime(text: str) -> datetime:
    """One CCSDS epoch in UTC as a datetime; ValueError if it is none."""
    return datetime.fromisoformat(str(_as_datetime64(text).astype("datetime64[us]"))).replace(tzinfo=UTC)


def epochs(texts: Sequence[str], lines: Sequence[int], name: str) -> NDArray[np.datetime64]:
    """CCSDS epochs, ``2022-12-04T01:28:02.3`` or ``2022-338T01:28:02.3``, as datetime64[us] without a scale.

    DomainError naming the line of the first that is no epoch.
    """
    try:
        times = np.array([text.removesuffix("Z") for text in texts], dtype="datetime64[us]")
        # numpy reads words, too: NaT, now
        if all(text[:1].isdigit() for text in texts) and np.all((times >= _EARLIEST) & (times < _LATEST)):
            return times
    except ValueError:
        pass
    found = []
    for text, line in zip(texts, lines, strict=True):
        try:
            found.append(_as_datetime64(text))
        except ValueError as error:
            raise DomainError(
                f"{name}: line {line}: '{text}' is not an epoch.",
                field=name,
                value=text,
                accepted="2022-12-04T01:28:02.316 or 2022-338T01:28:02.316",
            ) from error
    return np.array(found, dtype="datetime64[us]")


def _as_datetime64(text: str) -> np.datetime64:
    plain = text.strip().removesuffix("Z")
    counted = _DAY_OF_YEAR.match(plain)
    if counted:
        day = datetime.strptime(f"{counted[1]} {counted[2]}", "%Y %j")
        plain = f"{day:%Y-%m-%d}{counted[3] or ''}"
    if not re.match(r"^\d{4}-\d{2}-\d{2}", plain):
        raise ValueError(f"'{text}' is not an epoch")
    time = np.datetime64(plain, "us")
    if not _EARLIEST <= time < _LATEST:
        raise ValueError(f"'{text}' is no time of satellites")
    return time
