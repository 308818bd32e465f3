"""The map of what is known: no pass, hidden by cloud, looked at without fire and how long ago, fire seen."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from services.arrival.figures.axes import finish, new_map, place_of, solar_clock
from services.arrival.fires import FireCase
from services.arrival.inference import ArrivalMap
from services.arrival.sight import BURNING, CLEAR, HIDDEN, NO_PASS, Sight

AGES_H = (0, 3, 6, 12, 24, 48, 96)
FRESH_TO_OLD = ("#1a7f5a", "#56a878", "#93c79b", "#c3dfb6", "#e3eecb", "#f3f5e2")
NO_PASS_COLOUR, HIDDEN_COLOUR, FIRE_COLOUR = "0.86", "#9aa9c4", "#d6542e"


def draw_information(
    path: Path, case: FireCase, arrival: ArrivalMap, sight: Sight, attributes: Mapping[str, Any]
) -> None:
    """Write the PNG. Ages are of the latest clear look at the period's end, which the title gives in UTC and in local
    mean solar time."""
    place = place_of(arrival)
    figure, axes = new_map(place, np.ones(sight.state.shape, bool))
    axes.set_facecolor(NO_PASS_COLOUR)
    where = (place.longitude, place.latitude)
    hidden = np.ma.masked_where(sight.state != HIDDEN, np.ones(sight.state.shape))
    axes.pcolormesh(*where, hidden, cmap=ListedColormap([HIDDEN_COLOUR]), shading="nearest")
    age = np.ma.masked_where(sight.state != CLEAR, np.minimum(sight.age_h(case.end_h), AGES_H[-1] - 1e-6))
    colours = ListedColormap(list(FRESH_TO_OLD))
    mesh = axes.pcolormesh(*where, age, cmap=colours, norm=BoundaryNorm(AGES_H, colours.N), shading="nearest")
    burning = np.ma.masked_where(sight.state != BURNING, np.ones(sight.state.shape))
    axes.pcolormesh(*where, burning, cmap=ListedColormap([FIRE_COLOUR]), shading="nearest", zorder=2)
    bar = figure.colorbar(mesh, ax=axes, shrink=0.85, ticks=AGES_H)
    bar.ax.set_yticklabels([*map(str, AGES_H[:-1]), "older"], fontsize=8)
    bar.set_label("no fire seen; age of the latest clear look (h)")
    burned = np.isfinite(arrival.arrival_h)
    if burned.any() and not burned.all() and min(burned.shape) > 1:
        axes.contour(*where, burned.astype(float), levels=[0.5], colors="black", linewidths=1.0, zorder=3)
    shares = {code: float((sight.state == code).mean()) for code in (BURNING, HIDDEN, NO_PASS)}
    axes.legend(
        handles=[
            Patch(color=FIRE_COLOUR, label=f"fire seen ({100 * shares[BURNING]:.0f} %)"),
            Patch(color=HIDDEN_COLOUR, label=f"passed over, but cloud or water ({100 * shares[HIDDEN]:.0f} %)"),
            Patch(facecolor=NO_PASS_COLOUR, edgecolor="0.6", label=f"no look ({100 * shares[NO_PASS]:.0f} %)"),
            Patch(facecolor="none", edgecolor="black", label="mapped as burned"),
        ],
        loc="lower left",
        fontsize=8,
        framealpha=0.9,
    )
    axes.set_title(_title(case, sight, place.middle_longitude), fontsize=12)
    finish(figure, path, attributes)


def _title(case: FireCase, sight: Sight, longitude_deg: float) -> str:
    end = case.reference + pd.Timedelta(hours=case.end_h)
    head = f"What is known of {case.name} at {end.strftime('%d %b %H:%M')} UTC"
    head += f" ({solar_clock(end, longitude_deg)} local solar time)"
    if not np.isfinite(sight.clear_h).any():
        return f"{head}\nnobody has looked: nothing is known, which is not 'no fire'"
    latest = float(np.nanmax(sight.clear_h))
    time = case.reference + pd.Timedelta(hours=latest)
    return (
        f"{head}\nlatest clear look {case.end_h - latest:.1f} h before, at {time.strftime('%d %b %H:%M')} UTC"
        f" ({solar_clock(time, longitude_deg)} local)"
    )
