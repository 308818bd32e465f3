"""The stages of a cycle: prioritise → decide → predict access and plan → uplink and execute → retrieve and infer."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from flows.desk.approval import Desk
from flows.loop_types import CaseInputs, Handover, LoopSettings, cycle_label
from flows.runner import Runner
from flows.steps import APPLY_DECISIONS, ASSEMBLE_INPUTS, EXECUTE, OBSERVED_PLACES, SEEN_FIRES, SET_HORIZON, UPLINK

# Options that are rules of the plan: the check must know them as well.
PLAN_RULES = (
    "frozen_until",
    "change_penalty",
    "min_collect_s",
    "mode_switch_s",
    "max_commands_per_day",
    "booked_passes",
    "acquisition_s",
    "nominal_share",
    "outages",
    "target_changes",
)
KNOWN_INPUTS = ("incidents", "incident_reports", "detections", "weather_analysis", "weather_forecast", "perimeters")


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
    rated = rate_active(runner, case, cutoff)
    known, ratings = rated["assemble-inputs"], rated["rate-active-fires"]
    moisture = rated["forecast-fuel-moisture"]["fuel_moisture"]
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
            "previous_ratings": given.ratings,
            "previous_report": given.targets_report,
            "area": list(case.region),
            "time": at,
            "horizon_h": settings.cycle_hours,
            **settings.targets,
        },
    )
    return {**rated, "rate-prefire-danger": danger, "build-targets": targets}


def rate_active(runner: Runner, case: CaseInputs, at: datetime) -> dict[str, Mapping[str, Any]]:
    """What is known at a moment, and the ratings of the fires that are known."""
    time = at.isoformat()
    known = runner.local(ASSEMBLE_INPUTS, {"cutoff": time, **{name: case.inputs.get(name) for name in KNOWN_INPUTS}})
    fuel = runner.service("prioritization", "forecast-fuel-moisture", {"weather": known["weather"], "time": time})
    given = {
        "incidents": known["incidents"],
        "weather": known["weather"],
        "fuels": case.inputs["fuels"],
        "fuel_moisture": fuel["fuel_moisture"],
        "time": time,
    }
    ratings = runner.service("prioritization", "rate-active-fires", given)
    return {"assemble-inputs": known, "forecast-fuel-moisture": fuel, "rate-active-fires": ratings}


def decide(
    runner: Runner, desk: Desk, cycle: str, steps: Mapping[str, Mapping[str, Any]]
) -> dict[str, Mapping[str, Any]]:
    """What people decided about targets."""
    targets = steps["build-targets"]["targets"]
    added, changes = desk.additions(cycle), desk.target_changes(cycle)
    if not added and not changes:
        return {"apply-decisions": {"targets": targets, "target_changes": []}}
    given = {"targets": targets, "additions": added, "target_changes": changes}
    return {"apply-decisions": runner.local(APPLY_DECISIONS, given)}


def plan(
    runner: Runner,
    case: CaseInputs,
    cutoff: datetime,
    given: Handover,
    steps: Mapping[str, Mapping[str, Any]],
    settings: LoopSettings,
    desk: Desk,
) -> dict[str, Mapping[str, Any]]:
    """Where the satellites can look and talk, what they shall do, who approves it, and what of it reaches them."""
    horizon_s = (settings.cycle_hours + settings.overlap_hours) * 3600
    access = runner.service(
        "access",
        "predict-access",
        {
            **{name: case.inputs[name] for name in ("receivers", "transmitters", "stations")},
            "targets": steps["apply-decisions"]["targets"],
            "start": cutoff.isoformat(),
            "duration_s": horizon_s,
            "target_radius_km": settings.target_radius_km,
            "area": list(case.region),
            "with_specular_points": True,
            "with_figures": True,
            **settings.access,
        },
    )
    release = cutoff + timedelta(hours=settings.release_after_h)
    state = given.spacecraft or case.inputs["spacecraft"]
    horizon = {"spacecraft": state, "horizon_start": cutoff.isoformat(), "horizon_s": horizon_s}
    spacecraft = runner.local(SET_HORIZON, horizon)["spacecraft"]
    request = {
        **{name: access[name] for name in ("opportunities", "contacts", "eclipses")},
        "targets": steps["apply-decisions"]["targets"],
        "spacecraft": spacecraft,
        "release": release.isoformat(),
        "previous_schedule": given.schedule,
    }
    if changes := steps["apply-decisions"]["target_changes"]:
        request["target_changes"] = changes
    request |= {name: value for name, value in settings.planning.items() if name in PLAN_RULES}
    drawn = {"specular_points": access["specular_points"]}
    planned = runner.service("planning", "plan-observations", {**request, **drawn, **settings.planning})
    checked = runner.service("planning", "check-plan", {**request, "schedule": planned["schedule"]})
    if not checked["valid"]:
        raise RuntimeError(f"the plan was rejected by its check: {checked['violations']}")
    approval = desk.approval(cycle_label(cutoff), planned["schedule"], release)
    sent = {"schedule": planned["schedule"], "contacts": access["contacts"], "release": release.isoformat(), **approval}
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
            "release_after_s": round(settings.release_after_h * 3600),
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
    known = runner.local(
        ASSEMBLE_INPUTS, {"cutoff": end.isoformat(), **{name: case.inputs.get(name) for name in KNOWN_INPUTS}}
    )
    before_fire = {"baseline": case.baseline, "perimeters": known["perimeters"]}  # perimeters are only drawn
    burned = runner.service("retrieval", "retrieve-burned-area", {**seen, **before_fire})
    moisture = runner.service("retrieval", "retrieve-soil-moisture", {**seen, "reference": case.reference})
    fires = {name: known[name] for name in ("incidents", "detections")}
    if settings.map_seen_fires_only:
        fires["incidents"] = runner.local(SEEN_FIRES, fires)["incidents"]
    arrival = runner.service(
        "arrival",
        "infer-fire-arrival",
        {
            **fires,
            "weather": known["weather"],
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
