"""Maps of the pre-fire danger that people can read: WFPI-x in classes, WFSP-x, and what the satellites changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from services.prioritization.prefire import danger_grid, legend
from services.prioritization.prefire.danger_rasters import CHANGE_NO_DATA, RasterStack
from services.prioritization.prefire.danger_run import Rated
from services.prioritization.prefire.fire_potential import MASK_CODES
from shared import figures

Array = npt.NDArray[np.floating[Any]]
LARGEST_SIDE = 1500
_FIELDS = ("wfpi", "wfpi_x", "wfsp", "wfsp_x", "wlfp", "wlfp_x")


@dataclass(frozen=True)
class Picture:
    """One lead day ready to draw: layers (rows from north to south), mask codes, extent and what its axes are."""

    layers: dict[str, Array]
    mask_code: npt.NDArray[np.uint8]
    extent: tuple[float, float, float, float]
    labels: tuple[str, str]
    aspect: float
    title: str


def picture_of(rated: Rated, note: str = "", lead_day: int = 0) -> Picture:
    """The finest picture of a lead day: of the 1 km rasters where there are any, else of the danger grid."""
    fine = of_stack(rated.stack, rated.grid, lead_day, note) if rated.stack is not None else None
    return fine or of_dataset(rated.grid, lead_day, note)


def of_dataset(grid: xr.Dataset, lead_day: int = 0, note: str = "") -> Picture:
    """A lead day of the danger grid."""
    day = grid.isel(lead_day=lead_day)
    longitude, latitude = (day[name].to_numpy().astype(float) for name in ("longitude", "latitude"))
    axes = danger_grid.GeographicGrid(latitude, longitude)
    up, across = axes.steps_deg
    west, north = longitude[0] - across / 2, latitude[-1] + up / 2
    aspect = 1 / max(float(np.cos(np.radians(latitude.mean()))), 0.1)
    return Picture(
        {name: day[name].to_numpy()[::-1].astype(float) for name in _FIELDS},
        day["mask_code"].to_numpy()[::-1],
        (west, west + across * len(longitude), north - up * len(latitude), north),
        ("longitude (deg east)", "latitude (deg north)"),
        aspect,
        _title(day, lead_day, note),
    )


def of_stack(stack: RasterStack, grid: xr.Dataset, lead_day: int = 0, note: str = "") -> Picture | None:
    """A lead day of the 1 km rasters, every nth cell so that the longer side has at most 1500; None without WFPI."""
    if "wfpi_x" not in stack.layers:
        return None
    step = -(-max(stack.grid.shape) // LARGEST_SIDE)
    thin = {name: values[lead_day, ::step, ::step] for name, values in stack.layers.items()}
    code = thin["wfpi_x"]
    mask = np.where(code >= 248, code, 0).astype(np.uint8)
    layers = {
        name: np.where(mask > 0, np.nan, values / (1.0 if name.startswith("wfpi") else 10.0))
        for name, values in thin.items()
        if name in _FIELDS
    }
    if "wfpi_change" in thin:
        layers["change"] = np.where(thin["wfpi_change"] == CHANGE_NO_DATA, np.nan, thin["wfpi_change"])
    x, y = stack.grid.x_m / 1000, stack.grid.y_m / 1000
    return Picture(
        layers,
        mask,
        (float(x[0]) - 0.5, float(x[-1]) + 0.5, float(y[-1]) - 0.5, float(y[0]) + 0.5),
        ("easting (km)", "northing (km), USGS grid"),
        1.0,
        _title(grid.isel(lead_day=lead_day), lead_day, note),
    )


def _title(day: xr.Dataset, lead_day: int, note: str) -> str:
    start = str(np.datetime_as_string(day["lead_day_start"].to_numpy(), unit="m")).replace("T", " ")
    return f"Pre-fire danger, lead day {lead_day}: 24 h from {start} UTC\n{note}"


def draw(picture: Picture, path: Path, attributes: dict[str, Any]) -> None:
    """WFPI-x in classes, WFPI-x minus WFPI where anything changed, and WFSP-x where there is one, as PNG.

    The footer says whether simulated and by which code.
    """
    wfsp = picture.layers.get("wfsp_x")
    change = _change_of(picture, "wfpi")
    changed = change is not None and bool(np.nanmax(np.abs(change), initial=0.0) > 0)
    title = "WFPI-x: with soil moisture and burned area" if changed else "WFPI (nothing seen that changes it)"
    panels: list[Callable[[Any], None]] = [lambda axis: _classes(axis, picture, title)]
    if changed:
        label = "change by soil moisture and scars"
        panels.append(lambda axis: _change(axis, picture, "wfpi", "WFPI-x minus WFPI", label))
    if wfsp is not None:
        top = max(1.0, float(np.nanquantile(wfsp, 0.99))) if np.isfinite(wfsp).any() else 1.0
        words = ("WFSP-x: a lit fire exceeds 500 acres", "probability (%), demonstration")
        panels.append(lambda axis: _field(axis, picture, wfsp, ("magma_r", 0, top), *words))
    figure = _figure(picture, len(panels))
    for axis, panel in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        panel(axis)
    _finish(figure, picture, path, attributes)


def _figure(picture: Picture, panels: int) -> Any:
    from matplotlib.figure import Figure

    wide = picture.mask_code.shape[1] > 1.25 * picture.mask_code.shape[0]
    return Figure(figsize=((5.7 if panels > 2 else 7.6) * panels, (5.4 if wide else 6.4) + 0.8 * (panels < 3)))


def draw_changes(picture: Picture, path: Path, attributes: dict[str, Any]) -> None:
    """What soil moisture and burned area changed in WFPI, WLFP and WFSP, as PNG."""
    figure = _figure(picture, 3)
    panels = (
        ("wfpi", "WFPI-x minus WFPI", "WFPI"),
        ("wlfp", "WLFP-x minus WLFP", "large fires per million km² and day"),
        ("wfsp", "WFSP-x minus WFSP", "per cent"),
    )
    for axis, (name, title, label) in zip(figure.subplots(1, 3), panels, strict=True):
        _change(axis, picture, name, title, label)
    _finish(figure, picture, path, attributes)


def _finish(figure: Any, picture: Picture, path: Path, attributes: dict[str, Any]) -> None:
    title, _, note = picture.title.partition("\n")
    figure.suptitle(title, fontsize=13, y=0.985)
    figure.text(0.5, 0.925, note, fontsize=9, ha="center", va="center")
    figure.subplots_adjust(left=0.05, right=0.985, top=0.86, bottom=0.29, wspace=0.2)
    figures.save(figure, path, attributes)


def _frame(axis: Any, picture: Picture, title: str) -> None:
    axis.set_title(title, fontsize=11)
    axis.set_xlabel(picture.labels[0], fontsize=9)
    axis.set_ylabel(picture.labels[1], fontsize=9)
    axis.locator_params(axis="both", nbins=5)
    axis.tick_params(labelsize=8)
    axis.set_aspect(picture.aspect)


def _show(axis: Any, picture: Picture, values: Any, **scale: Any) -> Any:
    return axis.imshow(values, origin="upper", extent=picture.extent, interpolation="nearest", aspect="auto", **scale)


def _masked_background(axis: Any, picture: Picture) -> list[int]:
    """Paint the masked cells in their own colours; returns the codes that occur."""
    from matplotlib.colors import to_rgba

    codes = picture.mask_code
    painted = np.full((*codes.shape, 4), to_rgba(legend.MASK_COLOURS[255]))
    present = [code for code in MASK_CODES if (codes == code).any()]
    for code in present:
        painted[codes == code] = to_rgba(legend.MASK_COLOURS[code])
    _show(axis, picture, painted)
    return present


def _classes(axis: Any, picture: Picture, title: str) -> None:
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    present = _masked_background(axis, picture)
    values = np.ma.masked_invalid(picture.layers["wfpi_x"])
    norm = BoundaryNorm(legend.CLASS_EDGES, len(legend.CLASS_NAMES))
    _show(axis, picture, values, cmap=ListedColormap(list(legend.CLASS_COLOURS)), norm=norm)
    handles = [Patch(color=colour, label=legend.class_label(i)) for i, colour in enumerate(legend.CLASS_COLOURS)]
    if (values.mask & (picture.mask_code < 248)).any():
        present = sorted({*present, 255})
    names = {MASK_CODES[code]: code for code in present}
    handles += [Patch(facecolor=legend.MASK_COLOURS[c], edgecolor="#888888", label=name) for name, c in names.items()]
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.15), ncol=4, fontsize=8, frameon=False)
    _frame(axis, picture, title)


def _change_of(picture: Picture, name: str) -> Array | None:
    """What was changed in an index, None where it is not among the layers."""
    if name == "wfpi" and "change" in picture.layers:
        return picture.layers["change"]
    if name + "_x" not in picture.layers:
        return None
    return picture.layers[name + "_x"] - picture.layers[name]


def _change(axis: Any, picture: Picture, name: str, title: str, label: str) -> None:
    change = _change_of(picture, name)
    if change is None:
        axis.set_axis_off()
        return
    finite = np.abs(change[np.isfinite(change)])
    reach = max(float(np.quantile(finite, 0.998)), 5.0 if name == "wfpi" else 0.5) if len(finite) else 5.0
    _field(axis, picture, change, ("RdBu_r", -reach, reach), title, label)


def _field(axis: Any, picture: Picture, values: Array, scale: tuple[str, float, float], title: str, label: str) -> None:
    _masked_background(axis, picture)
    name, low, high = scale
    image = _show(axis, picture, np.ma.masked_invalid(values), cmap=name, vmin=low, vmax=high)
    bar = axis.inset_axes((0.0, -0.24, 1.0, 0.045))
    axis.figure.colorbar(image, cax=bar, orientation="horizontal", label=label)
    _frame(axis, picture, title)
