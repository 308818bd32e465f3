"""The 24-hour loop: prioritise → predict access → plan → uplink → execute → retrieve → infer arrival → publish.

Pure orchestration over a Runner: no Prefect, no HTTP, no clock. What a cycle hands to the next is a Handover; what the
next cycle takes from it is a set of feedbacks, so that each can be removed and its effect seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from flows.runner import Runner
from flows.steps import ASSEMBLE_INPUTS, EXECUTE, OBSERVED_PLACES, SET_HORIZON, UPLINK

Reference = Mapping[str, Any]

SOIL_MEMORY_H = 72  # older soil moisture says little about the day ahead
KNOWN_INPUTS = ("incidents", "incident_reports", "detections", "weather_analysis", "weather_forecast")
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


def run_cycle(
    runner: Runner,
    case: CaseInputs,
    cutoff: datetime,
    before: Handover,
    feedback: frozenset[str],
    settings: LoopSettings,
) -> CycleProducts:
    """One cycle. Of ``before``, the earlier cycle's handover, only the named feedbacks enter the plan."""
    end = cutoff + timedelta(hours=settings.cycle_hours)
    given = taken(before, feedback)
    steps: dict[str, Mapping[str, Any]] = {}
    steps.update(prioritise(runner, case, cutoff, given, feedback, settings))
    steps.update(plan(runner, case, cutoff, given, steps, settings))
    steps.update(observe(runner, case, before, steps, settings))
    steps.update(understand(runner, case, end, before, steps, settings))
    return CycleProducts(cycle_label(cutoff), cutoff, end, steps, handover(before, steps, settings))


def taken(before: Handover, feedback: frozenset[str]) -> Handover:
    """The part of a handover that the chosen feedbacks let through to the next plan.

    The old schedule always passes: its commands are on board and run until the uplink, whether one minds them or not.
    """
    return Handover(
        soil_moisture=before.soil_moisture if "soil-moisture" in feedback else (),
        burned_area=before.burned_area,
        fire_arrival=before.fire_arrival if "arrival" in feedback else (),
        observed=before.observed if "observed" in feedback else None,
        schedule=before.schedule,
        spacecraft=before.spacecraft if "spacecraft" in feedback else None,
    )


def prioritise(
    runner: Runner,
    case: CaseInputs,
    cutoff: datetime,
    given: Handover,
    feedback: frozenset[str],
    settings: LoopSettings,
) -> dict[str, Mapping[str, Any]]:
    """What is known at the cut-off, rated, and turned into targets on one reward scale."""
    at = cutoff.isoformat()
    known = runner.local(ASSEMBLE_INPUTS, {"cutoff": at, **{name: case.inputs.get(name) for name in KNOWN_INPUTS}})
    fuel = runner.service("prioritization", "forecast-fuel-moisture", {"weather": known["weather"], "time": at})
    moisture = fuel["fuel_moisture"]
    rated = {
        "incidents": known["incidents"],
        "weather": known["weather"],
        "fuels": case.inputs["fuels"],
        "fuel_moisture": moisture,
        "time": at,
    }
    ratings = runner.service("prioritization", "rate-active-fires", rated)
    burned = list(given.burned_area)
    danger = runner.service(
        "prioritization",
        "rate-prefire-danger",
        {
            "weather": known["weather"],
            "fuels": case.inputs["fuels"],
            "fuel_moisture": moisture,
            "soil_moisture": list(given.soil_moisture),
            "burned_area": burned if "burned-area-danger" in feedback else [],
            "time": at,
        },
    )
    targets = runner.service(
        "prioritization",
        "build-targets",
        {
            "incidents": known["incidents"],
            "ratings": ratings["ratings"],
            "danger": danger["danger"],
            "detections": known["detections"],
            "fire_arrival": list(given.fire_arrival),
            "burned_area": burned if "burned-area-targets" in feedback else [],
            "observed": given.observed,
            "area": list(case.region),
            "time": at,
            "horizon_h": settings.cycle_hours,
            **settings.targets,
        },
    )
    return {
        "assemble-inputs": known,
        "forecast-fuel-moisture": fuel,
        "rate-active-fires": ratings,
        "rate-prefire-danger": danger,
        "build-targets": targets,
    }


def plan(
    runner: Runner,
    case: CaseInputs,
    cutoff: datetime,
    given: Handover,
    steps: Mapping[str, Mapping[str, Any]],
    settings: LoopSettings,
) -> dict[str, Mapping[str, Any]]:
    """Where the satellites can look and talk, what they shall do, and what of it reaches them."""
    horizon_s = (settings.cycle_hours + settings.overlap_hours) * 3600
    access = runner.service(
        "access",
        "predict-access",
        {
            **{name: case.inputs[name] for name in ("receivers", "transmitters", "stations")},
            "targets": steps["build-targets"]["targets"],
            "start": cutoff.isoformat(),
            "duration_s": horizon_s,
            "target_radius_km": settings.target_radius_km,
            "area": list(case.region),
            "with_specular_points": True,
            **settings.access,
        },
    )
    release = cutoff + timedelta(hours=settings.release_after_h)
    state = given.spacecraft or case.inputs["spacecraft"]
    horizon = {"spacecraft": state, "horizon_start": cutoff.isoformat(), "horizon_s": horizon_s}
    spacecraft = runner.local(SET_HORIZON, horizon)["spacecraft"]
    request = {
        **{name: access[name] for name in ("opportunities", "contacts", "eclipses")},
        "targets": steps["build-targets"]["targets"],
        "spacecraft": spacecraft,
        "release": release.isoformat(),
        "previous_schedule": given.schedule,
    }
    planned = runner.service("planning", "plan-observations", {**request, **settings.planning})
    checked = runner.service("planning", "check-plan", {**request, "schedule": planned["schedule"]})
    if not checked["valid"]:
        raise RuntimeError(f"the plan was rejected by its check: {checked['violations']}")
    sent = {"schedule": planned["schedule"], "contacts": access["contacts"], "release": release.isoformat()}
    return {
        "predict-access": access,
        "set-horizon": {"spacecraft": spacecraft},
        "plan-observations": planned,
        "check-plan": checked,
        "uplink": runner.local(UPLINK, sent),
    }


def observe(
    runner: Runner, case: CaseInputs, before: Handover, steps: Mapping[str, Mapping[str, Any]], settings: LoopSettings
) -> dict[str, Mapping[str, Any]]:
    """Execution, and the measurements that have come down by the end of the cycle."""
    access = steps["predict-access"]
    run = runner.local(
        EXECUTE,
        {
            "schedule": steps["plan-observations"]["schedule"],
            "spacecraft": before.spacecraft or steps["set-horizon"]["spacecraft"],
            **{name: access[name] for name in ("contacts", "eclipses", "specular_points")},
            "pending_points": before.pending_points,
            "previous_as_run": before.as_run,
            "duration_s": settings.cycle_hours * 3600,
            "level1_latency_s": round(settings.level1_latency_h * 3600),
        },
    )
    common = {"surface": case.nature["surface"], "seed": settings.seed}
    steps_made: dict[str, Mapping[str, Any]] = {"execute": run}
    if "level1" not in case.inputs:
        nominal = {**common, "specular_points": run["nominal_points"], "nominal": True, "raw_if": False}
        steps_made["simulate-nominal"] = runner.service("retrieval", "simulate-observations", nominal)
    if run["downlinked"]:
        raw_if = {"specular_points": run["raw_if_points"], "images": run["as_run"], "nominal": False, "raw_if": True}
        steps_made["simulate-raw-if"] = runner.service("retrieval", "simulate-observations", {**common, **raw_if})
    return steps_made


def understand(
    runner: Runner,
    case: CaseInputs,
    end: datetime,
    before: Handover,
    steps: Mapping[str, Mapping[str, Any]],
    settings: LoopSettings,
) -> dict[str, Mapping[str, Any]]:
    """Burned area, soil moisture and fire arrival, from what had been delivered by the end of the cycle."""
    observations = [case.inputs["level1"]] if "level1" in case.inputs else [steps["simulate-nominal"]["nominal"]]
    if "simulate-raw-if" in steps:
        observations.append(steps["simulate-raw-if"]["raw_if"])
    seen: dict[str, Any] = {"observations": observations}
    if (
        "level1" in case.inputs
    ):  # a file of many days: only this cycle's, and only what had become level-1 data by its end
        latest = end - timedelta(hours=settings.level1_latency_h)
        earliest = latest - timedelta(hours=settings.cycle_hours)
        seen |= {"time_from": earliest.isoformat(), "time_to": latest.isoformat()}
    burned = runner.service("retrieval", "retrieve-burned-area", {**seen, "baseline": case.baseline})
    moisture = runner.service("retrieval", "retrieve-soil-moisture", {**seen, "reference": case.reference})
    known = runner.local(
        ASSEMBLE_INPUTS, {"cutoff": end.isoformat(), **{name: case.inputs.get(name) for name in KNOWN_INPUTS}}
    )
    arrival = runner.service(
        "arrival",
        "infer-fire-arrival",
        {
            "detections": known["detections"],
            "incidents": known["incidents"],
            "burned_area": [*before.burned_area, burned["burned_area"]],
            "start": (case.first_cutoff - timedelta(days=3)).isoformat(),
            "end": end.isoformat(),
            "seed": settings.seed,
            **settings.arrival,
        },
    )
    observed = runner.local(OBSERVED_PLACES, {"burned_area": burned["burned_area"], "before": before.observed})
    return {
        "retrieve-burned-area": burned,
        "retrieve-soil-moisture": moisture,
        "known-at-end": known,
        "infer-fire-arrival": arrival,
        "observed-places": observed,
    }


def handover(before: Handover, steps: Mapping[str, Mapping[str, Any]], settings: LoopSettings) -> Handover:
    """What the next cycle may start from: products of delivered data and ``as_run``, never the plan's intentions."""
    remembered = -(-SOIL_MEMORY_H // settings.cycle_hours)
    return Handover(
        soil_moisture=(*before.soil_moisture, steps["retrieve-soil-moisture"]["soil_moisture"])[-remembered:],
        burned_area=(*before.burned_area, steps["retrieve-burned-area"]["burned_area"]),
        fire_arrival=tuple(steps["infer-fire-arrival"]["fire_arrival"]),
        observed=steps["observed-places"]["observed"],
        schedule=steps["plan-observations"]["schedule"],
        as_run=steps["execute"]["as_run"],
        spacecraft=steps["execute"]["spacecraft"],
        pending_points=steps["execute"]["pending_points"],
    )
