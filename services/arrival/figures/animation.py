"""A film of the fire: how the burned area grew, with the detections of each step over it (GIF)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from PIL import Image

from services.arrival.exports.isochrones import levels
from services.arrival.figures.axes import clock, degrees_of, new_map, place_of, solar_clock
from services.arrival.inference import ArrivalMap
from services.arrival.looks import Looks
from shared.figures import footer

MOST_FRAMES = 24
FRAME_MS, LAST_FRAME_MS = 350, 1500


def draw_animation(
    path: Path, arrival: ArrivalMap, looks: Looks, reference: pd.Timestamp, name: str, attributes: Mapping[str, Any]
) -> bool:
    """Write the GIF, a frame per isochrone: arrival up to then, detections before it in grey and those of the last
    step in black. False, and no file, where nothing burned."""
    hours = arrival.arrival_h
    wanted = levels(hours, reference, most=MOST_FRAMES)
    if wanted.size == 0:
        return False
    place = place_of(arrival)
    figure, axes = new_map(place, np.isfinite(hours))
    figure.set_dpi(65)
    axes.grid(color="0.85", linewidth=0.5)
    figure.text(0.008, 0.008, footer(attributes), fontsize=7, color="0.35")
    if attributes.get("simulated"):
        figure.text(0.992, 0.992, "SIMULATED", fontsize=9, color="#b30000", weight="bold", ha="right", va="top")
    west, east, south, north = (*axes.get_xlim(), *axes.get_ylim())
    low, high = float(np.nanmin(hours)), float(np.nanmax(hours))
    mesh = axes.pcolormesh(
        place.longitude, place.latitude, np.ma.masked_invalid(hours), cmap="YlOrRd_r", vmin=low, vmax=max(high, low + 1)
    )
    axes.set(xlim=(west, east), ylim=(south, north))
    fire = looks.fire
    lon, lat = degrees_of(fire, arrival, place) if len(fire) else (np.zeros(0), np.zeros(0))
    older = axes.plot([], [], ".", ms=2, color="0.45", alpha=0.5)[0]
    newer = axes.plot([], [], ".", ms=3, color="black")[0]
    title = axes.set_title("", fontsize=12)
    artists = [mesh, older, newer, title]
    for artist in artists:
        artist.set_animated(True)
    figure.canvas.draw()
    background = figure.canvas.copy_from_bbox(figure.bbox)
    frames = []
    before = -np.inf
    for level in wanted:
        mesh.set_array(np.ma.masked_where(~(hours <= level), hours))
        older.set_data(lon[fire.time_h <= before], lat[fire.time_h <= before])
        now = (fire.time_h > before) & (fire.time_h <= level)
        newer.set_data(lon[now], lat[now])
        time = reference + pd.Timedelta(hours=float(level))
        area = float((hours <= level).sum()) * (arrival.grid.cell_m / 1e3) ** 2
        solar = solar_clock(time, place.middle_longitude)
        title.set_text(f"{name}, {clock(reference, float(level))} UTC ({solar} solar): {area:.0f} km²")
        figure.canvas.restore_region(background)
        for artist in artists:
            axes.draw_artist(artist)
        frames.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()))
        before = float(level)
    plt.close(figure)
    first = frames[-1].quantize(128, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    coloured = [frame.quantize(palette=first, dither=Image.Dither.NONE) for frame in frames]
    times = [FRAME_MS] * (len(frames) - 1) + [LAST_FRAME_MS]
    coloured[0].save(path, format="GIF", save_all=True, append_images=coloured[1:], duration=times, loop=0)
    return True
