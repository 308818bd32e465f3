"""One door for active-fire inputs: tables of the contract, granules and point lists, told apart by their content."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd

from services.arrival.readers.granules import ACCEPTED, Area, open_granule, read_pixels, within_area
from services.arrival.readers.points import read_firms, read_hms
from shared.contracts.schema import read_table
from shared.contracts.tables import DETECTIONS
from shared.errors import DomainError

ALL_ACCEPTED = f"a detections table (Parquet), {ACCEPTED}, FIRMS CSV, or HMS text or Parquet"
LOOKS = ("fire", "no fire", "cloud", "water", "glint")
COLUMNS = ("time", "delivered_at", "satellite", "instrument", "confidence", "frp_mw", "fire", "along_m", "across_m")


@dataclass(frozen=True)
class Reading:
    """What a file gave: `detections` (contract rows: fire and no fire), `obscured` (the same columns with `look`:
    places that a pass covered and could not judge for cloud, water or glint), and what to report of it."""

    detections: gpd.GeoDataFrame
    obscured: gpd.GeoDataFrame
    report: dict[str, object]


def file_kind(path: Path, name: str) -> str:
    """table, granule, firms or hms, by the file's content; DomainError for anything else."""
    head = path.read_bytes()[:4096] if path.is_file() else b""
    if head[:4] == b"PAR1":
        import pyarrow.parquet as pq

        return "hms" if "lon_deg" in pq.read_schema(path).names else "table"
    if head[:4] in (b"\x89HDF", b"\x0e\x03\x13\x01") or head[:3] == b"CDF":
        return "granule"
    line = head.split(b"\n", 1)[0].lower().replace(b" ", b"")
    if b"acq_date" in line:
        return "firms"
    if b"yearday" in line:
        return "hms"
    raise DomainError(
        f"'{name}' is no active-fire product known here", field="detections", value=name, accepted=ALL_ACCEPTED
    )


def read_active_fire(path: str | Path, areas: Sequence[Area], name: str | None = None) -> Reading:
    """Read one file of any accepted format; granules and point lists are cut to the areas (degrees), a detections
    table is taken as it is. Raises DomainError for another file, naming it and what is accepted."""
    path, label = Path(path), name or Path(path).name
    kind = file_kind(path, label)
    if kind == "table":
        frame = read_table(path, DETECTIONS)
        report = {"name": label, "format": "detections table", "rows": len(frame)}
        return Reading(frame, frame.iloc[:0].assign(look=pd.Series(dtype=str)), report)
    if kind == "granule":
        pixels, placed = read_pixels(open_granule(path, label), areas)
        report = {"name": label, "format": "granule", "no_fire_placed": placed}
    else:
        whole = read_firms(path, label) if kind == "firms" else read_hms(path, label)
        lon, lat = whole.geometry.x.to_numpy(float), whole.geometry.y.to_numpy(float)
        inside = np.zeros(len(whole), bool)
        for area in areas:
            inside |= within_area(lon, lat, area)
        pixels = whole[inside]
        report = {"name": label, "format": kind, "outside_areas": int((~inside).sum())}
    counts = {look.replace(" ", "_"): int((pixels["look"] == look).sum()) for look in LOOKS}
    kept = pixels["look"].isin(LOOKS[:2])
    columns = [*COLUMNS, "geometry"]
    detections = pixels.loc[kept, columns].reset_index(drop=True)
    obscured = pixels.loc[~kept, [*columns, "look"]].reset_index(drop=True)
    return Reading(detections, obscured, {**report, **counts})
