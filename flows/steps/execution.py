"""Execution of a plan: ``as_run``, the state the next cycle starts from, and which measurements have come down."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING

from pydantic import Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    import pandas as pd

    from flows.steps.delivery import SortedPoints


class ExecuteInputs(ProcessInputs):
    schedule: ArtifactRef = Field(description="schedule in force")
    spacecraft: ArtifactRef = Field(description="spacecraft document at the start of the cycle")
    contacts: ArtifactRef = Field(description="station contacts")
    eclipses: ArtifactRef = Field(description="eclipses")
    specular_points: ArtifactRef = Field(description="specular points over the region in this cycle")
    pending_points: ArtifactRef | None = Field(None, description="points of earlier cycles not yet on the ground")
    previous_as_run: ArtifactRef | None = Field(None, description="as_run of the cycle before")
    duration_s: int = Field(gt=0, description="length of the cycle, s")
    loss_share: float = Field(0.02, ge=0, le=1, description="share of downlinked images lost in transmission")
    level1_latency_s: int = Field(7200, ge=0, description="from the end of a contact to level-1 data, nominal mode")
    release_after_s: int = Field(3600, ge=0, description="from the end of the cycle to the release of the next plan")


class ExecuteOutputs(ProcessOutputs):
    as_run: ArtifactRef
    spacecraft: ArtifactRef
    nominal_points: ArtifactRef
    raw_if_points: ArtifactRef
    pending_points: ArtifactRef
    latency: ArtifactRef
    collected: int
    downlinked: int
    lost: int
    stored: int


def execute(inputs: ExecuteInputs, context: JobContext) -> ExecuteOutputs:
    """Play the schedule and sort the specular points into delivered and pending."""
    import pandas as pd

    from flows.steps import delivery
    from flows.steps.latency import latency_budget
    from flows.steps.replay import execute_schedule
    from shared.contracts import tables
    from shared.contracts.spacecraft import Spacecraft

    spacecraft = Spacecraft.model_validate(context.read_json(inputs.spacecraft))
    end = pd.Timestamp(spacecraft.horizon_start) + pd.Timedelta(seconds=inputs.duration_s)
    earlier = _read_or_empty(context, inputs.previous_as_run, "AS_RUN")
    carried = earlier[earlier["status"] == "collected"]
    contacts = context.read_table(inputs.contacts, "CONTACTS")
    eclipses = context.read_table(inputs.eclipses, "ECLIPSES")
    points = context.read_table(inputs.specular_points, "SPECULAR_POINTS")
    done = execute_schedule(
        context.read_table(inputs.schedule, "SCHEDULE"),
        carried,
        eclipses,
        spacecraft,
        inputs.duration_s,
        inputs.loss_share,
        # A satellite that no station sees all day has no contact, but it flies.
        set(contacts["satellite"]) | set(eclipses["satellite"]) | set(points["satellite"]),
    )
    points = points[points["time"] < end]
    if inputs.pending_points is not None:
        points = pd.concat([context.read_table(inputs.pending_points, "SPECULAR_POINTS"), points], ignore_index=True)
    sorted_points = delivery.sort_points(points, done.as_run, contacts, end, inputs.level1_latency_s)
    budget = latency_budget(
        _delivered(done.as_run, sorted_points, inputs.level1_latency_s),
        contacts,
        done.states,
        end,
        timedelta(seconds=inputs.release_after_s),
    )
    horizon = {"horizon_start": end.to_pydatetime(), "satellites": {n: s.model_dump() for n, s in done.states.items()}}
    following = spacecraft.at_horizon(horizon)
    counts = done.as_run["status"].value_counts()
    as_run = tables.AS_RUN.check(done.as_run)
    return ExecuteOutputs(
        as_run=context.write_table("as_run.parquet", as_run, "AS_RUN"),
        spacecraft=context.write_json("spacecraft.json", following.model_dump(mode="json")),
        nominal_points=context.write_table("nominal_points.parquet", sorted_points.nominal, "SPECULAR_POINTS"),
        raw_if_points=context.write_table("raw_if_points.parquet", sorted_points.raw_if, "SPECULAR_POINTS"),
        pending_points=context.write_table("pending_points.parquet", sorted_points.pending, "SPECULAR_POINTS"),
        latency=context.write_json("latency.json", budget),
        collected=int((as_run["start"] >= pd.Timestamp(spacecraft.horizon_start)).sum()),
        downlinked=int(counts.get("downlinked", 0)),
        lost=int(counts.get("lost", 0)),
        stored=int(counts.get("collected", 0)),
    )


def _delivered(as_run: pd.DataFrame, points: SortedPoints, level1_latency_s: int) -> dict[str, pd.DataFrame]:
    """Observations that this cycle's products are made of: when observed, downlinked and ready, by mode."""
    import pandas as pd

    down = as_run[as_run["status"] == "downlinked"]
    raw_if = pd.DataFrame(
        {"observed": down["start"], "downlinked": down["downlinked_at"], "ready": down["downlinked_at"]}
    )
    nominal = pd.DataFrame({"observed": points.nominal["time"], "downlinked": points.nominal_down_at})
    nominal["ready"] = nominal["downlinked"] + pd.Timedelta(seconds=level1_latency_s)
    return {"raw-if": raw_if, "nominal": nominal}


def _read_or_empty(context: JobContext, reference: ArtifactRef | None, contract: str) -> pd.DataFrame:
    import pandas as pd

    from shared.contracts import tables

    if reference is not None:
        return context.read_table(reference, contract)
    return pd.DataFrame({column.name: [] for column in tables.ALL[contract].columns})


EXECUTE = Process(
    "execute",
    "Execute the plan",
    "Plays the schedule: images collected, downlinked or lost; storage and battery at the end.",
    ExecuteInputs,
    ExecuteOutputs,
    execute,
)
