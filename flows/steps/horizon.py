"""The state the planner starts from: the spacecraft document, moved to this cycle's horizon."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class SetHorizonInputs(ProcessInputs):
    spacecraft: ArtifactRef = Field(description="spacecraft document: of the case, or as executed")
    horizon_start: AwareDatetime
    horizon_s: int = Field(gt=0, description="length of the horizon, s")


class SetHorizonOutputs(ProcessOutputs):
    spacecraft: ArtifactRef


def set_horizon(inputs: SetHorizonInputs, context: JobContext) -> SetHorizonOutputs:
    """The same satellites over the new horizon."""
    from shared.contracts.spacecraft import Spacecraft

    spacecraft = Spacecraft.model_validate(context.read_json(inputs.spacecraft))
    moved = spacecraft.at_horizon({"horizon_start": inputs.horizon_start, "horizon_s": inputs.horizon_s})
    return SetHorizonOutputs(spacecraft=context.write_json("spacecraft.json", moved.model_dump(mode="json")))


SET_HORIZON = Process(
    "set-horizon",
    "Set the horizon",
    "Moves the spacecraft document to the cycle's horizon.",
    SetHorizonInputs,
    SetHorizonOutputs,
    set_horizon,
)
