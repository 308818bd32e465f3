"""Writers of orbit files for tests: OMM and OEM in KVN and XML, SP3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HEADER = {"CREATION_DATE": "2022-12-03T12:00:00", "ORIGINATOR": "TEST"}
KEYWORDS = {
    "MEAN_MOTION": "15.17438862",
    "ECCENTRICITY": "0.0014167",
    "INCLINATION": "34.9552",
    "RA_OF_ASC_NODE": "224.7531",
    "ARG_OF_PERICENTER": "176.0718",
    "MEAN_ANOMALY": "184.0107",
    "NORAD_CAT_ID": "41884",
    "BSTAR": "0.00014529",
}
# CYGFM05 of tests/services/access/orbits.py, the keywords of a full message
OMM = {
    "OBJECT_NAME": "CYGFM05",
    "OBJECT_ID": "2016-078A",
    "CENTER_NAME": "EARTH",
    "REF_FRAME": "TEME",
    "TIME_SYSTEM": "UTC",
    "MEAN_ELEMENT_THEORY": "SGP4",
    "EPOCH": "2022-12-04T01:28:02.316288",
    **KEYWORDS,
}


def omm_kvn(rows: Sequence[Mapping[str, str]]) -> str:
    lines: list[str] = []
    for row in rows:
        lines += ["CCSDS_OMM_VERS = 2.0", "COMMENT a test", *(f"{key} = {value}" for key, value in row.items())]
    return "\n".join(lines) + "\n"


def omm_xml(rows: Sequence[Mapping[str, str]]) -> str:
    messages = [
        '<omm id="CCSDS_OMM_VERS" version="2.0"><body><segment>\n'
        + "".join(f"<{key}>{value}</{key}>\n" for key, value in row.items())
        + "</segment></body></omm>\n"
        for row in rows
    ]
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<ndm>\n{"".join(messages)}</ndm>\n'


def _oem_meta(name: str, changes: Mapping[str, str]) -> dict[str, str]:
    meta = {
        "OBJECT_NAME": name,
        "OBJECT_ID": "2016-078A",
        "CENTER_NAME": "EARTH",
        "REF_FRAME": "ICRF",
        "TIME_SYSTEM": "UTC",
        "INTERPOLATION": "HERMITE",
        "INTERPOLATION_DEGREE": "7",
    }
    return {**meta, **changes}


def _rows(start: datetime, t_s: Array, position_km: Array, velocity_km_s: Array) -> list[list[str]]:
    return [
        [f"{start + timedelta(seconds=float(t)):%Y-%m-%dT%H:%M:%S.%f}", *(f"{value:.6f}" for value in (*p, *v))]
        for t, p, v in zip(t_s, position_km, velocity_km_s, strict=True)
    ]


def oem_kvn(name: str, start: datetime, t_s: Array, position_km: Array, velocity_km_s: Array, **changes: str) -> str:
    """States begin in line 14."""
    header = ["CCSDS_OEM_VERS = 2.0", *(f"{key} = {value}" for key, value in HEADER.items())]
    meta = ["META_START", *(f"{key} = {value}" for key, value in _oem_meta(name, changes).items()), "META_STOP"]
    states = [" ".join(row) for row in _rows(start, t_s, position_km, velocity_km_s)]
    return "\n".join([*header, *meta, "", *states]) + "\n"


def oem_xml(name: str, start: datetime, t_s: Array, position_km: Array, velocity_km_s: Array, **changes: str) -> str:
    tags = ("EPOCH", "X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
    states = [
        "<stateVector>"
        + "".join(f"<{tag}>{value}</{tag}>" for tag, value in zip(tags, row, strict=True))
        + "</stateVector>"
        for row in _rows(start, t_s, position_km, velocity_km_s)
    ]
    header = "".join(f"<{key}>{value}</{key}>" for key, value in HEADER.items())
    meta = "".join(f"<{key}>{value}</{key}>" for key, value in _oem_meta(name, changes).items())
    return (
        f'<?xml version="1.0"?>\n<oem id="CCSDS_OEM_VERS" version="2.0"><header>{header}</header><body><segment>\n'
        f"<metadata>{meta}</metadata>\n<data>\n" + "\n".join(states) + "\n</data></segment></body></oem>\n"
    )


def sp3(
    start: datetime,
    t_s: Array,
    position_km: Mapping[str, Array],
    *,
    missing: Mapping[str, range] | None = None,
    predicted_from: int | None = None,
) -> str:
    """An SP3-c file in GPS time; the first epoch stands in line 24. ``missing``: epochs written as zeros."""
    gone = missing or {}
    first = f"{start:%Y} {start.month:2d} {start.day:2d} {start.hour:2d} {start.minute:2d} {start.second:11.8f}"
    lines = [
        f"#cP{first} {len(t_s):7d} ORBIT IGS20 HLM  IGS",
        f"## 2239      0.00000000 {t_s[1] - t_s[0]:14.8f} 59917 0.0000000000000",
        f"+   {len(position_km):2d}   {''.join(position_km):<51}",
        *["+          0  0  0"] * 4,
        *["++         0  0  0"] * 5,
        "%c M  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        "%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        *["%f  0.0000000  0.000000000  0.00000000000  0.000000000000000"] * 2,
        *["%i    0    0    0    0      0      0      0      0         0"] * 2,
        *["/* TEST"] * 5,
    ]
    for epoch, seconds in enumerate(t_s):
        when = start + timedelta(seconds=float(seconds))
        lines.append(f"*  {when:%Y} {when.month:2d} {when.day:2d} {when.hour:2d} {when.minute:2d} {when.second:11.8f}")
        for code, positions in position_km.items():
            x, y, z = (0.0, 0.0, 0.0) if epoch in gone.get(code, range(0)) else positions[epoch]
            record = f"P{code}{x:14.6f}{y:14.6f}{z:14.6f}{0.0:14.6f}"
            flag = "P" if predicted_from is not None and epoch >= predicted_from else " "
            lines.append(f"{record:<79}{flag}")
    return "\n".join([*lines, "EOF"]) + "\n"
