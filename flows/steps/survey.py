"""A target in the middle of the region, for the days before the first cycle: nothing is planned then, only watched."""

from __future__ import annotations

from pydantic import Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class SurveyTargetInputs(ProcessInputs):
    region: tuple[float, float, float, float] = Field(description="west, south, east, north in degrees")


class SurveyTargetOutputs(ProcessOutputs):
    targets: ArtifactRef


def survey_target(inputs: SurveyTargetInputs, context: JobContext) -> SurveyTargetOutputs:
    """One target of no worth: predict-access asks for targets, and the survey is after the specular tracks."""
    import geopandas

    west, south, east, north = inputs.region
    middle = geopandas.points_from_xy([(west + east) / 2], [(south + north) / 2])
    columns = {"target_id": [0], "kind": "prefire", "priority": 0.0, "source": "survey"}
    frame = geopandas.GeoDataFrame(columns, geometry=middle, crs="EPSG:4326")
    return SurveyTargetOutputs(targets=context.write_table("targets.parquet", frame, "TARGETS"))


SURVEY_TARGET = Process(
    "survey-target",
    "Survey target",
    "The middle of the region, for tracks of the days before.",
    SurveyTargetInputs,
    SurveyTargetOutputs,
    survey_target,
)
