"""A fire arrival map held against one mapped perimeter of a real fire."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from flows.steps.score import finite, incident_of
from shared.errors import DomainError
from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class ScorePerimeterInputs(ProcessInputs):
    fire_arrival: list[ArtifactRef] = Field(description="fire arrival maps made from data up to the perimeter")
    perimeters: ArtifactRef = Field(description="perimeters table; time and known_at bracket the outline's true time")
    incident_id: str = Field(description="incident that the perimeter belongs to")
    time: AwareDatetime = Field(description="time of the perimeter in the table")


class ScorePerimeterOutputs(ProcessOutputs):
    scores: ArtifactRef
    sorensen: float | None
    values: dict[str, float | None]


def score_perimeter(inputs: ScorePerimeterInputs, context: JobContext) -> ScorePerimeterOutputs:
    """Sørensen coefficient and arrival bracket; DomainError if there is no such perimeter or no map of the incident."""
    import pandas as pd

    from flows.cases import scoring

    table = context.read_table(inputs.perimeters, "PERIMETERS")
    rows = table[(table["incident_id"] == inputs.incident_id) & (table["time"] == pd.Timestamp(inputs.time))]
    if rows.empty:
        raise DomainError(
            "There is no such perimeter.", field="time", value=inputs.time, accepted="a time in the table"
        )
    maps = {incident_of(context.path(reference)): reference for reference in inputs.fire_arrival}
    if inputs.incident_id not in maps:
        raise DomainError(
            f"There is no map of {inputs.incident_id}.", field="fire_arrival", accepted=", ".join(sorted(maps))
        )
    row = rows.iloc[0]
    product = scoring.read_arrival(context.path(maps[inputs.incident_id]))
    values = finite(
        scoring.perimeter_scores(product, row.geometry, row["time"].to_pydatetime(), row["known_at"].to_pydatetime())
    )
    document = {"incident_id": inputs.incident_id, "time": inputs.time.isoformat(), "scores": values}
    return ScorePerimeterOutputs(
        scores=context.write_json("scores.json", document), sorensen=values["sorensen"], values=values
    )


SCORE_PERIMETER = Process(
    "score-perimeter",
    "Score against a perimeter",
    "Holds a fire arrival map against one mapped perimeter.",
    ScorePerimeterInputs,
    ScorePerimeterOutputs,
    score_perimeter,
)
