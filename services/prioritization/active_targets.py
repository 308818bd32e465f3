"""Active targets: each fire's expected front on the lattice, priced by rating, staleness and what is burned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import geopandas
import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization import expected_front, observation_age, reward
from services.prioritization.expected_front import KINDS, WEIGHTLESS, Front
from services.prioritization.lattice import KM_PER_DEGREE, Lattice
from services.prioritization.prefire import burn_evidence

Array = npt.NDArray[np.float64]

LONG_BURNED_H = 12.0
REACH_KM = 5.0
UNRATED = {"probability": 0.05, "probability_low": 0.0, "probability_high": 1.0}


@dataclass(frozen=True)
class Situation:
    """All that is known of the fires at ``time``; tables as in their contracts, ``area`` west, south, east, north."""

    time: pd.Timestamp
    horizon_h: float
    area: tuple[float, float, float, float]
    incidents: geopandas.GeoDataFrame
    ratings: pd.DataFrame
    detections: geopandas.GeoDataFrame | None
    arrival_maps: dict[str, xr.Dataset]
    burned_area: list[geopandas.GeoDataFrame]
    observed: pd.DataFrame | None


def active_targets(situation: Situation, lattice: Lattice) -> tuple[pd.DataFrame, list[dict[str, Any]]]:
    """Target rows (target_id, priority, low, high, source, longitude_deg, latitude_deg, …) and a report row a fire.

    A place claimed by two fires goes to the one that gives it the larger reward.
    """
    known = situation.incidents[situation.incidents["known_at"] <= situation.time]
    ratings = _latest_ratings(situation.ratings, situation.time)
    frames, reports = [], []
    for incident in known.itertuples():
        front = _front(incident, situation, lattice)
        frame = _on_lattice(front, lattice, situation.area)
        rating = ratings.get(incident.incident_id)
        frame, removed = _priced(frame, rating or UNRATED, situation, lattice)
        frame["source"] = "incident:" + incident.incident_id
        frames.append(frame)
        reports.append(
            _fire_report(incident, front, frame, rating, removed, incident.incident_id in situation.arrival_maps)
        )
    columns = ["target_id", "priority", "priority_low", "priority_high", "source", "longitude_deg", "latitude_deg"]
    if not frames:
        return pd.DataFrame(columns=columns), reports
    table = pd.concat(frames, ignore_index=True)
    table = table.sort_values(["target_id", "priority", "source"], ascending=[True, False, True], kind="stable")
    reports.sort(key=lambda row: (-row["priority_largest"], row["incident_id"]))
    for rank, row in enumerate(reports, start=1):
        row["rank"] = rank
    return table.drop_duplicates("target_id").reset_index(drop=True), reports


def _latest_ratings(ratings: pd.DataFrame, time: pd.Timestamp) -> dict[str, dict[str, Any]]:
    known = ratings[ratings["time"] <= time].sort_values("time").drop_duplicates("incident_id", keep="last")
    return {str(row["incident_id"]): row for row in known.to_dict("records")}


def _front(incident: Any, situation: Situation, lattice: Lattice) -> Front:
    fresh = situation.detections
    arrival = situation.arrival_maps.get(incident.incident_id)
    parts = []
    if arrival is not None:
        front = expected_front.front_of_map(arrival, situation.time, situation.horizon_h)
        parts.append(front.places)
        if fresh is not None:
            fresh = fresh[fresh["time"] > front.known_until]
    if arrival is None or not len(parts[0].worth):
        front = Front(expected_front.joined([]), expected_front.SPREAD_UNKNOWN_M_S, incident.start)
        parts.append(expected_front.front_of_incident(incident.geometry, lattice))
    if fresh is not None and len(fresh):
        parts.append(expected_front.front_of_detections(fresh, incident.geometry, situation.time, lattice))
    return Front(expected_front.joined(parts), front.spread_m_s, front.known_until)


def _on_lattice(front: Front, lattice: Lattice, area: tuple[float, float, float, float]) -> pd.DataFrame:
    places = front.places
    row, column = lattice.locate(places.longitude_deg, places.latitude_deg)
    frame = pd.DataFrame({"row": row, "column": column, "worth": places.worth, "kind_index": places.kind})
    frame = frame.sort_values(["row", "column", "worth"], ascending=[True, True, False], kind="stable")
    frame = frame.drop_duplicates(["row", "column"]).reset_index(drop=True)
    frame["longitude_deg"], frame["latitude_deg"] = lattice.centre(frame["row"].to_numpy(), frame["column"].to_numpy())
    west, south, east, north = area
    inside = frame["longitude_deg"].between(west, east) & frame["latitude_deg"].between(south, north)
    frame = frame[inside & (frame["worth"] >= WEIGHTLESS)].reset_index(drop=True)
    frame["target_id"] = lattice.target_id(frame["row"].to_numpy(), frame["column"].to_numpy())
    return frame


def _priced(
    frame: pd.DataFrame, rating: dict[str, Any], situation: Situation, lattice: Lattice
) -> tuple[pd.DataFrame, int]:
    kept_share = _unburned_share(frame, situation, lattice)
    worth = frame["worth"].to_numpy() * kept_share
    places = (frame["longitude_deg"].to_numpy(), frame["latitude_deg"].to_numpy())
    reach_km = max(REACH_KM, lattice.spacing_km / 2)
    age = observation_age.age_h(*places, situation.observed, situation.time, reach_km)
    fresh = reward.staleness(age, "active")
    for column, name in (
        ("priority", "probability"),
        ("priority_low", "probability_low"),
        ("priority_high", "probability_high"),
    ):
        frame[column] = reward.active_reward(np.full(len(frame), float(rating[name])), worth, fresh)
    frame["staleness"], frame["observed_age_h"], frame["worth"] = fresh, age, worth
    frame["priority_low"] = frame[["priority", "priority_low"]].min(axis=1)
    frame["priority_high"] = frame[["priority", "priority_high"]].max(axis=1)
    left = worth >= WEIGHTLESS
    return frame[left].reset_index(drop=True), int((~left).sum())


def _unburned_share(frame: pd.DataFrame, situation: Situation, lattice: Lattice) -> Array:
    """What burned-area looks leave of a place's worth: nearly nothing where it surely burned half a day ago or longer.

    Beside a fire it is even odds whether a place has burned; the looks' evidence moves that, and the share left is the
    probability that it has not, over that of a place nobody looked at. Below 1: likely burned; above 1: likely not.
    """
    evidence = np.zeros(len(frame))
    for table in situation.burned_area:
        looks = table[table["time"] <= situation.time]
        points = looks.geometry.representative_point()
        age_h = (situation.time - looks["time"]).dt.total_seconds().to_numpy() / 3600
        told = burn_evidence.log_likelihood_ratio(looks) * np.where(age_h >= LONG_BURNED_H, 1.0, 0.5)
        reach_km = np.maximum(looks["along_m"].to_numpy() / 2000, lattice.spacing_km / 2)
        for x, y, ratio, reach in zip(points.x, points.y, told, reach_km, strict=True):
            east = (frame["longitude_deg"].to_numpy() - x) * np.cos(np.radians(y))
            near = KM_PER_DEGREE * np.hypot(east, frame["latitude_deg"].to_numpy() - y) <= reach
            evidence[near] += ratio
    return 2 / (1 + np.exp(evidence))


def _fire_report(
    incident: Any, front: Front, frame: pd.DataFrame, rating: dict[str, Any] | None, removed: int, mapped: bool
) -> dict[str, Any]:
    counts = {KINDS[index]: int(n) for index, n in frame["kind_index"].value_counts().sort_index().items()}
    largest = float(frame["priority"].max()) if len(frame) else 0.0
    row = {
        "incident_id": incident.incident_id,
        "name": incident.name,
        "targets": len(frame),
        "targets_by_kind": counts,
        "targets_removed_as_burned": removed,
        "priority_largest": largest,
        "staleness_mean": float(frame["staleness"].mean()) if len(frame) else None,
        "spread_m_s": front.spread_m_s,
        "from_arrival_map": mapped,
        "rated": rating is not None,
    }
    row["reason"] = _reason(row, rating)
    return row


def _reason(row: dict[str, Any], rating: dict[str, Any] | None) -> str:
    """One line: why this fire ranks where it does."""
    if not row["targets"]:
        return f"{row['name']}: no place within the area is worth a look."
    if rating is None:
        chance = "not rated, so taken at 5 % (0 to 100 %)"
    else:
        low, high = 100 * rating["probability_low"], 100 * rating["probability_high"]
        chance = (
            f"probability of a large fire {100 * rating['probability']:.1f} % ({low:.1f} to {high:.1f} %), above "
            f"{rating['percentile']:.0f} % of past fires; {rating['drivers']}"
        )
        if rating["imputed"]:
            chance += f"; imputed: {rating['imputed']}"
        if rating["out_of_domain"]:
            chance += "; outside what the model was trained on"
    places = ", ".join(f"{count} {kind}" for kind, count in row["targets_by_kind"].items())
    source = "arrival map" if row["from_arrival_map"] else "incident and detections"
    text = f"{row['name']}: r up to {row['priority_largest']:.2f}; {chance}"
    text += f"; {row['targets']} places ({places}) from {source}"
    if row["staleness_mean"] < 0.999:
        text += f"; lately observed, staleness {row['staleness_mean']:.2f} on average"
    if row["targets_removed_as_burned"]:
        text += f"; {row['targets_removed_as_burned']} places dropped as burned out"
    return text + "."
