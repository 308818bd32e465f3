"""Where to look first, over a whole country: a map of the priorities of a cycle's targets."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class PriorityMapInputs(ProcessInputs):
    title: str = Field(description="name of the case, for the heading")
    region: tuple[float, float, float, float] = Field(description="west, south, east, north in degrees")
    cutoff: AwareDatetime
    targets: ArtifactRef = Field(description="targets table")
    incidents: ArtifactRef = Field(description="incidents known at the cut-off; column simulated where some are")
    ratings: ArtifactRef = Field(description="ratings of those incidents")
    opportunities: ArtifactRef = Field(description="opportunities of the cycle: what can be reached at all")


class PriorityMapOutputs(ProcessOutputs):
    map: ArtifactRef
    fires: ArtifactRef
    fires_known: int
    fires_simulated: int


def priority_map(inputs: PriorityMapInputs, context: JobContext) -> PriorityMapOutputs:
    """Draw the map, and list the fires by how likely each is to become large."""
    from flows.steps import priority_map_drawing

    layers = priority_map_drawing.read_layers(inputs, context)
    attributes = context.product_attributes()
    priority_map_drawing.draw(layers, inputs, context.new_file("priority_map.png"), attributes)
    columns = ["rank", "incident_id", "name", "probability", "simulated", "reachable", "longitude_deg", "latitude_deg"]
    layers.fires[columns].to_csv(context.new_file("fires.csv"), index=False, lineterminator="\n")
    return PriorityMapOutputs(
        map=context.ref("priority_map.png"),
        fires=context.ref("fires.csv"),
        fires_known=len(layers.fires),
        fires_simulated=int(layers.fires["simulated"].sum()),
    )


PRIORITY_MAP = Process(
    "priority-map",
    "Draw the priorities",
    "A map of a country: active fires by rating, pre-fire places by reward, and what no satellite reaches.",
    PriorityMapInputs,
    PriorityMapOutputs,
    priority_map,
)
