"""Incidents and detections of a live case, from the files of WFIGS, FIRMS and HMS as they were kept."""

from __future__ import annotations

import csv
import io
import json
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from flows.cases.hms import LATENCY, hms_looks
from flows.cases.wfigs import KM2_PER_ACRE

Box = tuple[float, float, float, float]
DETECTIONS_SINCE = timedelta(days=5)
# As the arrival service reads the classes of VIIRS: above and below the confidence of 70 that it asks for.
FIRMS_CLASSES = {"l": 20.0, "n": 75.0, "h": 95.0}
FIRMS_SATELLITES = {"N": "SUOMI NPP", "N20": "NOAA 20", "N21": "NOAA 21", "1": "NOAA 20", "2": "NOAA 21"}
INCIDENT_COLUMNS = ["incident_id", "name", "start", "known_at", "area_km2", "longitude_deg", "latitude_deg"]


def incidents_of(files: list[Path], area: Box, cutoff: datetime) -> pd.DataFrame:
    """The wildfires that burn in a box: of WFIGS features those that are no prescribed fire and not said to be out.

    Each is known from the time of its last change on, with the area that it has then; one that was changed after the
    cut-off from the time of its record's making on, with no area. Without place or time of discovery it is left out.
    """
    rows: dict[str, dict[str, Any]] = {}
    out_at: dict[str, pd.Timestamp] = {}  # said to be out: an earlier page may still have it burning
    for path in files:
        for feature in json.loads(path.read_text(encoding="utf-8"))["features"]:
            told = feature.get("properties") or {}
            changed = _time(told.get("ModifiedOnDateTime_dt"))
            if told.get("FireOutDateTime") and changed is not None and changed <= pd.Timestamp(cutoff):
                out_at[_name(told)] = max(changed, out_at.get(_name(told), changed))
            row = _incident(feature, pd.Timestamp(cutoff))
            if row is None or row["known_at"] > pd.Timestamp(cutoff) or row["start"] > row["known_at"]:
                continue
            before = rows.get(row["incident_id"])
            if before is None or row["known_at"] > before["known_at"]:
                rows[row["incident_id"]] = row
    burning = [rows[name] for name in sorted(rows) if name not in out_at or rows[name]["known_at"] > out_at[name]]
    table = pd.DataFrame(burning, columns=INCIDENT_COLUMNS)
    times = dict.fromkeys(("start", "known_at"), "datetime64[ms, UTC]")
    table = table.astype(times | dict.fromkeys(("area_km2", "longitude_deg", "latitude_deg"), "float64"))
    west, south, east, north = area
    inside = table["longitude_deg"].between(west, east) & table["latitude_deg"].between(south, north)
    return table[inside].reset_index(drop=True)


def _name(told: dict[str, Any]) -> str:
    return str(told.get("UniqueFireIdentifier") or told.get("IrwinID") or "").strip("{}")


def _incident(feature: dict[str, Any], cutoff: pd.Timestamp) -> dict[str, Any] | None:
    told, shape = feature.get("properties") or {}, feature.get("geometry") or {}
    place = shape.get("coordinates") if shape.get("type") == "Point" else None
    started, changed = _time(told.get("FireDiscoveryDateTime")), _time(told.get("ModifiedOnDateTime_dt"))
    name = _name(told)
    prescribed = str(told.get("IncidentTypeCategory") or "WF").upper() == "RX"
    if not place or not name or started is None or changed is None or prescribed or told.get("FireOutDateTime"):
        return None
    acres = told.get("IncidentSize")
    if changed > cutoff:
        changed, acres = _time(told.get("CreatedOnDateTime_dt")) or changed, None
    return {
        "incident_id": name,
        "name": str(told.get("IncidentName") or name).strip().title(),
        "start": started,
        "known_at": changed,
        "area_km2": np.nan if acres is None else round(float(acres) * KM2_PER_ACRE, 4),
        "longitude_deg": float(place[0]),
        "latitude_deg": float(place[1]),
    }


def _time(milliseconds: Any) -> pd.Timestamp | None:
    given = isinstance(milliseconds, int | float) and not isinstance(milliseconds, bool)
    return pd.Timestamp(milliseconds, unit="ms", tz="UTC") if given else None


def detections_of(firms: Path | None, hms: Path | None, area: Box, cutoff: datetime) -> pd.DataFrame:
    """Fire points of the last days as ``detections`` without geometry: of FIRMS, and of HMS what FIRMS does not bring.

    They were there at the cut-off, so delivery is three hours after the overpass or the cut-off, whichever comes first.
    """
    moment = pd.Timestamp(cutoff)
    since = moment - DETECTIONS_SINCE
    parts = [firms_looks(firms, area, since, moment)] if firms else []
    if hms:
        looks = hms_looks(_hms_table(hms), area, since, moment)
        parts.append(looks[looks["instrument"] != "VIIRS"] if firms else looks)
    empty = hms_looks(_no_hms(), area, since, moment)
    table = pd.concat([part for part in parts if len(part)] or [empty], ignore_index=True)
    table["delivered_at"] = table["delivered_at"].clip(upper=moment)
    return table.sort_values(["time", "satellite"], kind="stable", ignore_index=True)


def firms_looks(path: Path, area: Box, since: pd.Timestamp, until: pd.Timestamp) -> pd.DataFrame:
    """The VIIRS points of a FIRMS file in a box (degrees) and time span; footprints as the file gives them."""
    text = path.read_text(encoding="utf-8-sig")
    rows = [
        {name.strip().lower(): value.strip() for name, value in row.items()}
        for row in csv.DictReader(io.StringIO(text))
    ]
    table = pd.DataFrame(rows)
    minute = table["acq_date"] + " " + table["acq_time"].str.zfill(4)
    number = {name: pd.to_numeric(table[name]) for name in ("longitude", "latitude", "frp")}
    size = {name: 1e3 * pd.to_numeric(table[name]) if name in table else 375.0 for name in ("track", "scan")}
    stated = table["confidence"].str.lower()
    looks = pd.DataFrame(
        {
            "time": pd.to_datetime(minute, format="%Y-%m-%d %H%M", utc=True),
            "satellite": table["satellite"].map(lambda code: FIRMS_SATELLITES.get(code, code.upper())),
            "instrument": "VIIRS",
            "confidence": stated.map(FIRMS_CLASSES).fillna(pd.to_numeric(stated, errors="coerce")),
            "frp_mw": number["frp"].where(number["frp"] >= 0),
            "fire": True,
            "along_m": size["track"],
            "across_m": size["scan"],
            "derived": False,
            "longitude_deg": number["longitude"],
            "latitude_deg": number["latitude"],
        }
    )
    looks["delivered_at"] = looks["time"] + LATENCY
    west, south, east, north = area
    inside = looks["longitude_deg"].between(west, east) & looks["latitude_deg"].between(south, north)
    return looks[inside & (looks["time"] >= since) & (looks["time"] <= until)].reset_index(drop=True)


def _hms_table(path: Path) -> pd.DataFrame:
    table = pd.read_csv(path, skipinitialspace=True, dtype=str).rename(columns=lambda name: name.strip().lower())
    table = table.map(lambda value: value.strip() if isinstance(value, str) else value)
    power = pd.to_numeric(table["frp"], errors="coerce") if "frp" in table else np.nan
    return pd.DataFrame(
        {
            "lon_deg": pd.to_numeric(table["lon"]),
            "lat_deg": pd.to_numeric(table["lat"]),
            "time": pd.to_datetime(table["yearday"] + table["time"].str.zfill(4), format="%Y%j%H%M", utc=True),
            "satellite": table["satellite"].str.upper(),
            "method": table["method"].str.upper(),
            "frp_mw": power,
        }
    )


def _no_hms() -> pd.DataFrame:
    kinds = {"lon_deg": "float64", "lat_deg": "float64", "time": "datetime64[ns, UTC]", "satellite": "object"}
    columns = kinds | {"method": "object", "frp_mw": "float64"}
    return pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in columns.items()})
