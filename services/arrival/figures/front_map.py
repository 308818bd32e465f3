"""The map of the next 24 hours: how likely the fire arrives where it has not been."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from services.arrival.figures.axes import finish, new_map, place_of, solar_clock
from services.arrival.fires import FireCase
from services.arrival.front.forecast import Front
from services.arrival.inference import ArrivalMap

BASIS = {
    "spread": "from the last day's spread alone, no weather",
    "spread+weather": "from the last day's spread, wind and moisture",
    "climatology": "the fire's own spread is unknown: wide, from wildfires in general",
    "none": "no fire mapped",
}


def draw_front(path: Path, case: FireCase, arrival: ArrivalMap, front: Front, attributes: Mapping[str, Any]) -> None:
    """Write the PNG: probability of a new arrival within 24 h after the end, over what has burned."""
    place = place_of(arrival)
    burned = np.isfinite(arrival.arrival_h)
    shown = burned | (front.probability > 0.02)
    figure, axes = new_map(place, shown if shown.any() else np.ones(burned.shape, bool))
    where = (place.longitude, place.latitude)
    chance = np.ma.masked_less(front.probability, 0.02)
    mesh = axes.pcolormesh(*where, chance, cmap="OrRd", vmin=0, vmax=1, shading="nearest")
    bar = figure.colorbar(mesh, ax=axes, shrink=0.85)
    bar.set_label("probability that the fire arrives within 24 h")
    axes.pcolormesh(*where, np.ma.masked_where(~burned, np.full(burned.shape, 0.3)), cmap="gray", vmin=0, vmax=1)
    if min(burned.shape) > 1 and (front.probability >= 0.5).any():
        axes.contour(
            *where, np.where(burned, 1.0, front.probability), levels=[0.5], colors="black", linewidths=1.2, zorder=3
        )
    axes.grid(color="0.85", linewidth=0.5)
    end = case.reference + pd.Timedelta(hours=case.end_h)
    cell_km2 = (arrival.grid.cell_m / 1e3) ** 2
    axes.set_title(
        f"Next 24 h of {case.name}, from {end.strftime('%d %b %H:%M')} UTC"
        f" ({solar_clock(end, place.middle_longitude)} local solar time)\n"
        f"dark: burned, {burned.sum() * cell_km2:.0f} km²; line: as likely as not; "
        f"expected {front.probability.sum() * cell_km2:.0f} km² more; {BASIS[front.basis]}",
        fontsize=10,
    )
    finish(figure, path, attributes)
