"""The processes of the planning service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from shared.artifacts.reference import ArtifactRef
from shared.process.context import JobContext
from shared.process.declaration import Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    from services.planning.options.rules import OperationRules


class Outage(BaseModel):
    """A station or a satellite that is out of service: lost, or away for a while."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    satellite: str | None = Field(None, min_length=1, description="satellite out of service; this or station")
    station: str | None = Field(None, min_length=1, description="station out of service; this or satellite")
    start: AwareDatetime = Field(description="first moment of the outage")
    end: AwareDatetime | None = Field(None, description="end of the outage; null: not within the horizon")
    why: str = Field("", description="reason, kept in the report")

    @model_validator(mode="after")
    def _one_of_two(self) -> Outage:
        if (self.satellite is None) == (self.station is None):
            raise ValueError("an outage names either a satellite or a station")
        if self.end is not None and self.end <= self.start:
            raise ValueError(f"an outage must end after it starts: {self.start} to {self.end}")
        return self


class TargetChange(BaseModel):
    """What a person decided about one target; kept in the manifest and the report."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    target_id: int
    action: Literal["pin", "exclude", "reweight"] = Field(
        description="pin: must be observed; exclude: is worth nothing; reweight: takes the priority given here"
    )
    priority: float | None = Field(None, ge=0, description="new priority (reward before its factor 10); reweight only")
    who: str = Field(min_length=1, description="who decided it")
    why: str = Field(min_length=1, description="reason")
    when: AwareDatetime = Field(description="when it was decided")

    @model_validator(mode="after")
    def _priority_fits(self) -> TargetChange:
        if (self.action == "reweight") != (self.priority is not None):
            raise ValueError("a priority goes with reweight, and only with it")
        return self


class PlanningInputs(ProcessInputs):
    """The planning case: what can be seen, what it is worth, and what the satellites can do."""

    opportunities: ArtifactRef = Field(description="opportunities table: a row per image and target it covers")
    targets: ArtifactRef = Field(description="targets table with rewards")
    contacts: ArtifactRef = Field(description="contacts table of satellites with ground stations")
    eclipses: ArtifactRef = Field(description="eclipses table; umbra stops power generation")
    spacecraft: ArtifactRef = Field(description="spacecraft JSON: storage, battery, power, slews and horizon")
    release: AwareDatetime | None = Field(
        None,
        description="time at which the plan is released; a satellite takes new commands from the end of its first "
        "contact that starts at or after it, plus its uplink margin; null: from the first second",
    )
    previous_schedule: ArtifactRef | None = Field(
        None,
        description="schedule table that runs on until each satellite's uplink (with release) and until frozen_until; "
        "changes against it are listed",
    )
    frozen_until: AwareDatetime | None = Field(
        None, description="commands of the previous schedule that start earlier stay: executed, or not to be touched"
    )
    change_penalty: float = Field(
        0.0, ge=0, description="reward given up for each image of the previous schedule that could be kept and is not"
    )
    fragile_discount: float = Field(
        0.0, ge=0, le=1,
        description="share of a target's reward lost where it is observed only by looks that the satellite's "
        "along-track error may spoil: not covered both ahead and behind in the opportunities",
    )  # fmt: skip
    min_collect_s: int = Field(1, ge=1, description="shortest recording, s: unbroken collects of one satellite")
    mode_switch_s: int = Field(0, ge=0, description="idle seconds between a recording and a downlink")
    max_commands_per_day: int | None = Field(
        None, ge=0, description="recordings and unbroken downlinks of a satellite that start on one UTC day"
    )
    booked_passes: ArtifactRef | None = Field(
        None, description="contacts table of booked times; null: every contact may be used"
    )
    acquisition_s: float = Field(0.0, ge=0, description="seconds at the start of every usable pass that carry no data")
    nominal_share: float = Field(0.0, ge=0, le=1, description="share of every usable pass kept for nominal-mode data")
    outages: tuple[Outage, ...] = Field((), description="stations and satellites lost or out of service")
    target_changes: tuple[TargetChange, ...] = Field(
        (), description="targets pinned, excluded or re-weighted by a person"
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
        20.0,
        gt=0,
        le=10000,
        description="counted work for large cases, in millions of search steps on each of two threads: repeats exactly",
    )
    active_mandatory: Literal["auto", "true", "false"] = Field(
        "auto", description="observe every active target: auto keeps this while it can hold, true demands it"
    )
    price_options: bool = Field(
        True, description="plan again without each option in force, to report what it costs (a run for each)"
    )
    specular_points: ArtifactRef | None = Field(
        None, description="specular points table: draws the tracks of planned recordings on the maps"
    )


class PlanObservationsOutputs(ProcessOutputs):
    """A command schedule, checked second by second, with its proven bound."""

    schedule: ArtifactRef = Field(description="schedule table: a row per image and per unbroken downlink")
    report: ArtifactRef = Field(description="JSON: objective, bound, gap, targets, latency, reasons, baselines, prices")
    gantt: ArtifactRef = Field(description="PNG: chart of the constellation's commands over time")
    footprints: ArtifactRef = Field(description="GeoJSON: planned targets with the image that collects each; tracks")
    footprints_kml: ArtifactRef = Field(description="KML: the same by satellite")
    commands: list[ArtifactRef] = Field(description="CSV per satellite: time-tagged commands for people and programs")
    profiles: ArtifactRef = Field(description="table: storage and battery by satellite and minute")
    profiles_chart: ArtifactRef = Field(description="PNG: storage and battery of every satellite")
    images: ArtifactRef = Field(description="table: planned images with reward, end of downlink and latency")
    target_outcomes: ArtifactRef = Field(description="table: every target, observed by what or why not")
    changes: ArtifactRef | None = Field(description="CSV: commands kept, dropped and added against the previous plan")
    objective: float = Field(description="equation 1 (ten times active plus pre-fire) less changes and fragile looks")
    bound: float = Field(description="proven upper bound on the objective of any plan")
    gap: float = Field(description="(bound - objective) / bound")
    reward: float = Field(description="equation 1 alone: the objective where changes and fragile looks are free")
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
    return {
        "tables": tables, "spacecraft": spacecraft, "release": inputs.release, "previous": previous,
        "rules": _rules(inputs, context),
    }  # fmt: skip


def _rules(inputs: PlanningInputs, context: JobContext) -> OperationRules:
    import pandas as pd

    from services.planning.options import rules

    def utc(moment: Any) -> Any:
        return None if moment is None else pd.Timestamp(moment).tz_convert("UTC")

    outages = tuple(
        rules.Outage(utc(item.start), utc(item.end), item.satellite, item.station, item.why) for item in inputs.outages
    )
    changes = tuple(
        rules.TargetChange(item.target_id, item.action, item.who, item.why, utc(item.when), item.priority)
        for item in inputs.target_changes
    )
    booked = inputs.booked_passes
    return rules.OperationRules(
        min_collect_s=inputs.min_collect_s, mode_switch_s=inputs.mode_switch_s,
        max_commands_per_day=inputs.max_commands_per_day,
        booked=None if booked is None else context.read_table(booked, "CONTACTS"),
        acquisition_s=inputs.acquisition_s, nominal_share=inputs.nominal_share, outages=outages,
        target_changes=changes, frozen_until=utc(inputs.frozen_until), change_penalty=inputs.change_penalty,
        fragile_discount=inputs.fragile_discount,
    )  # fmt: skip


def plan_observations(inputs: PlanObservationsInputs, context: JobContext) -> PlanObservationsOutputs:
    """Plan, prove, check, and only then write."""
    from services.planning.operations import make_plan
    from services.planning.planner import Options
    from services.planning.products.files import write_products

    case = _case(inputs, context)
    options = Options(inputs.mip_gap, inputs.time_limit_s, inputs.work_limit, inputs.active_mandatory)
    made = make_plan(**case, options=options, progress=context.progress, price=inputs.price_options)
    points = inputs.specular_points
    tracks = context.read_table(points, "SPECULAR_POINTS") if points is not None else None
    files = write_products(context, made, case["tables"]["targets"], tracks, case["previous"] is not None)
    return PlanObservationsOutputs(
        **files,
        objective=made.plan.objective,
        bound=made.plan.bound,
        gap=made.plan.gap,
        reward=made.report["reward"],
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
        "dropped_images": verdict.dropped_images, "change_cost": verdict.change_cost,
        "fragile_targets": verdict.fragile_targets, "fragile_cost": verdict.fragile_cost,
    }  # fmt: skip
    return CheckPlanOutputs(
        report=context.write_json("report.json", document),
        valid=verdict.valid,
        violations=[str(violation) for violation in verdict.violations],
    )


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.planning.operations",
    "services.planning.products.files",
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
