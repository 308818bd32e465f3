"""Active targets: each fire's expected front on the lattice, priced by rating, staleness and what is burned."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import geopandas
import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization import expected_front, fire_reports, observation_age, reward
from services.prioritization.expected_front import WEIGHTLESS, Front
from services.prioritization.fire_reports import Previous
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
    previous: Previous = field(default_factory=Previous)


def active_targets(situation: Situation, lattice: Lattice) -> tuple[pd.DataFrame, list[dict[str, Any]]]:
    """Target rows (target_id, priority, low, high, source, longitude_deg, latitude_deg, …) and a report row a fire.

    A place claimed by two fires goes to the one that gives it the larger reward.
    """
    known = situation.incidents[situation.incidents["known_at"] <= situation.time]
    ratings = fire_reports.latest_ratings(situation.ratings, situation.time)
    frames, reports = [], []
    for incident in known.itertuples():
        front = _front(incident, situation, lattice)
        frame = _on_lattice(front, lattice, situation.area)
        rating = ratings.get(incident.incident_id)
        frame, removed = _priced(frame, rating or UNRATED, situation, lattice)
        frame["source"] = "incident:" + incident.incident_id
        frames.append(frame)
        mapped = incident.incident_id in situation.arrival_maps
        reports.append(fire_reports.report_row(incident, front, frame, rating, removed, mapped))
    fire_reports.finish(reports, ratings, situation.previous)
    columns = ["target_id", "priority", "priority_low", "priority_high", "source", "longitude_deg", "latitude_deg"]
    if not frames:
        return pd.DataFrame(columns=columns), reports
    table = pd.concat(frames, ignore_index=True)
    table = table.sort_values(["target_id", "priority", "source"], ascending=[True, False, True], kind="stable")
    return table.drop_duplicates("target_id").reset_index(drop=True), reports


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
    return Front(expected_front.joined(parts), front.spread_m_s, front.known_until, front.forecast)


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
