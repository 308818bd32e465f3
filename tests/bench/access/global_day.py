"""The global case: 30 receivers, 90 transmitters, every 0.25 degree cell of land, a day second by second.

GPS and Galileo are real elements of 2020-07-30; a third constellation that fills up to 90 on BeiDou's medium orbit,
and the receivers (half as CYGNSS flies, half sun-synchronous), are made up on even planes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

RECEIVERS, TRANSMITTERS = 30, 90
START = "2020-07-31T00:00:00Z"
EPOCH = "2020-07-30T12:00:00"


def _row(name: str, number: int, motion: float, inclination: float, node: float, anomaly: float) -> dict[str, Any]:
    return {
        "OBJECT_NAME": name,
        "NORAD_CAT_ID": number,
        "EPOCH": EPOCH,
        "MEAN_MOTION": motion,
        "ECCENTRICITY": 0.001,
        "INCLINATION": inclination,
        "RA_OF_ASC_NODE": node % 360.0,
        "ARG_OF_PERICENTER": 0.0,
        "MEAN_ANOMALY": anomaly % 360.0,
        "BSTAR": 0.0001,
        "MEAN_MOTION_DOT": 0.00001 if motion > 10 else 0.0,
        "MEAN_MOTION_DDOT": 0.0,
    }


def receivers(count: int = RECEIVERS) -> list[dict[str, Any]]:
    """OMM rows of ``count`` receivers."""
    rows = []
    for k in range(count):
        tropical = k % 2 == 0
        inclination, motion = (35.0, 15.18) if tropical else (97.5, 15.16)
        rows.append(_row(f"RX{k:02d}", 90001 + k, motion, inclination, 137.5 * k, 222.5 * k))
    return rows


def stage(data: Path, root: Path, receiver_count: int = RECEIVERS, transmitter_count: int = TRANSMITTERS) -> None:
    """The orbit files under an artifact root: receivers.json and transmitters-0.tle, -1.tle, -2.json."""
    (root / "receivers.json").write_text(json.dumps(receivers(receiver_count)))
    left = transmitter_count
    for number, name in enumerate(("gps", "galileo")):
        lines = (data / f"orbits/tle_20200730/{name}.tle").read_text().splitlines()[: 3 * left]
        (root / f"transmitters-{number}.tle").write_text("\n".join(lines) + "\n")
        left -= len(lines) // 3
    made = [_row(f"C{k + 1:02d}", 95001 + k, 1.8623, 55.0, 120.0 * k, 137.5 * k) for k in range(max(left, 1))]
    (root / "transmitters-2.json").write_text(json.dumps(made))


def body(duration_s: int = 86400) -> dict[str, Any]:
    """The request."""
    return {
        "receivers": {"href": "receivers.json"},
        "transmitters": [{"href": f"transmitters-{n}"} for n in ("0.tle", "1.tle", "2.json")],
        "stations": {"href": "stations.parquet"},
        "start": START,
        "duration_s": duration_s,
        "grid": {"spacing_deg": 0.25, "land_only": True},
        "target_radius_km": 25.0,
        "with_cell_opportunities": True,
    }
