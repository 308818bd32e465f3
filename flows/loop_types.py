"""What the loop is given and what it hands on: settings, a case, a cycle's products, the handover to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

Reference = Mapping[str, Any]
BUNDLE = "bundle"  # the part of a case that holds its inputs; a live cycle's own is ``bundle-{cycle}``
FEEDBACKS = {
    "soil-moisture": "soil moisture into pre-fire danger",
    "burned-area-danger": "burned area into pre-fire danger",
    "burned-area-targets": "burned area into active targets",
    "arrival": "arrival front and its uncertainty into active targets",
    "observed": "what was not observed into priorities",
    "spacecraft": "stored images and battery into the plan",
}


@dataclass(frozen=True)
class LoopSettings:
    """What an operator chooses. Work is counted, not timed, so that the same inputs give the same bytes."""

    cycle_hours: int = 24
    overlap_hours: int = 6
    release_after_h: float = 1.0
    level1_latency_h: float = 2.0  # from the end of a contact to level-1 data
    target_radius_km: float = 10.0
    access: Mapping[str, Any] = field(default_factory=dict)
    targets: Mapping[str, Any] = field(default_factory=dict)
    planning: Mapping[str, Any] = field(default_factory=dict)
    arrival: Mapping[str, Any] = field(default_factory=dict)
    map_seen_fires_only: bool = False  # no arrival map of a fire that no satellite saw: for a whole country's fires
    seed: int = 1


@dataclass(frozen=True)
class CaseInputs:
    """A case in the store: its head and its references by logical name."""

    name: str
    region: tuple[float, float, float, float]
    first_cutoff: datetime
    inputs: Mapping[str, Reference]
    nature: Mapping[str, Reference]
    reference: Reference | None = None  # per-cell soil moisture regression, made from the days before the first cycle
    baseline: Reference | None = None  # per-cell reflectivity before the fires, from the same days


@dataclass(frozen=True)
class Handover:
    """What a finished cycle leaves to the next."""

    soil_moisture: tuple[Reference, ...] = ()
    burned_area: tuple[Reference, ...] = ()
    fire_arrival: tuple[Reference, ...] = ()
    observed: Reference | None = None
    ratings: Reference | None = None  # these two only say what changed since; they change no number
    targets_report: Reference | None = None
    schedule: Reference | None = None
    as_run: Reference | None = None
    spacecraft: Reference | None = None
    pending_points: Reference | None = None


@dataclass(frozen=True)
class CycleProducts:
    """Everything a cycle made, by process, and its handover."""

    label: str
    cutoff: datetime
    end: datetime
    steps: Mapping[str, Mapping[str, Any]]
    handover: Handover


def cycle_label(cutoff: datetime) -> str:
    """The name of a cycle: its cut-off."""
    return cutoff.strftime("%Y%m%dT%H%MZ")
