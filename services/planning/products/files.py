"""Every file of a published plan, staged one after the other."""

from __future__ import annotations

from typing import Any

import pandas as pd

from services.planning.operations import MadePlan
from services.planning.products import commands, footprints, gantt, outcomes, profiles
from shared.artifacts.reference import ArtifactRef
from shared.contracts.schema import TableSchema, write_table
from shared.figures import footer
from shared.process.context import JobContext


def write_products(
    context: JobContext, made: MadePlan, targets: pd.DataFrame, specular_points: pd.DataFrame | None, compared: bool
) -> dict[str, Any]:
    """Stage all files; returns their references by the name of the output. ``compared``: there was a previous plan."""
    attributes = context.product_attributes()
    problem, timeline = made.problem, made.plan.timeline
    title = f"Plan: {made.report['images_planned']} images, gap {100 * made.plan.gap:.3f} % to the proven bound"
    gantt.write_gantt(context.new_file("gantt.png"), problem, timeline, title, attributes)
    minutes = profiles.profile_table(problem, timeline)
    profiles.draw_profiles(context.new_file("profiles.png"), problem, minutes, attributes)
    seen = footprints.planned_targets(problem, timeline, targets)
    tracks = footprints.planned_tracks(problem, timeline, specular_points)
    footprints.write_geojson(context.new_file("footprints.geojson"), seen, tracks, attributes)
    footprints.write_kml(context.new_file("footprints.kml"), problem, seen, tracks, attributes)
    named = []
    for satellite, text in commands.command_files(problem, timeline, attributes).items():
        name = f"commands_{_file_name(satellite)}.csv"
        context.new_file(name).write_text(text, encoding="utf-8")
        named.append(context.ref(name))
    return {
        "schedule": context.write_table("schedule.parquet", made.schedule, "SCHEDULE"),
        "report": context.write_json("report.json", made.report), "gantt": context.ref("gantt.png"),
        "footprints": context.ref("footprints.geojson"), "footprints_kml": context.ref("footprints.kml"),
        "commands": named, "profiles": _table(context, "profiles.parquet", minutes, profiles.PROFILES),
        "profiles_chart": context.ref("profiles.png"),
        "images": _table(context, "images.parquet", outcomes.image_table(problem, timeline), outcomes.IMAGES),
        "target_outcomes": _table(
            context, "target_outcomes.parquet", outcomes.target_table(problem, timeline), outcomes.TARGETS
        ),
        "changes": _changes(context, made.changes) if compared else None,
    }  # fmt: skip


def _file_name(satellite: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in satellite)


def _table(context: JobContext, name: str, frame: pd.DataFrame, schema: TableSchema) -> ArtifactRef:
    write_table(context.new_file(name), frame, schema, context.product_attributes())
    return context.ref(name)


def _changes(context: JobContext, changes: pd.DataFrame) -> ArtifactRef:
    text = changes.to_csv(index=False, date_format="%Y-%m-%dT%H:%M:%SZ", lineterminator="\n")
    head = f"# changes against the previous plan\n# {footer(context.product_attributes())}\n"
    context.new_file("changes.csv").write_text(head + text, encoding="utf-8")
    return context.ref("changes.csv")
