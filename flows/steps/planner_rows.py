"""Planner rows of a published table beside those of our own plans of the same day."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

COLUMNS = (
    "test", "whose", "gap", "solve_time", "reward_planned", "reward_available", "reward_share",
    "active_planned", "active_available", "prefire_planned", "prefire_available",
)  # fmt: skip


class ActiveOnlyInputs(ProcessInputs):
    targets: ArtifactRef = Field(description="targets table")
    opportunities: ArtifactRef = Field(description="opportunities table")


class ActiveOnlyOutputs(ProcessOutputs):
    targets: ArtifactRef
    opportunities: ArtifactRef


def active_only(inputs: ActiveOnlyInputs, context: JobContext) -> ActiveOnlyOutputs:
    """The active targets alone, and the opportunities over them."""
    targets = context.read_table(inputs.targets, "TARGETS")
    chosen = targets[targets["kind"] == "active"].reset_index(drop=True)
    seen = context.read_table(inputs.opportunities, "OPPORTUNITIES")
    kept = seen[seen["target_id"].isin(chosen["target_id"])].reset_index(drop=True)
    return ActiveOnlyOutputs(
        targets=context.write_table("targets.parquet", chosen, "TARGETS"),
        opportunities=context.write_table("opportunities.parquet", kept, "OPPORTUNITIES"),
    )


class PlannerRowsInputs(ProcessInputs):
    published: ArtifactRef = Field(description="JSON: the published rows of the day, in the order of the reports")
    reports: list[ArtifactRef] = Field(min_length=1, description="reports of plan-observations, one a published row")


class PlannerRowsOutputs(ProcessOutputs):
    table: ArtifactRef
    rows: list[dict[str, Any]]


def planner_rows(inputs: PlannerRowsInputs, context: JobContext) -> PlannerRowsOutputs:
    """Each published row and ours under it. Ours has no solve time: a product knows no clock, the run prints it."""
    import pandas as pd

    published = context.read_json(inputs.published)
    rows = []
    for told, reference in zip(published, inputs.reports, strict=True):
        rows += [published_row(told), own_row(told["test"], context.read_json(reference))]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    whole = [name for name in COLUMNS if name.startswith(("active", "prefire"))]
    table = table.astype(dict.fromkeys(whole, "Int64"))
    table.to_csv(context.new_file("planner_rows.csv"), index=False, lineterminator="\n")
    return PlannerRowsOutputs(table=context.ref("planner_rows.csv"), rows=rows)


def published_row(told: dict[str, Any]) -> dict[str, Any]:
    """A published row under our column names."""
    share = round(told["reward_planned"] / told["reward_available"], 4)
    return {**{name: told[name] for name in COLUMNS if name in told}, "whose": "paper", "reward_share": share}


def own_row(test: str, report: dict[str, Any]) -> dict[str, Any]:
    """Our row from a planner's report; available is what at least one image of the day covers."""
    kinds = report["targets"]
    available = sum(kind["reward_available"] for kind in kinds.values())
    prefire = kinds["prefire"] if kinds["prefire"]["available"] else {"planned": None, "available": None}
    return {
        "test": test,
        "whose": "ours",
        "gap": round(report["gap"], 6),
        "solve_time": "",
        "reward_planned": round(report["reward"], 2),
        "reward_available": round(available, 2),
        "reward_share": round(report["reward"] / available, 4) if available else 0.0,
        **{f"active_{part}": kinds["active"][part] for part in ("planned", "available")},
        **{f"prefire_{part}": prefire[part] for part in ("planned", "available")},
    }


ACTIVE_ONLY = Process(
    "active-only",
    "Active targets alone",
    "Leaves out the pre-fire targets and the opportunities over them.",
    ActiveOnlyInputs,
    ActiveOnlyOutputs,
    active_only,
)
PLANNER_ROWS = Process(
    "planner-rows",
    "Planner rows beside published ones",
    "A CSV table: each published planner row and ours of the same day.",
    PlannerRowsInputs,
    PlannerRowsOutputs,
    planner_rows,
)
