"""The one place where the cut-off is applied: what a cycle may know, out of all that a case holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from pydantic import AwareDatetime, Field

from flows.cases import known_at
from shared.errors import MissingArtifactError
from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

WEATHER_HISTORY = timedelta(days=10)


@dataclass(frozen=True)
class GivenFiles:
    """Case inputs by logical name, wherever the store keeps them."""

    files: Mapping[str, Path]

    def path(self, logical: str) -> Path:
        if logical not in self.files:
            raise MissingArtifactError(f"The case has no '{logical}'.", field=logical, accepted=", ".join(self.files))
        return self.files[logical]

    def has(self, logical: str) -> bool:
        return logical in self.files


class AssembleInputs(ProcessInputs):
    cutoff: AwareDatetime = Field(description="only what was known by then enters")
    incidents: ArtifactRef = Field(description="incidents table of the case")
    incident_reports: ArtifactRef | None = Field(None, description="later reports of the incidents' areas")
    detections: ArtifactRef = Field(description="detections table of the case")
    weather_analysis: ArtifactRef = Field(description="hourly analyses")
    weather_forecast: ArtifactRef = Field(description="forecasts by issue")
    perimeters: ArtifactRef | None = Field(None, description="mapped perimeters of the case, where it has any")


class AssembleOutputs(ProcessOutputs):
    incidents: ArtifactRef
    detections: ArtifactRef
    weather: ArtifactRef
    perimeters: ArtifactRef | None = Field(None, description="null where none had been published")
    incident_count: int
    detection_count: int


def assemble_inputs(inputs: AssembleInputs, context: JobContext) -> AssembleOutputs:
    """Incidents, detections, one weather grid and perimeters as they were known at the cut-off."""
    from shared.contracts.grids import WEATHER_GRID, write_netcdf

    names = ("incidents", "incident_reports", "detections", "weather_analysis", "weather_forecast")
    given = {name: getattr(inputs, name) for name in names}
    files = GivenFiles({name: context.path(reference) for name, reference in given.items() if reference is not None})
    incidents = known_at.incidents_known_at(files, inputs.cutoff)
    detections = known_at.detections_known_at(files, inputs.cutoff)
    weather = known_at.weather_known_at(files, inputs.cutoff, inputs.cutoff - WEATHER_HISTORY)
    perimeters = _perimeters(inputs, context)
    # Real detections stay real beside simulated weather: each file is marked by what it was made from.
    reports = [inputs.incidents, *([inputs.incident_reports] if inputs.incident_reports else [])]
    sky = [inputs.weather_analysis, inputs.weather_forecast]
    path = context.new_file("weather.nc", sky)
    write_netcdf(path, WEATHER_GRID.check(weather), context.product_attributes(sky))
    return AssembleOutputs(
        incidents=context.write_table("incidents.parquet", incidents, "INCIDENTS", reports),
        detections=context.write_table("detections.parquet", detections, "DETECTIONS", [inputs.detections]),
        weather=context.ref("weather.nc"),
        perimeters=perimeters,
        incident_count=len(incidents),
        detection_count=len(detections),
    )


def _perimeters(inputs: AssembleInputs, context: JobContext) -> ArtifactRef | None:
    if inputs.perimeters is None:
        return None
    found = known_at.perimeters_known_at(GivenFiles({"perimeters": context.path(inputs.perimeters)}), inputs.cutoff)
    return context.write_table("perimeters.parquet", found, "PERIMETERS", [inputs.perimeters]) if len(found) else None


ASSEMBLE_INPUTS = Process(
    "assemble-inputs",
    "Assemble what is known at the cut-off",
    "Applies the cut-off to incidents, detections, weather and perimeters.",
    AssembleInputs,
    AssembleOutputs,
    assemble_inputs,
)
