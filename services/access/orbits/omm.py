"""CCSDS orbit mean-elements messages (502.0-B-3) for SGP4: JSON as the catalogues give it, XML and KVN."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sgp4 import omm
from sgp4.api import Satrec

from services.access.orbits.elements import DAY_NOT_SAID, ElementSet, refuse_impossible
from services.access.orbits.ndm import Keywords, keyword_line, utc_datetime, xml_events
from shared.errors import DomainError

NUMBERS = ("MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY", "BSTAR")
MOST_CATALOGUE_NUMBER = 999_999_999
# SGP4 takes no notice of these; catalogues without them are whole.
DEFAULTS = {
    "EPHEMERIS_TYPE": "0",
    "CLASSIFICATION_TYPE": "U",
    "ELEMENT_SET_NO": "999",
    "REV_AT_EPOCH": "0",
    "OBJECT_ID": "",
    "MEAN_MOTION_DOT": "0",
    "MEAN_MOTION_DDOT": "0",
}
STATED = {
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME", "TEMEOFDATE"),
    "TIME_SYSTEM": ("UTC",),
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
    "EPHEMERIS_TYPE": ("0", "2"),
}


def read_omm_json(text: str, field: str) -> list[ElementSet]:
    """The element sets of a JSON list (or one object) of OMM keywords, values as numbers or texts.

    This and its siblings raise DomainError naming ``field`` and the row or line: malformed text, a keyword that is
    missing or unreadable, elements that make no orbit, another theory than SGP4.
    """
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise DomainError(
            f"{field}: line {error.lineno}: malformed JSON ({error.msg}).", field=field, accepted="an OMM JSON list"
        ) from error
    except RecursionError as error:
        raise DomainError(f"{field}: JSON nested too deeply.", field=field, accepted="an OMM JSON list") from error
    found = []
    for number, row in enumerate(document if isinstance(document, list) else [document]):
        if not isinstance(row, dict):
            raise DomainError(
                f"{field}: row {number}: not an OMM object.", field=field, value=row, accepted="an object"
            )
        values = {str(key): str(value) for key, value in row.items() if value is not None}
        found.append(_element(values, {}, f"row {number}", field))
    return found


def read_omm_xml(text: str, field: str) -> list[ElementSet]:
    """The element sets of an ``omm`` document, or of the ``omm`` elements of an ``ndm`` one."""
    messages: list[Keywords] = []
    for event in xml_events(text, field):
        if event.kind == "start" and event.tag == "omm":
            messages.append(Keywords(event.line))
        elif event.kind == "end" and messages and event.text:
            messages[-1].put(event.tag.upper(), event.text, event.line)
    return [_element(message.values, message.lines, f"line {message.line}", field) for message in messages]


def read_omm_kvn(text: str, field: str) -> list[ElementSet]:
    """The element sets of a text of keyword lines; each ``CCSDS_OMM_VERS`` begins another."""
    messages: list[Keywords] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.strip().upper().startswith("COMMENT"):
            continue
        key, value = keyword_line(line, number, field)
        if key == "CCSDS_OMM_VERS":
            messages.append(Keywords(number))
        messages[-1].put(key, value, number)
    return [_element(message.values, message.lines, f"line {message.line}", field) for message in messages]


def _element(values: Mapping[str, str], lines: Mapping[str, int], where: str, field: str) -> ElementSet:
    fields = {**DEFAULTS, **values}

    def fault(key: str, what: str, accepted: str) -> DomainError:
        place = f"line {lines[key]}" if key in lines else where
        return DomainError(f"{field}: {place}: {what}.", field=field, value=fields.get(key), accepted=accepted)

    for key, allowed in STATED.items():
        if key in values and values[key].strip().upper() not in allowed:
            raise fault(key, f"{key} {values[key]} is not one of {', '.join(allowed)}", "SGP4 elements in TEME and UTC")
    for key in ("EPOCH", "NORAD_CAT_ID", *NUMBERS):
        if key not in fields:
            raise fault(key, f"the OMM lacks {key}", "the keywords of CCSDS OMM for SGP4")
    epoch = _read(fields, "EPOCH", utc_datetime, fault)
    for key in (*NUMBERS, "MEAN_MOTION_DOT", "MEAN_MOTION_DDOT"):
        fields[key] = repr(_read(fields, key, _finite, fault))
    for key in ("NORAD_CAT_ID", "EPHEMERIS_TYPE", "ELEMENT_SET_NO", "REV_AT_EPOCH"):
        fields[key] = str(_read(fields, key, int, fault))
    number = int(fields["NORAD_CAT_ID"])
    if not 0 <= number <= MOST_CATALOGUE_NUMBER:
        raise fault("NORAD_CAT_ID", f"catalogue number {number} has not up to nine digits", "0 to 999999999")
    record = Satrec()
    try:
        # the record's own number, five characters at most as in a TLE, plays no part in SGP4
        omm.initialize(record, {**fields, "NORAD_CAT_ID": "0", "EPOCH": f"{epoch:%Y-%m-%dT%H:%M:%S.%f}"})
    except (ValueError, TypeError, OverflowError) as error:
        raise fault("EPOCH", f"unreadable OMM ({error})", "numbers and ISO epochs") from error
    refuse_impossible(record, where, field)
    name = fields.get("OBJECT_NAME", "").strip() or str(number)
    return ElementSet(name, number, epoch, record, where, "omm", _decay(fields))


def _read(fields: Mapping[str, str], key: str, reader: Any, fault: Any) -> Any:
    try:
        return reader(fields[key])
    except ValueError as error:
        raise fault(key, f"unreadable OMM ({key} '{fields[key]}')", "numbers and ISO epochs") from error


def _finite(text: str) -> float:
    number = float(text)
    if number != number or abs(number) == float("inf"):
        raise ValueError("not a finite number")
    return number


def _decay(fields: Mapping[str, str]) -> datetime | None:
    """When the catalogue says that the satellite came down; the beginning of time where it does not say when."""
    try:
        return utc_datetime(fields.get("DECAY_DATE", ""))
    except ValueError:
        return DAY_NOT_SAID if fields.get("DECAYED", "0").strip() == "1" else None
