"""Orbit files of every kind, told apart by what stands in them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

from services.access.orbits.elements import ElementSet, refuse_duplicates
from services.access.orbits.oem import read_oem_kvn, read_oem_xml
from services.access.orbits.omm import read_omm_json, read_omm_kvn, read_omm_xml
from services.access.orbits.sp3 import join_files, read_sp3
from services.access.orbits.tabulated import TabulatedOrbit
from services.access.orbits.tle import read_tle
from shared.errors import DomainError

Orbit = ElementSet | TabulatedOrbit
Reader = Callable[[str, str], Sequence[Orbit]]

ACCEPTED = "TLE pairs, CCSDS OMM (JSON, XML, KVN), CCSDS OEM (KVN, XML) or SP3"
_SP3 = re.compile(r"#[a-d][PV ]?\s*\d{4}")


def read_orbits(text: str, field: str = "orbits") -> list[Orbit]:
    """The orbits of one file in its order, its format recognised by content: element sets or tabulated orbits.

    Raises DomainError naming ``field`` and the line or row for whatever its reader refuses, a satellite given twice,
    or a file that holds no orbit.
    """
    return read_files([("", text)], field)


def read_files(files: Sequence[tuple[str, str]], field: str = "orbits") -> list[Orbit]:
    """The orbits of several files ``(name, text)``, which may be of different formats; places then name the file.

    SP3 files that follow each other make one orbit a satellite (first in the list); OEM files do not.
    One catalogue number stands for one satellite; that names are not shared is asked for of those that are used.
    """
    found: list[Orbit] = []
    for name, text in files:
        label = f"{field} ({name})" if len(files) > 1 else field
        orbits = list(_reader(text)(text.lstrip("\ufeff"), label))
        if not orbits:
            raise DomainError(
                f"{label}: the file holds no element sets and no ephemeris.", field=field, accepted=ACCEPTED
            )
        found += [_of_file(orbit, name) for orbit in orbits] if len(files) > 1 else orbits
    tables = join_files(orbit for orbit in found if isinstance(orbit, TabulatedOrbit) and orbit.source == "sp3")
    found = [*tables, *(orbit for orbit in found if orbit.source != "sp3")]
    refuse_duplicates(found, field, "satellite", lambda orbit: orbit.catalogue_number)
    return found


def _of_file(orbit: Orbit, name: str) -> Orbit:
    """The orbit with its file's name in every place."""
    where = f"{orbit.where} of {name}"
    if isinstance(orbit, ElementSet):
        return replace(orbit, where=where)
    segments = tuple(replace(segment, where=f"{segment.where} of {name}") for segment in orbit.segments)
    return replace(orbit, where=where, segments=segments)


def _reader(text: str) -> Reader:
    start = text.lstrip("\ufeff \t\r\n")[:2000]
    if start[:1] in ("[", "{"):
        return read_omm_json
    if start[:1] == "<":
        return read_oem_xml if _is_oem(text) else read_omm_xml
    word = start.split("=", 1)[0].strip().upper()
    if word == "CCSDS_OMM_VERS":
        return read_omm_kvn
    if word == "CCSDS_OEM_VERS":
        return read_oem_kvn
    return read_sp3 if _SP3.match(start) else read_tle


def _is_oem(text: str) -> bool:
    return re.search(r"<(\w+:)?oem[\s>]", text) is not None
