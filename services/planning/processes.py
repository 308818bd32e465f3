"""The processes of the planning service."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import AwareDatetime, Field

from shared.artifacts.reference import ArtifactRef
from shared.process.context import JobContext
from shared.process.declaration import Process, ProcessInputs, ProcessOutputs


class PlanningInputs(ProcessInputs):
    """The planning case: what can be seen, what it is worth, and what the satellites can do."""

    opportunities: ArtifactRef = Field(description="opportunities table: a row per image and target it covers")
    targets: ArtifactRef = Field(description="targets table with rewards")
    contacts: ArtifactRef = Field(description="contacts table of satellites with ground stations")
    eclipses: ArtifactRef = Field(description="eclipses table; umbra stops power generation")
    spacecraft: ArtifactRef = Field(description="spacecraft JSON: storage, battery, power and horizon")
    release: AwareDatetime | None = Field(
        None,
        description="time at which the plan is released; a satellite takes new commands from the end of its first "
        "contact that starts at or after it, plus its uplink margin; null: from the first second",
    )
    previous_schedule: ArtifactRef | None = Field(
        None, description="schedule table that runs on until each satellite's uplink; used only with release"
    )


class PlanObservationsInputs(PlanningInputs):
    """A planning case and how hard to work on it."""

    mip_gap: float = Field(0.005, ge=0, le=1, description="relative gap between plan and proven bound to stop at")
    time_limit_s: float = Field(
        60.0,
        gt=0,
        le=7200,
        description="guard, s; a plan that it cuts is marked time_limited and may not repeat exactly",
    )
    work_limit: float = Field(
        20.0, gt=0, le=10000, description="counted work for large cases, in millions of search moves: repeats exactly"
    )
    active_mandatory: Literal["auto", "true", "false"] = Field(
        "auto", description="observe every active target: auto keeps this while it can hold, true demands it"
    )


class PlanObservationsOutputs(ProcessOutputs):
    """A command schedule, checked second by second, with its proven bound."""

    schedule: ArtifactRef = Field(description="schedule table: a row per image and per unbroken downlink")
    report: ArtifactRef = Field(description="JSON: objective, bound, gap, targets, latency, reasons, baseline")
    gantt: ArtifactRef = Field(description="PNG: chart of the constellation's commands over time")
    footprints: ArtifactRef = Field(description="GeoJSON: planned targets with the image that collects each")
    objective: float = Field(description="equation 1: ten times active plus pre-fire rewards observed")
    bound: float = Field(description="proven upper bound on the objective of any plan")
    gap: float = Field(description="(bound - objective) / bound")
    targets_planned: int = Field(description="targets observed at least once")
    time_limited: bool = Field(description="true where the time guard cut the work short")


class CheckPlanInputs(PlanningInputs):
    """A schedule and the case it is meant for."""

    schedule: ArtifactRef = Field(description="schedule table to check")


class CheckPlanOutputs(ProcessOutputs):
    """The verdict of a second-by-second replay."""

    report: ArtifactRef = Field(description="JSON: violations, objective, storage and battery at the end")
    valid: bool = Field(description="true where no rule is broken")
    violations: list[str] = Field(description="the first violation of each broken rule, in order of time")


def _case(inputs: PlanningInputs, context: JobContext) -> dict[str, Any]:
    from services.planning.spacecraft_limits import read_spacecraft

    tables = {
        name: context.read_table(getattr(inputs, name), name.upper())
        for name in ("opportunities", "targets", "contacts", "eclipses")
    }
    reference = inputs.previous_schedule
    previous = context.read_table(reference, "SCHEDULE") if reference is not None else None
    spacecraft = read_spacecraft(context.read_json(inputs.spacecraft))
    return {"tables": tables, "spacecraft": spacecraft, "release": inputs.release, "previous": previous}


def plan_observations(inputs: PlanObservationsInputs, context: JobContext) -> PlanObservationsOutputs:
    """Plan, prove, check, and only then write."""
    from services.planning import charts
    from services.planning.operations import make_plan
    from services.planning.planner import Options

    case = _case(inputs, context)
    options = Options(inputs.mip_gap, inputs.time_limit_s, inputs.work_limit, inputs.active_mandatory)
    made = make_plan(**case, options=options, progress=context.progress)
    attributes = context.product_attributes()
    title = f"Plan: {made.report['images_planned']} images, gap {100 * made.plan.gap:.3f} % to the proven bound"
    footer = f"simulated: {'yes' if attributes.get('simulated') else 'no'} · {attributes.get('code_version', '')}"
    charts.write_gantt(context.new_file("gantt.png"), made.problem, made.plan.timeline, title, footer)
    charts.write_footprints(
        context.new_file("footprints.geojson"), made.problem, made.plan.timeline, case["tables"]["targets"], attributes
    )
    return PlanObservationsOutputs(
        schedule=context.write_table("schedule.parquet", made.schedule, "SCHEDULE"),
        report=context.write_json("report.json", made.report),
        gantt=context.ref("gantt.png"),
        footprints=context.ref("footprints.geojson"),
        objective=made.plan.objective,
        bound=made.plan.bound,
        gap=made.plan.gap,
        targets_planned=sum(kind["planned"] for kind in made.report["targets"].values()),
        time_limited=made.plan.time_limited,
    )


def check_plan(inputs: CheckPlanInputs, context: JobContext) -> CheckPlanOutputs:
    """Replay a schedule from anywhere."""
    from services.planning.operations import judge

    schedule = context.read_table(inputs.schedule, "SCHEDULE")
    verdict = judge(schedule, **_case(inputs, context))
    document = {
        "valid": verdict.valid, "objective": verdict.objective, "images": len(verdict.images),
        "violations": [vars(violation) for violation in verdict.violations],
        "stored_at_end": verdict.stored_at_end, "battery_at_end_wh": verdict.battery_at_end_wh,
    }  # fmt: skip
    return CheckPlanOutputs(
        report=context.write_json("report.json", document),
        valid=verdict.valid,
        violations=[str(violation) for violation in verdict.violations],
    )


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.planning.charts",
    "services.planning.operations",
    "shared.contracts.tables",
)

PROCESSES = [
    Process(
        id="plan-observations",
        title="Plan observations",
        description="Near-optimal command schedule for the constellation, exact to the second, with a proven bound.",
        inputs=PlanObservationsInputs,
        outputs=PlanObservationsOutputs,
        run=plan_observations,
    ),
    Process(
        id="check-plan",
        title="Check a plan",
        description="Second-by-second replay of any schedule; names the first violation of each rule.",
        inputs=CheckPlanInputs,
        outputs=CheckPlanOutputs,
        run=check_plan,
    ),
]
