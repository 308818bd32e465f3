"""Which ranging code a GNSS satellite transmits on a date, from its name or its catalogue number."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime

# letter of the codes -> constellation, as in RINEX and SP3
CONSTELLATIONS = {"G": "GPS", "E": "Galileo", "C": "BeiDou", "J": "QZSS"}

_CODE = re.compile(r"^[GECJ]\d{2}$")
_PRN_IN_NAME = re.compile(r"\(PRN ([ECJ]?)(\d{2})\)")  # GPS BIIR-2 (PRN 13), GSAT0101 (PRN E11)
_CODE_IN_NAME = re.compile(r"\(([EC]\d{2})\)")  # BEIDOU-3 M1 (C19)
_QZSS_IN_NAME = re.compile(r"\(QZSS/PRN (\d{3})\)")
_ALWAYS = (date(1990, 1, 1), date(9999, 12, 31))


def _until(year: int, month: int, day: int) -> tuple[date, date]:
    return _ALWAYS[0], date(year, month, day)


def _since(year: int, month: int, day: int) -> tuple[date, date]:
    return date(year, month, day), _ALWAYS[1]


# catalogue number -> (PRN, first day, last day). NAVSTAR 43 is 24876 (SVN 43), and so on in the order of launch.
# Codes are those of NAVCEN's constellation status and its NANUs (e.g. NANU 2022001: SVN 47 leaves PRN 22 on
# 2022-01-18 and SVN 41 returns under it on 2022-01-20). Where a code changed hands the limits are the launch of the
# new holder or the day of that notice, so in the weeks between two holders a satellite may be named that was silent.
_GPS: dict[int, tuple[tuple[int, tuple[date, date]], ...]] = {
    24876: ((13, _ALWAYS),),
    25933: ((11, _until(2021, 6, 16)),),
    26360: ((20, _ALWAYS),),
    26407: ((28, _until(2022, 2, 1)),),
    26605: ((14, _until(2020, 11, 4)), (22, _since(2022, 1, 20))),
    26690: ((18, _until(2019, 8, 21)),),
    27663: ((16, _ALWAYS),),
    27704: ((21, _until(2025, 5, 29)),),
    28129: ((22, _until(2022, 1, 18)),),
    28190: ((19, _ALWAYS),),
    28361: ((23, _until(2020, 6, 29)),),
    28474: ((2, _ALWAYS),),
    28874: ((17, _ALWAYS),),
    29486: ((31, _ALWAYS),),
    29601: ((12, _ALWAYS),),
    32260: ((15, _ALWAYS),),
    32384: ((29, _ALWAYS),),
    32711: ((7, _ALWAYS),),
    35752: ((5, _ALWAYS),),
    36585: ((25, _ALWAYS),),
    37753: ((1, _until(2024, 12, 16)),),
    38833: ((24, _ALWAYS),),
    39166: ((27, _ALWAYS),),
    39533: ((30, _ALWAYS),),
    39741: ((6, _ALWAYS),),
    40105: ((9, _ALWAYS),),
    40294: ((3, _ALWAYS),),
    40534: ((26, _ALWAYS),),
    40730: ((8, _ALWAYS),),
    41019: ((10, _ALWAYS),),
    41328: ((32, _ALWAYS),),
    43873: ((4, _ALWAYS),),
    44506: ((18, _since(2019, 8, 22)),),
    45854: ((23, _since(2020, 6, 30)),),
    46826: ((14, _since(2020, 11, 5)),),
    48859: ((11, _since(2021, 6, 17)),),
    55268: ((28, _since(2023, 1, 18)),),
    62339: ((1, _since(2024, 12, 17)),),
    64202: ((21, _since(2025, 5, 30)),),
}

# Galileo codes have not changed hands; they are those that CelesTrak prints behind the names (GSAT0101 = E11).
_GALILEO: dict[int, int] = {
    37846: 11, 37847: 12, 38857: 19, 38858: 20, 40128: 18, 40129: 14, 40544: 26, 40545: 22, 40889: 24, 40890: 30,
    41174: 9, 41175: 8, 41549: 2, 41550: 1, 41859: 7, 41860: 3, 41861: 4, 41862: 5, 43055: 21, 43056: 25, 43057: 27,
    43058: 31, 43564: 15, 43565: 33, 43566: 36, 43567: 13, 49809: 34, 49810: 10, 59598: 29,
    59600: 6, 61182: 16, 61183: 23, 67160: 28,
}  # fmt: skip

# BeiDou-2 and -3, as CelesTrak prints them behind the names (BEIDOU-3 M1 (C19)); those not listed need such names.
_BEIDOU: dict[int, int] = {
    36828: 6, 37210: 4, 37256: 7, 38775: 14, 44231: 1, 43001: 19, 43582: 24, 43602: 26, 43603: 25, 43622: 32,
    43623: 33, 43647: 35, 43648: 34, 43683: 59, 43706: 36, 43707: 37, 44204: 38, 44337: 39, 44542: 46, 44543: 45,
    44709: 40, 44793: 44, 44794: 43, 44864: 41, 44865: 42, 45344: 60, 45807: 61, 56564: 62, 58654: 50,
}  # fmt: skip

# QZSS: RINEX code = PRN of the L1 C/A signal - 192. Satellite 3 stands over the equator.
_QZSS: dict[int, int] = {42738: 2, 42917: 7, 42965: 3, 49336: 4, 62876: 8}
# CelesTrak has printed the PRN of the L1S signal for some years instead (QZS-2 (QZSS/PRN 184)).
_QZSS_L1S = {183: 1, 184: 2, 185: 3, 186: 4, 189: 7}


def letters_of(names: Sequence[str] | None) -> tuple[str, ...] | None:
    """The letters of constellations by name, in the order of ``CONSTELLATIONS``; None (all) for None."""
    return None if names is None else tuple(letter for letter, name in CONSTELLATIONS.items() if name in names)


def transmitter_code(name: str, catalogue_number: int | None, when: datetime) -> str | None:
    """The code of a GNSS satellite, ``G07``, ``E11``, ``C19`` or ``J02``: None where none is known for that day.

    Taken from the name (a code, or CelesTrak's ``... (PRN 13)``, ``... (PRN E11)``, ``... (C19)``,
    ``... (QZSS/PRN 194)``), else by catalogue number and date (UTC). A satellite that no longer transmits has none.
    """
    if _CODE.match(name):
        return name
    printed = _printed_code(name)
    if printed or catalogue_number is None:
        return printed
    day = when.astimezone(UTC).date()
    for prn, (first, last) in _GPS.get(catalogue_number, ()):
        if first <= day <= last:
            return f"G{prn:02d}"
    for letter, table in (("E", _GALILEO), ("C", _BEIDOU), ("J", _QZSS)):
        if catalogue_number in table:
            return f"{letter}{table[catalogue_number]:02d}"
    return None


def _printed_code(name: str) -> str | None:
    found = _PRN_IN_NAME.search(name)
    if found:
        return f"{found.group(1) or 'G'}{found.group(2)}"
    found = _CODE_IN_NAME.search(name)
    if found:
        return found.group(1)
    found = _QZSS_IN_NAME.search(name)
    if found:
        prn = int(found.group(1))
        number = prn - 192 if 193 <= prn <= 202 else _QZSS_L1S.get(prn)
        return None if number is None else f"J{number:02d}"
    return None
