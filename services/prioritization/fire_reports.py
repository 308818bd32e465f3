"""For each fire a line: why it ranks where it does, and what changed since its last rating."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from services.prioritization.expected_front import KINDS, Front

INPUTS = {
    "temperature_c": ("temperature", "degC", 3.0),
    "relative_humidity_pct": ("relative humidity", "%", 8.0),
    "wind_speed_m_s": ("wind", "m/s", 1.5),
    "kbdi_mm": ("KBDI", "mm", 8.0),
    "dead_fuel_moisture_10h_pct": ("10-h fuel moisture", "%", 1.5),
}
"""Rating columns whose change is told: name for people, unit, and what counts as one step of change."""
NOTABLE_STEPS = 0.5
SHOWN_CHANGES = 3


@dataclass(frozen=True)
class Previous:
    """The last rating of each incident and the last report's row of it; both may be empty."""

    ratings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    fires: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def latest_ratings(ratings: pd.DataFrame, time: pd.Timestamp) -> dict[str, dict[str, Any]]:
    """The latest rating of each incident known at ``time``, as a row."""
    known = ratings[ratings["time"] <= time].sort_values("time", kind="stable")
    return {
        str(row["incident_id"]): row for row in known.drop_duplicates("incident_id", keep="last").to_dict("records")
    }


def previous_ratings(
    ratings: pd.DataFrame, given: pd.DataFrame | None, time: pd.Timestamp
) -> dict[str, dict[str, Any]]:
    """The rating of each incident before its latest one: from ``given``, else from earlier rows of ``ratings``."""
    latest = latest_ratings(ratings, time)
    tables = [ratings] if given is None else [ratings, given]
    earlier = pd.concat(tables, ignore_index=True) if len(tables) > 1 else ratings
    times = pd.Series({name: row["time"] for name, row in latest.items()}, dtype=ratings["time"].dtype)
    current = earlier["incident_id"].astype(str).map(times)
    # A fire that the latest ratings have left out was last rated by any row there is.
    older = earlier[current.isna() | (earlier["time"] < current)]
    return latest_ratings(older, time)


def report_row(
    incident: Any,
    front: Front,
    frame: pd.DataFrame,
    rating: dict[str, Any] | None,
    removed: int,
    mapped: bool,
) -> dict[str, Any]:
    """What the report says of a fire, but for its rank and line (see ``finish``)."""
    counts = {KINDS[index]: int(n) for index, n in frame["kind_index"].value_counts().sort_index().items()}
    best = frame.loc[frame["priority"].idxmax()] if len(frame) else None
    return {
        "incident_id": incident.incident_id,
        "name": incident.name,
        "targets": len(frame),
        "targets_by_kind": counts,
        "targets_removed_as_burned": removed,
        "priority_largest": float(best["priority"]) if best is not None else 0.0,
        "priority_largest_low": float(best["priority_low"]) if best is not None else 0.0,
        "priority_largest_high": float(best["priority_high"]) if best is not None else 0.0,
        "worth_of_largest": float(best["worth"]) if best is not None else None,
        "staleness_of_largest": float(best["staleness"]) if best is not None else None,
        "staleness_mean": float(frame["staleness"].mean()) if len(frame) else None,
        "spread_m_s": front.spread_m_s,
        "from_arrival_map": mapped,
        "from_front_forecast": front.forecast,
        "rated": rating is not None,
        "probability": float(rating["probability"]) if rating is not None else None,
    }


def finish(rows: list[dict[str, Any]], ratings: Mapping[str, dict[str, Any]], previous: Previous) -> None:
    """Rank the rows in place, by the largest priority, and give each its line."""
    rows.sort(key=lambda row: (-row["priority_largest"], row["incident_id"]))
    for rank, row in enumerate(rows, start=1):
        row["rank"] = rank
        name = row["incident_id"]
        row["change"] = _change(row, ratings.get(name), previous.ratings.get(name), previous.fires.get(name))
        row["reason"] = f"{_reason(row, ratings.get(name), len(rows))} {row['change']}"


def _reason(row: dict[str, Any], rating: dict[str, Any] | None, fires: int) -> str:
    if not row["targets"]:
        return f"{row['name']}, {row['rank']} of {fires}: no place within the area is worth a look."
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
    text = (
        f"{row['name']}, {row['rank']} of {fires}: r up to {row['priority_largest']:.2f} "
        f"({row['priority_largest_low']:.2f} to {row['priority_largest_high']:.2f}) where the place is worth "
        f"{row['worth_of_largest']:.2f} and staleness {row['staleness_of_largest']:.2f}; {chance}; {_places(row)}"
    )
    if row["staleness_mean"] < 0.999:
        text += f"; lately observed, staleness {row['staleness_mean']:.2f} on average"
    if row["targets_removed_as_burned"]:
        text += f"; {row['targets_removed_as_burned']} places dropped as burned out"
    return text + "."


def _places(row: dict[str, Any]) -> str:
    places = ", ".join(f"{count} {kind}" for kind, count in row["targets_by_kind"].items())
    source = "arrival map" if row["from_arrival_map"] else "incident and detections"
    if row["from_front_forecast"]:
        source += " with its forecast of the front"
    return f"{row['targets']} places ({places}) from {source}"


def _change(
    row: dict[str, Any],
    rating: Mapping[str, Any] | None,
    before: Mapping[str, Any] | None,
    reported: Mapping[str, Any] | None,
) -> str:
    """What is new since the last rating and report, in a sentence."""
    if before is None and reported is None:
        return "First rating." if rating is not None else "Not rated before."
    parts = []
    if before is not None and rating is None:
        parts.append(f"was rated {100 * before['probability']:.1f} %, now not rated")
    elif before is not None and rating is not None:
        hours = (pd.Timestamp(rating["time"]) - pd.Timestamp(before["time"])) / pd.Timedelta(hours=1)
        moved = _moved(100 * before["probability"], 100 * rating["probability"], " %")
        causes = _input_changes(before, rating)
        parts.append(f"probability {moved} in {hours:.0f} h" + (f" ({', '.join(causes)})" if causes else ""))
        if bool(before["out_of_domain"]) != bool(rating["out_of_domain"]):
            parts.append("now outside the training range" if rating["out_of_domain"] else "back in the training range")
        if before["imputed"] != rating["imputed"]:
            parts.append(f"imputed now: {rating['imputed'] or 'nothing'}")
    if reported is not None:
        if reported.get("rank") is not None:
            same = reported["rank"] == row["rank"]
            parts.append(f"rank {row['rank']} as before" if same else f"rank {reported['rank']} to {row['rank']}")
        if reported.get("targets") not in (None, row["targets"]):
            parts.append(f"places {reported['targets']} to {row['targets']}")
        if bool(reported.get("from_arrival_map")) != row["from_arrival_map"]:
            parts.append("has an arrival map now" if row["from_arrival_map"] else "its arrival map is gone")
    return f"Since the last rating: {'; '.join(parts)}." if parts else "Nothing changed since the last rating."


def _moved(before: float, now: float, unit: str) -> str:
    if f"{before:.1f}" == f"{now:.1f}":
        return f"{now:.1f}{unit} as before"
    return f"{before:.1f} to {now:.1f}{unit}"


def _input_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """The largest changes of the model's inputs, counted in steps that matter."""
    steps = {}
    for name, (label, unit, step) in INPUTS.items():
        old, new = before.get(name), now.get(name)
        if old is None or new is None or not (np.isfinite(old) and np.isfinite(new)):
            continue
        change = float(new) - float(old)
        if abs(change) >= NOTABLE_STEPS * step:
            steps[f"{label} {change:+.1f} {unit}"] = abs(change) / step
    return sorted(steps, key=lambda text: (-steps[text], text))[:SHOWN_CHANGES]
