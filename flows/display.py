"""What a person sees while the loop runs and when it has ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from flows.loop_types import CycleProducts
from flows.runner import StepEvent


class ConsoleDisplay:
    """A line for each finished step; on a terminal also what runs right now, and how far it is."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = console.status("")
        if console.is_terminal:
            self._status.start()

    def __call__(self, event: StepEvent) -> None:
        name = f"{event.cycle}  {event.process}"
        if not event.done:
            self._status.update(f"{name}  {event.percent:.0f} %  {event.message}")
        else:
            self._console.print(f"  {name:<48} {event.seconds:6.1f} s", highlight=False)

    def close(self) -> None:
        """Give the terminal back."""
        self._status.stop()


def cycle_table(cycles: Sequence[CycleProducts], title: str) -> Table:
    """The figures of each cycle, for people."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for cycle in cycles:
        table.add_column(cycle.label, justify="right")
    has_truth = any(cycle.steps["score"]["fires"] for cycle in cycles)
    for name, value in (*_ROWS, *(_TRUTH_ROWS if has_truth else ())):
        table.add_row(name, *(value(cycle.steps) for cycle in cycles))
    return table


Steps = Mapping[str, Mapping[str, Any]]


def _targets(steps: Steps) -> str:
    built = steps["build-targets"]
    return f"{built['active_count']} / {built['prefire_count']}"


def _covered(steps: Steps) -> str:
    seen = steps["situation"]
    prefire = seen["covered_targets"] - seen["covered_active"]
    return f"{seen['covered_active']} / {prefire}"


def _images(steps: Steps) -> str:
    run = steps["execute"]
    return f"{run['collected']} / {run['downlinked']} / {run['lost']} / {run['stored']}"


def _plan(steps: Steps) -> str:
    planned = steps["plan-observations"]
    return f"{planned['objective']:.1f} of {planned['bound']:.1f} ({100 * planned['gap']:.2f} %)"


def _burned(steps: Steps) -> str:
    scores = steps["score"]["burned_area"]
    burned = round((scores["base_rate"] or 0.0) * (scores["points"] or 0.0))
    return f"{burned}; {scores['auc']:.2f}" if scores["auc"] is not None else f"{burned}"


def _looks(steps: Steps) -> str:
    seen = steps["retrieve-burned-area"]
    return f"{seen['look_count']}, {seen['burned_count']}"


def _error(steps: Steps) -> str:
    fires = steps["score"]["fires"]
    return "\n".join(_fire(name, scores) for name, scores in sorted(fires.items()))


def _fire(name: str, scores: Mapping[str, float | None]) -> str:
    if scores["mae_h"] is None:
        return f"{name}: no shared area"
    return f"{name}: {scores['mae_h']:.1f} h (bias {scores['bias_h']:+.1f}), F1 {scores['f1_extent']:.2f}"


_ROWS = (
    ("targets, active / pre-fire", _targets),
    ("… recorded, active / pre-fire", _covered),
    ("plan: reward of bound (gap)", _plan),
    ("images: collected / downlinked / lost / on board", _images),
    ("burned-area looks, said to have burned", _looks),
)
_TRUTH_ROWS = (
    ("… that had burned in truth; AUC", _burned),
    ("fire arrival against truth: mean error", _error),
)


def comparison_table(changes: Mapping[str, Any], label: str) -> Table:
    """What the feedback changed in a cycle."""
    table = Table(title=f"What the feedback changed in {label}", title_justify="left")
    table.add_column("")
    table.add_column("active", justify="right")
    table.add_column("pre-fire", justify="right")
    for name in ("new", "gone", "reweighted"):
        table.add_row(f"targets {name}", str(changes[f"active_{name}"]), str(changes[f"prefire_{name}"]))
    table.add_section()
    for name, text in (
        ("images_both", "images in both plans"),
        ("images_only_with", "images only with feedback"),
        ("images_only_without", "images only without"),
    ):
        table.add_row(text, str(changes[name]), "")
    return table


def perimeter_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Fire arrival maps against mapped perimeters, each from the data up to it only."""
    table = Table(title="Fire arrival against mapped perimeters (data up to each only)", title_justify="left")
    names = ("sorensen", "bracket_fraction", "bracket_error_h", "outline_missed")
    for column in ("perimeter of (UTC)", "Sørensen", "outline in its bracket", "error outside (h)", "outline missed"):
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(row["time"][:16], *(_number(row[name]) for name in names))
    return table


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def planner_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Published planner rows, each with ours of the same day under it."""
    table = Table(
        title="Planner rows as published, and ours (rewards are on scales of their own)", title_justify="left"
    )
    table.add_column("test")
    for column in ("gap", "time", "reward: plan / available", "active", "pre-fire"):
        table.add_column(column, justify="right")
    for row in rows:
        ours = row["whose"] == "ours"
        reward = f"{row['reward_planned']:.1f} / {row['reward_available']:.1f} ({100 * row['reward_share']:.1f} %)"
        counts = (_share(row, "active"), _share(row, "prefire"))
        name = "  ours" if ours else row["test"]
        table.add_row(name, f"{row['gap']:.4f}", row["solve_time"], reward, *counts, end_section=ours)
    return table


def _share(row: Mapping[str, Any], kind: str) -> str:
    planned, available = row[f"{kind}_planned"], row[f"{kind}_available"]
    return "–" if not available else f"{planned} / {available} ({100 * planned / available:.1f} %)"
