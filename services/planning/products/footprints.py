"""What the plan sees on the ground, for maps: GeoJSON and KML."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import simplekml

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem
from services.planning.products.outcomes import first_observers
from services.planning.timeline import collected_seconds
from shared.figures import footer

ACTIVE_COLOUR, PREFIRE_COLOUR, TRACK_COLOUR = "ff1d30d6", "ff2a8fd8", "ffac6621"  # KML: alpha, blue, green, red
Line = list[tuple[float, float]]


def planned_tracks(
    problem: PlanningProblem, timeline: Timeline, specular_points: pd.DataFrame | None
) -> list[dict[str, Any]]:
    """Tracks of the specular points while the plan records: satellite, transmitter, start, end and line (lon, lat)."""
    if specular_points is None or not len(specular_points):
        return []
    collect = collected_seconds(problem, timeline.images)
    index = {limits.name: s for s, limits in enumerate(problem.satellites)}
    second = np.floor((specular_points["time"] - problem.horizon_start) / pd.Timedelta(seconds=1)).to_numpy(np.int64)
    satellite = specular_points["satellite"].astype(str).map(index).fillna(-1).to_numpy(np.int64)
    inside = (satellite >= 0) & (second >= 0) & (second < problem.horizon_s)
    inside[inside] = collect[satellite[inside], second[inside]]
    points = specular_points[inside].assign(second=second[inside]).sort_values(["satellite", "transmitter", "second"])
    fresh = (
        (points["satellite"].astype(str) != points["satellite"].astype(str).shift())
        | (points["transmitter"] != points["transmitter"].shift())
        | (points["second"].diff() > 1)
    )
    tracks = []
    for _, rows in points.groupby(fresh.cumsum().to_numpy()):
        line = [(round(p.x, 5), round(p.y, 5)) for p in rows.geometry]
        begin, end = int(rows["second"].iloc[0]), int(rows["second"].iloc[-1]) + 1
        tracks.append({
            "satellite": str(rows["satellite"].iloc[0]), "transmitter": str(rows["transmitter"].iloc[0]),
            "start": _time(problem, begin), "end": _time(problem, end), "line": line,
        })  # fmt: skip
    return tracks


def planned_targets(problem: PlanningProblem, timeline: Timeline, targets: pd.DataFrame) -> list[dict[str, Any]]:
    """Every observed target: place, kind, reward, and the first image that sees it."""
    first = first_observers(problem, timeline.images)
    place = targets.set_index("target_id").geometry
    found = []
    ends = [cycle_ends(problem, s) for s in range(len(problem.satellites))]
    for target in np.flatnonzero(first >= 0):
        image, number = first[target], int(problem.targets.target_id[target])
        s, second = int(problem.images.satellite[image]), int(problem.images.second[image])
        point = place[number]
        found.append({
            "lon": round(float(point.x), 5), "lat": round(float(point.y), 5), "target_id": number,
            "kind": "active" if problem.targets.active[target] else "prefire",
            "reward": float(problem.targets.value[target]), "satellite": problem.satellites[s].name,
            "image_id": int(problem.images.image_id[image]),
            "cycle": int(np.searchsorted(ends[s], second, side="right")), "time": _time(problem, second),
        })  # fmt: skip
    return found


def write_geojson(
    path: Path, seen: list[dict[str, Any]], tracks: list[dict[str, Any]], attributes: Mapping[str, Any]
) -> None:
    """Observed targets as points and, where known, recorded tracks as lines (RFC 7946, lon/lat degrees)."""
    features = [
        {
            "type": "Feature", "geometry": {"type": "Point", "coordinates": [row["lon"], row["lat"]]},
            "properties": {name: value for name, value in row.items() if name not in ("lon", "lat")},
        }
        for row in seen
    ] + [
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": row["line"]} if len(row["line"]) > 1
            else {"type": "Point", "coordinates": row["line"][0]},
            "properties": {"kind": "track", **{name: value for name, value in row.items() if name != "line"}},
        }
        for row in tracks
    ]  # fmt: skip
    collection = {"type": "FeatureCollection", "features": features, "product": dict(attributes)}
    path.write_text(json.dumps(collection, sort_keys=True, default=str) + "\n", encoding="utf-8")


def write_kml(
    path: Path, problem: PlanningProblem, seen: list[dict[str, Any]], tracks: list[dict[str, Any]],
    attributes: Mapping[str, Any],
) -> None:  # fmt: skip
    """A folder per satellite: each active target by name, pre-fire targets of one cycle together, tracks with times."""
    simplekml.Kml.resetidcounter()  # ids count on within a process otherwise: other bytes for the same plan
    document = simplekml.Kml(name="Planned observations", description=footer(attributes))
    for limits in problem.satellites:
        folder = document.newfolder(name=limits.name)
        mine = [row for row in seen if row["satellite"] == limits.name]
        for row in (row for row in mine if row["kind"] == "active"):
            point = folder.newpoint(name=f"active {row['target_id']}", coords=[(row["lon"], row["lat"])])
            point.description = f"image {row['image_id']}, cycle {row['cycle']}, reward {row['reward']:.4g}"
            point.timestamp.when = row["time"]
            point.style.iconstyle.color = ACTIVE_COLOUR
        for cycle in sorted({row["cycle"] for row in mine}):
            rows = [row for row in mine if row["cycle"] == cycle and row["kind"] == "prefire"]
            if not rows:
                continue
            group = folder.newmultigeometry(name=f"cycle {cycle}: {len(rows)} pre-fire targets")
            for row in rows:
                group.newpoint(coords=[(row["lon"], row["lat"])])
            group.timespan.begin, group.timespan.end = min(r["time"] for r in rows), max(r["time"] for r in rows)
            group.style.iconstyle.color, group.style.iconstyle.scale = PREFIRE_COLOUR, 0.4
        for track in (track for track in tracks if track["satellite"] == limits.name):
            line = folder.newlinestring(name=f"{track['transmitter']} {track['start']}", coords=track["line"])
            line.timespan.begin, line.timespan.end = track["start"], track["end"]
            line.style.linestyle.color, line.style.linestyle.width = TRACK_COLOUR, 3
    path.write_text(document.kml(), encoding="utf-8")


def _time(problem: PlanningProblem, second: int) -> str:
    return f"{problem.horizon_start + pd.Timedelta(seconds=second):%Y-%m-%dT%H:%M:%SZ}"
