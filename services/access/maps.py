"""A picture of where the receivers go and of what they cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.grid import land
from services.access.events.contacts import Station

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

TRACK_MINUTES = 100  # a revolution and a little more
MOST_DOTS = 200_000


@dataclass(frozen=True)
class Covered:
    """What the lower map shows: places (degrees), how often each was visited, and what they are called."""

    latitude_deg: Array
    longitude_deg: Array
    visits: NDArray[np.int32]
    what: str


def draw_map(
    tracks_deg: Sequence[tuple[str, Array]], stations: Sequence[Station], covered: Covered | None, title: str
) -> Figure:
    """Ground tracks of the first revolution, a line a receiver ((n, 2) latitude and longitude a minute apart), and the
    places by number of visits, in grey where there was none. The figure belongs to no display."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 11.5 if covered is not None else 6.0), layout="constrained")
    rows = figure.subplots(2 if covered is not None else 1, 1, squeeze=False)[:, 0]
    _draw_land(rows[0])
    for number, (name, track) in enumerate(tracks_deg):
        latitude, longitude = _unwrapped(track[:TRACK_MINUTES])
        color = f"C{number % 10}"
        rows[0].plot(longitude, latitude, "-", lw=1.0, color=color, label=name if len(tracks_deg) <= 12 else None)
        rows[0].plot(track[0, 1], track[0, 0], "o", ms=4, color=color)
    for station in stations:
        rows[0].plot(station.longitude_deg, station.latitude_deg, "k^", ms=6)
        rows[0].annotate(
            station.name, (station.longitude_deg, station.latitude_deg), (4, 4), textcoords="offset points", fontsize=8
        )
    _frame(rows[0], (-180.0, 180.0), (-90.0, 90.0))
    rows[0].set_title(f"{title}: ground tracks of the first {TRACK_MINUTES} minutes (dot: start), stations")
    if 0 < len(tracks_deg) <= 12:
        rows[0].legend(loc="lower left", fontsize=7, ncols=2)
    if covered is not None:
        _draw_coverage(figure, rows[1], covered)
    return figure


def _draw_coverage(figure: Figure, axes: Any, covered: Covered) -> None:
    _draw_land(axes)
    _draw_land(axes, 360.0)
    keep = slice(None, None, -(-len(covered.visits) // MOST_DOTS))
    latitude, visits = covered.latitude_deg[keep], covered.visits[keep]
    longitude = _together(covered.longitude_deg)[keep]
    extent = _extent(longitude), _extent(latitude)
    size = float(np.clip(60_000.0 / max(len(visits), 1), 1.0, 30.0))
    none = visits == 0
    axes.scatter(longitude[none], latitude[none], s=size, c="0.7", marker="s", lw=0, rasterized=True)
    if not none.all():
        dots = axes.scatter(
            longitude[~none], latitude[~none], s=size, c=visits[~none], cmap="viridis", marker="s", lw=0, vmin=1,
            vmax=max(float(np.percentile(visits[~none], 99)), 2.0), rasterized=True,
        )  # fmt: skip
        figure.colorbar(dots, ax=axes, label="visits", shrink=0.8)
    _frame(axes, *extent)
    share = 100.0 * float((covered.visits > 0).mean())
    axes.set_title(f"{covered.what}: {share:.1f} % of {len(covered.visits):,} covered (grey: none)")


def _draw_land(axes: Any, east_deg: float = 0.0) -> None:
    import shapely
    from matplotlib.collections import PolyCollection

    shells = [np.asarray(part.exterior.coords) + np.array([east_deg, 0.0]) for part in shapely.get_parts(land())]
    axes.add_collection(PolyCollection(shells, facecolors="0.93", edgecolors="0.6", linewidths=0.5, zorder=0))


def _unwrapped(track: Array) -> tuple[Array, Array]:
    """Latitude and longitude with a break wherever the line would cross the whole map."""
    jump = np.flatnonzero(np.abs(np.diff(track[:, 1])) > 180.0) + 1
    return np.insert(track[:, 0], jump, np.nan), np.insert(track[:, 1], jump, np.nan)


def _together(longitude_deg: Array) -> Array:
    """Longitudes as 0 to 360 where that leaves them far nearer together, so that a region over the dateline is one."""
    turned = longitude_deg % 360.0
    return turned if np.ptp(turned) < np.ptp(longitude_deg) - 180.0 else longitude_deg


def _extent(degrees: Array) -> tuple[float, float]:
    low, high = float(degrees.min()), float(degrees.max())
    margin = max(0.05 * (high - low), 1.0)
    return low - margin, high + margin


def _frame(axes: Any, x: tuple[float, float], y: tuple[float, float]) -> None:
    axes.set_xlim(max(x[0], -180.0), min(x[1], 360.0 if x[1] - x[0] < 360.0 else 180.0))
    axes.set_ylim(max(y[0], -90.0), min(y[1], 90.0))
    middle = 0.5 * (y[0] + y[1])
    axes.set_aspect(1.0 / max(np.cos(np.radians(middle)), 0.2))
    axes.set_xlabel("longitude, degrees")
    axes.set_ylabel("latitude, degrees")
    axes.grid(lw=0.3, color="0.8")
