"""One picture and one page of figures for the person who looks at 3 a.m."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class SituationInputs(ProcessInputs):
    title: str = Field(description="name of the case, for the heading")
    region: tuple[float, float, float, float] = Field(description="west, south, east, north in degrees")
    cutoff: AwareDatetime
    end: AwareDatetime
    targets: ArtifactRef
    schedule: ArtifactRef
    opportunities: ArtifactRef
    as_run: ArtifactRef
    burned_area: ArtifactRef
    fire_arrival: list[ArtifactRef]
    detections: ArtifactRef
    perimeters: ArtifactRef | None = Field(None, description="mapped perimeters known at the end of the cycle")
    truth: ArtifactRef | None = Field(None, description="the nature run's arrival times, drawn for comparison")


class SituationOutputs(ProcessOutputs):
    map: ArtifactRef
    covered_targets: int
    covered_active: int
    active_targets: int


def situation(inputs: SituationInputs, context: JobContext) -> SituationOutputs:
    """Draw the cycle: targets, what was recorded over them, what burned and when."""
    from flows.steps import situation_map

    layers = situation_map.read_layers(inputs, context)
    situation_map.draw(layers, inputs, context.new_file("situation.png"), context.product_attributes())
    active = layers.targets["kind"] == "active"
    covered = layers.targets["target_id"].isin(layers.covered_ids)
    return SituationOutputs(
        map=context.ref("situation.png"),
        covered_targets=int(covered.sum()),
        covered_active=int((covered & active).sum()),
        active_targets=int(active.sum()),
    )


SITUATION = Process(
    "situation",
    "Draw the situation",
    "A map of the cycle: targets, recordings, burned area, fire arrival.",
    SituationInputs,
    SituationOutputs,
    situation,
)
