"""Products held against what really burned: the nature run's truth, or mapped perimeters. No other step sees these."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    from pathlib import Path


class ScoreInputs(ProcessInputs):
    fire_arrival: list[ArtifactRef] = Field(description="fire arrival maps of a cycle")
    burned_area: ArtifactRef = Field(description="burned-area points of the cycle")
    at: AwareDatetime = Field(description="time at which extents are compared: the end of the cycle")
    truth: ArtifactRef | None = Field(None, description="the nature run's arrival times")


class ScoreOutputs(ProcessOutputs):
    scores: ArtifactRef
    fires: dict[str, dict[str, float | None]]
    burned_area: dict[str, float | None]


def score(inputs: ScoreInputs, context: JobContext) -> ScoreOutputs:
    """Error of arrival times and of extent for each fire, and of the burned-area points."""
    from flows.cases import scoring

    fires: dict[str, Any] = {}
    burned: dict[str, Any] = {}
    if inputs.truth is not None:
        truth_path = context.path(inputs.truth)
        truths = {name: _truth(truth_path, name) for name in scoring.truth_incidents(truth_path)}
        for reference in inputs.fire_arrival:
            product = scoring.read_arrival(context.path(reference))
            name = incident_of(context.path(reference))
            if name in truths:
                fires[name] = scoring.arrival_scores(product, truths[name], inputs.at)
        points = context.read_table(inputs.burned_area, "BURNED_AREA")
        burned = scoring.burned_area_scores(points, list(truths.values()))
    finite_fires = {name: finite(values) for name, values in fires.items()}
    document = {"at": inputs.at.isoformat(), "fires": finite_fires, "burned_area": finite(burned)}
    return ScoreOutputs(
        scores=context.write_json("scores.json", document), fires=finite_fires, burned_area=finite(burned)
    )


def _truth(path: Path, incident_id: str) -> Any:
    from flows.cases import scoring

    return scoring.read_arrival(path, f"fire_arrival_time_{incident_id}")


def incident_of(path: Path) -> str:
    """The incident that a fire arrival map belongs to."""
    import xarray as xr

    with xr.open_dataset(path, decode_times=False) as opened:
        return str(opened.attrs["incident_id"])


def finite(values: dict[str, Any]) -> dict[str, float | None]:
    """The scores rounded to six digits, undefined ones as None."""
    return {name: None if value != value else round(float(value), 6) for name, value in values.items()}


SCORE = Process(
    "score", "Score the products", "Holds products against what really burned.", ScoreInputs, ScoreOutputs, score
)
