"""A map of the pre-fire danger that people can read: WFPI-x in classes, what the satellites changed, and WFSP-x."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from services.prioritization.prefire.fire_potential import MASK_CODES

CLASS_EDGES = (0, 30, 60, 85, 110, 135, 247)
CLASS_NAMES = ("low", "moderate", "elevated", "high", "very high", "extreme")
CLASS_COLOURS = ("#1a7f37", "#9acd32", "#f4e04d", "#f59e0b", "#dc2626", "#7f1d6b")
MASK_COLOURS = {
    248: "#ffffff",
    249: "#ffffff",
    250: "#eaf6ff",
    251: "#d9d2b0",
    252: "#cfcfcf",
    253: "#8fbfa8",
    254: "#6fa8dc",
    255: "#f2f2f2",
}


def draw(grid: xr.Dataset, path: Path, attributes: dict[str, Any], lead_day: int = 0) -> None:
    """Write the three panels of one lead day as PNG; the footer says whether simulated and by which code."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 6.2), dpi=100)
    axes = figure.subplots(1, 3)
    day = grid.isel(lead_day=lead_day)
    _classes(axes[0], day)
    change = (day["wfpi_x"] - day["wfpi"]).to_numpy()
    reach = max(5.0, float(np.nanmax(np.abs(change), initial=0.0))) if np.isfinite(change).any() else 5.0
    _field(axes[1], day, change, ("RdBu_r", -reach, reach), "WFPI-x minus WFPI", "change by soil moisture and scars")
    wfsp = day["wfsp_x"].to_numpy()
    top = max(1.0, float(np.nanquantile(wfsp, 0.99))) if np.isfinite(wfsp).any() else 1.0
    _field(
        axes[2],
        day,
        wfsp,
        ("magma_r", 0, top),
        "WFSP-x: a lit fire exceeds 500 acres",
        "probability (%), demonstration",
    )
    start = np.datetime_as_string(day["lead_day_start"].to_numpy(), unit="m")
    figure.suptitle(f"Pre-fire danger, lead day {lead_day}: 24 h from {start.replace('T', ' ')} UTC", fontsize=13)
    simulated = "simulated input" if attributes.get("simulated") else "no simulated input"
    footer = f"{simulated} · code {attributes.get('code_version', '')} · class limits of WFPI: {CLASS_EDGES[1:-1]}"
    figure.text(0.01, 0.01, footer, fontsize=8, color="#444444")
    figure.subplots_adjust(left=0.05, right=0.98, top=0.88, bottom=0.24, wspace=0.2)
    figure.savefig(path, metadata={"Software": None})


def _extent(day: xr.Dataset) -> tuple[float, float, float, float]:
    longitude, latitude = day["longitude"].to_numpy(), day["latitude"].to_numpy()
    x = (longitude[1] - longitude[0]) / 2 if len(longitude) > 1 else 0.025
    y = (latitude[1] - latitude[0]) / 2 if len(latitude) > 1 else 0.025
    return longitude[0] - x, longitude[-1] + x, latitude[0] - y, latitude[-1] + y


def _frame(axis: Any, day: xr.Dataset, title: str) -> None:
    axis.set_title(title, fontsize=11)
    axis.set_xlabel("longitude (deg east)")
    axis.set_ylabel("latitude (deg north)")
    axis.locator_params(axis="both", nbins=5)
    middle = float(np.mean(day["latitude"].to_numpy()))
    axis.set_aspect(1 / max(np.cos(np.radians(middle)), 0.1))


def _masked_background(axis: Any, day: xr.Dataset) -> list[int]:
    """Paint the masked cells in their own colours; returns the codes that occur."""
    from matplotlib.colors import to_rgba

    codes = day["mask_code"].to_numpy()
    picture = np.full((*codes.shape, 4), to_rgba(MASK_COLOURS[255]))
    present = [code for code in MASK_CODES if (codes == code).any()]
    for code in present:
        picture[codes == code] = to_rgba(MASK_COLOURS[code])
    axis.imshow(picture, origin="lower", extent=_extent(day), interpolation="nearest", aspect="auto")
    return present


def _classes(axis: Any, day: xr.Dataset) -> None:
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    present = _masked_background(axis, day)
    norm = BoundaryNorm(CLASS_EDGES, len(CLASS_NAMES))
    values = np.ma.masked_invalid(day["wfpi_x"].to_numpy())
    colours = ListedColormap(list(CLASS_COLOURS))
    axis.imshow(
        values, origin="lower", extent=_extent(day), cmap=colours, norm=norm, interpolation="nearest", aspect="auto"
    )
    handles = [Patch(color=colour, label=name) for colour, name in zip(CLASS_COLOURS, CLASS_NAMES, strict=True)]
    handles += [Patch(facecolor=MASK_COLOURS[c], edgecolor="#888888", label=MASK_CODES[c]) for c in present]
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncol=4, fontsize=8, frameon=False)
    _frame(axis, day, "WFPI with soil moisture and burned area")


def _field(
    axis: Any, day: xr.Dataset, values: np.ndarray, scale: tuple[str, float, float], title: str, label: str
) -> None:
    _masked_background(axis, day)
    name, low, high = scale
    shown = np.ma.masked_invalid(values)
    extent = _extent(day)
    image = axis.imshow(
        shown, origin="lower", extent=extent, cmap=name, vmin=low, vmax=high, interpolation="nearest", aspect="auto"
    )
    bar = axis.inset_axes((0.0, -0.24, 1.0, 0.05))
    axis.figure.colorbar(image, cax=bar, orientation="horizontal", label=label)
    _frame(axis, day, title)
