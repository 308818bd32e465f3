"""A picture of when each satellite can speak to the ground and when it is in shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

from services.access.events.contacts import Contact
from services.access.events.eclipses import Eclipse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHADOW_COLORS = {"umbra": "0.55", "penumbra": "0.8"}
SHADOW_HEIGHT, CONTACT_HEIGHT = 0.84, 0.5


@dataclass(frozen=True)
class SatelliteEvents:
    """One satellite's contacts and eclipses; seconds after the start of the horizon."""

    satellite: str
    contacts: Sequence[Contact]
    eclipses: Sequence[Eclipse]


def draw_timeline(
    rows: Sequence[SatelliteEvents], stations: Sequence[str], start: datetime, duration_s: float
) -> Figure:
    """A lane for each satellite: shadow behind, contacts in the colour of their station in front; times in UTC.

    ``stations`` in the order of their colours. The figure belongs to no display.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 1.9 + 0.32 * len(rows)), layout="constrained")
    axes: Any = figure.add_subplot()
    for lane, row in enumerate(rows):
        for kind, color in SHADOW_COLORS.items():
            spans = [(e.start_s, e.end_s) for e in row.eclipses if e.kind == kind]
            _bars(axes, spans, lane, SHADOW_HEIGHT, start, color)
        for number, station in enumerate(stations):
            spans = [(c.start_s, c.end_s) for c in row.contacts if c.station == station]
            _bars(axes, spans, lane, CONTACT_HEIGHT, start, f"C{number % 10}", edge="0.15")
    _label(axes, rows, start, duration_s)
    _legend(figure, stations)
    return figure


def _bars(
    axes: Axes,
    spans: Sequence[tuple[float, float]],
    lane: int,
    height: float,
    start: datetime,
    color: str,
    edge: str = "none",
) -> None:
    bars: Any = [(start + timedelta(seconds=a), timedelta(seconds=b - a)) for a, b in spans]
    if bars:
        axes.broken_barh(bars, (lane - height / 2, height), facecolors=color, edgecolors=edge, linewidth=0.4)


def _label(axes: Any, rows: Sequence[SatelliteEvents], start: datetime, duration_s: float) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    end = start + timedelta(seconds=duration_s)
    axes.set_xlim(start, end)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_yticks(range(len(rows)), [row.satellite for row in rows], fontsize=8)
    locator = AutoDateLocator(minticks=6, maxticks=13)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    axes.grid(axis="x", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    count = sum(len(row.contacts) for row in rows)
    axes.set_title(
        f"Contacts and eclipses, {start:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC: {count} contacts",
        fontsize=10,
        loc="left",
    )


def _legend(figure: Figure, stations: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(facecolor=f"C{i % 10}", edgecolor="0.15", label=name) for i, name in enumerate(stations)]
    handles += [Patch(facecolor=color, label=kind) for kind, color in SHADOW_COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 8), fontsize=8, frameon=False)
