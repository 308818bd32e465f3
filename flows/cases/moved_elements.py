"""Orbital elements moved to a day of which there are none: planes carried along, places on the orbits not real."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sgp4 import omm
from sgp4.api import Satrec
from sgp4.conveniences import sat_epoch_datetime

_MINUTE = timedelta(minutes=1)


def moved_elements(path: Path, to: datetime, without: tuple[str, ...] = ()) -> tuple[list[dict[str, str]], datetime]:
    """The satellites of a TLE or OMM file as OMM with epoch ``to`` (UTC), and the oldest epoch that they really had.

    Node, perigee and mean anomaly go on at the secular rates of SGP4 (J2, J4); drag, the Moon and the Sun are left out.
    The orbits' planes are right to some degrees; where a satellite is on its orbit is not that of the day.
    """
    moved, epochs = [], []
    for name, record in _read(path):
        if name in without:
            continue
        epoch = sat_epoch_datetime(record).astimezone(UTC)
        epochs.append(epoch)
        moved.append(_message(name, record, to, (to - epoch) / _MINUTE))
    return moved, min(epochs)


def write_moved(path: Path, to: datetime, target: Path, without: tuple[str, ...] = ()) -> datetime:
    """Write the moved elements as an OMM JSON list; gives the oldest epoch that they really had."""
    moved, oldest = moved_elements(path, to, without)
    target.write_text(json.dumps(moved, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return oldest


def _read(path: Path) -> list[tuple[str, Satrec]]:
    if path.suffix == ".json":
        return [(str(fields["OBJECT_NAME"]), _record(fields)) for fields in json.loads(path.read_text())]
    lines = [line.rstrip() for line in path.read_text().splitlines() if line.strip()]
    groups = zip(lines[0::3], lines[1::3], lines[2::3], strict=True)
    return [(name.strip(), Satrec.twoline2rv(first, second)) for name, first, second in groups]


def _record(fields: dict[str, Any]) -> Satrec:
    record = Satrec()
    omm.initialize(record, {"CLASSIFICATION_TYPE": "U", **fields})
    return record


def _message(name: str, record: Satrec, to: datetime, minutes: float) -> dict[str, str]:
    def angle(value: float, rate: float) -> str:
        return f"{np.degrees(value + rate * minutes) % 360.0:.6f}"

    return {
        "OBJECT_NAME": name,
        "OBJECT_ID": record.intldesg or "0000-000A",
        "NORAD_CAT_ID": str(record.satnum),
        "EPOCH": f"{to:%Y-%m-%dT%H:%M:%S.%f}",
        "MEAN_MOTION": f"{record.no_kozai * 1440.0 / (2 * np.pi):.10f}",
        "ECCENTRICITY": f"{record.ecco:.9f}",
        "INCLINATION": f"{np.degrees(record.inclo):.6f}",
        "RA_OF_ASC_NODE": angle(record.nodeo, record.nodedot),
        "ARG_OF_PERICENTER": angle(record.argpo, record.argpdot),
        "MEAN_ANOMALY": angle(record.mo, record.mdot),
        "EPHEMERIS_TYPE": "0",
        "CLASSIFICATION_TYPE": "U",
        "ELEMENT_SET_NO": "999",
        "REV_AT_EPOCH": "0",
        "BSTAR": f"{record.bstar:.11f}",
        "MEAN_MOTION_DOT": "0",
        "MEAN_MOTION_DDOT": "0",
    }
