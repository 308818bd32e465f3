"""What the feedback changed: the second cycle with it beside the same cycle without."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from flows.root import fetched
from shared.artifacts.reference import ArtifactRef
from shared.artifacts.roots import local_path
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import TableSchema, read_table


def local_file(reference: Mapping[str, Any], store: ArtifactStore | None = None) -> Path:
    """The path of a ``file://`` reference, or of a checked copy where the ``store`` lies elsewhere."""
    return local_path(str(reference["href"])) if store is None else fetched(store, ArtifactRef(**reference))


def read_reference(
    reference: Mapping[str, Any], schema: TableSchema, store: ArtifactStore | None = None
) -> pd.DataFrame:
    """A stored table."""
    return read_table(local_file(reference, store), schema)


def compare_targets(with_feedback: pd.DataFrame, without: pd.DataFrame) -> dict[str, int]:
    """How many targets of each kind are new, gone or re-weighted (contract ``targets``)."""
    changes = {}
    for kind in ("active", "prefire"):
        ours = with_feedback[with_feedback["kind"] == kind].set_index("target_id")["priority"]
        plain = without[without["kind"] == kind].set_index("target_id")["priority"]
        shared = ours.index.intersection(plain.index)
        changes[f"{kind}_new"] = len(ours.index.difference(plain.index))
        changes[f"{kind}_gone"] = len(plain.index.difference(ours.index))
        changes[f"{kind}_reweighted"] = int(((ours[shared] - plain[shared]).abs() > 1e-9).sum())
    return changes


def compare_schedules(with_feedback: pd.DataFrame, without: pd.DataFrame) -> dict[str, int]:
    """How many images only one of two schedules takes (contract ``schedule``), told by satellite and second."""
    ours, plain = _images(with_feedback), _images(without)
    return {
        "images_only_with": len(ours - plain),
        "images_only_without": len(plain - ours),
        "images_both": len(ours & plain),
    }


def _images(schedule: pd.DataFrame) -> set[tuple[str, pd.Timestamp]]:
    collects = schedule[schedule["command"] == "collect"]
    return set(zip(collects["satellite"], collects["start"], strict=True))


def compare_cycles(
    store: ArtifactStore, with_feedback: Mapping[str, Mapping[str, Any]], without: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Targets and plan of two cycles' steps, compared; and each plan's objective on its own targets."""
    both = (with_feedback, without)
    targets = [read_reference(steps["build-targets"]["targets"], tables.TARGETS, store) for steps in both]
    plans = [read_reference(steps["plan-observations"]["schedule"], tables.SCHEDULE, store) for steps in both]
    return {
        **compare_targets(*targets),
        **compare_schedules(*plans),
        "objective_with": with_feedback["plan-observations"]["objective"],
        "objective_without": without["plan-observations"]["objective"],
    }
