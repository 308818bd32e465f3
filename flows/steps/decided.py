"""What people decided about targets, applied to those that the prioritization made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from flows.desk.decisions import REWARDS, added_id
from shared.errors import DomainError
from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    import geopandas


class Addition(BaseModel):
    """A target as a person wants it."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    kind: Literal["active", "prefire"]
    priority: float = Field(description="reward of equation 1: 0.1 to 1 if active, 0 to 0.9 if pre-fire")
    longitude_deg: float = Field(ge=-180, le=180)
    latitude_deg: float = Field(ge=-90, le=90)
    source: str = Field(description="who added it, and why")


class ApplyDecisionsInputs(ProcessInputs):
    targets: ArtifactRef = Field(description="targets table")
    additions: list[Addition] = Field(default_factory=list, description="what people added")
    target_changes: list[dict[str, Any]] = Field(default_factory=list, description="pins, exclusions, new weights")


class ApplyDecisionsOutputs(ProcessOutputs):
    targets: ArtifactRef
    target_changes: list[dict[str, Any]] = Field(description="those whose target exists in this cycle")
    without_target: list[dict[str, Any]] = Field(description="those whose target does not exist any more")
    added: int


def apply_decisions(inputs: ApplyDecisionsInputs, context: JobContext) -> ApplyDecisionsOutputs:
    """The targets table with the added ones, and the changes that still have their target.

    The same place and kind is one target; the latest word counts.
    """
    import pandas as pd

    targets = context.read_table(inputs.targets, "TARGETS")
    if inputs.additions:
        rows = added_rows(inputs.additions)
        both = pd.concat([targets[~targets["target_id"].isin(rows["target_id"])], rows], ignore_index=True)
        targets = both.sort_values("target_id", ignore_index=True)
    known = set(targets["target_id"])
    kept = [change for change in inputs.target_changes if change["target_id"] in known]
    return ApplyDecisionsOutputs(
        targets=context.write_table("targets.parquet", targets, "TARGETS"),
        target_changes=kept,
        without_target=[change for change in inputs.target_changes if change not in kept],
        added=len(inputs.additions),
    )


def added_rows(additions: list[Addition]) -> geopandas.GeoDataFrame:
    """A row of the targets contract for each addition; DomainError for a reward off the scale of its kind."""
    import geopandas

    rows: dict[int, dict[str, Any]] = {}
    for place, item in enumerate(additions):
        low, high = REWARDS[item.kind]
        if not low <= item.priority <= high:
            raise DomainError(
                f"The target added at {item.longitude_deg}, {item.latitude_deg} has no reward of its scale.",
                field=f"additions.{place}.priority",
                value=item.priority,
                accepted=f"{low} to {high}",
            )
        told = {"priority": item.priority, "priority_low": item.priority, "priority_high": item.priority}
        place_of = {"longitude_deg": item.longitude_deg, "latitude_deg": item.latitude_deg}
        rows[added_id(item)] = {"kind": item.kind, **told, "source": item.source, **place_of}
    table = [{"target_id": key, **row} for key, row in rows.items()]
    points = geopandas.points_from_xy(*zip(*((r["longitude_deg"], r["latitude_deg"]) for r in table), strict=True))
    return geopandas.GeoDataFrame(table, geometry=points, crs="EPSG:4326")


APPLY_DECISIONS = Process(
    "apply-decisions",
    "Apply people's decisions",
    "Adds targets by hand, and keeps the pins, exclusions and weights whose target exists.",
    ApplyDecisionsInputs,
    ApplyDecisionsOutputs,
    apply_decisions,
)
