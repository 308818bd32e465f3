"""Which places the looks speak about: seen, seen burning, enclosed by fire, or far from any evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from services.arrival.grid import FireGrid
from services.arrival.looks import BURNED_AREA, FIRE, Looks

NOT_SEEN, NO_FIRE_SEEN, FIRE_SEEN = 0, 1, 2
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Evidence:
    """Per cell (rows, columns): `information` flag, hours of the latest look (NaN: none), distance (km) to the
    nearest fire evidence, whether the cell lies on or is enclosed by it, and the signed distance (km, inside
    positive) to that region's edge."""

    information: NDArray[np.uint8]
    latest_h: Floats
    distance_km: Floats
    enclosed: Mask
    margin_km: Floats


def paint(grid: FireGrid, looks: Looks, how: str) -> Floats:
    """Earliest (`how="first"`) or latest look time, hours, over the footprint disc of every look; NaN where none
    reaches."""
    rows, columns = grid.shape
    cell_km = grid.cell_m / 1e3
    out = np.full(rows * columns, np.inf if how == "first" else -np.inf)
    column = (looks.x_km - (grid.x_m[0] / 1e3 - grid.origin_km[0])) / cell_km
    row = (looks.y_km - (grid.y_m[0] / 1e3 - grid.origin_km[1])) / cell_km
    reach = np.maximum(looks.radius_km / cell_km, 0.5)
    operator = np.minimum if how == "first" else np.maximum
    for size in np.unique(np.ceil(reach).astype(int)):
        chosen = np.ceil(reach).astype(int) == size
        base_row, base_column = np.rint(row[chosen]).astype(int), np.rint(column[chosen]).astype(int)
        for d_row in range(-size, size + 1):
            for d_column in range(-size, size + 1):
                r, c = base_row + d_row, base_column + d_column
                near = np.hypot(r - row[chosen], c - column[chosen]) <= reach[chosen]
                if d_row == 0 and d_column == 0:
                    near[:] = True  # the cell that holds the centre always counts
                near &= (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
                operator.at(out, r[near] * columns + c[near], looks.time_h[chosen][near])
    out[~np.isfinite(out)] = np.nan
    return out.reshape(rows, columns)


def closing(mask: Mask, radius_cells: float) -> Mask:
    """Morphological closing by a disc, by distances: fills gaps narrower than twice the radius. Shapes as `mask`."""
    if not mask.any():
        return mask.copy()
    pad = int(np.ceil(radius_cells)) + 1
    padded = np.pad(mask, pad)
    grown = distance_transform_edt(~padded) <= radius_cells
    closed = distance_transform_edt(grown) > radius_cells
    return (closed | padded)[pad:-pad, pad:-pad]


def supported(looks: Looks, reach_km: float = 8.0, certain: float = 0.7) -> Looks:
    """Looks that outline the burned area: detections, and burned-area points of probability >= `certain` that lie
    within `reach_km` of a detection, so that one wrong point far off draws no second fire. Without detections: all
    such points."""
    fire = looks.fire
    points = looks.take((looks.kind == BURNED_AREA) & (looks.probability >= certain))
    if len(fire) == 0 or len(points) == 0:
        return points if len(fire) == 0 else fire
    distance, _ = cKDTree(np.column_stack([fire.x_km, fire.y_km])).query(np.column_stack([points.x_km, points.y_km]))
    chosen = (looks.kind == FIRE).copy()
    chosen[np.flatnonzero((looks.kind == BURNED_AREA) & (looks.probability >= certain))[distance <= reach_km]] = True
    return looks.take(chosen)


def _distance_and_cover(grid: FireGrid, looks: Looks) -> tuple[Floats, Mask]:
    """Distance (km) from each cell centre to the nearest look, and whether it lies within a look's reach."""
    x, y = grid.cell_centres_km()
    cells = np.column_stack([x.ravel(), y.ravel()])
    nearest, cover = np.full(len(cells), np.inf), np.zeros(len(cells), bool)
    # Half a kilometre covers sensor pixels of 375 m to 1 km with their jitter; of a coarse cell it is the inner half.
    reach = np.where(looks.radius_km <= 0.6, 0.45, np.minimum(0.7 * looks.radius_km, looks.radius_km - 0.1))
    reach = np.maximum(reach, 0.5 * grid.cell_m / 1e3)
    for value in np.unique(np.round(reach, 2)):
        part = looks.take(np.round(reach, 2) == value)
        distance, _ = cKDTree(np.column_stack([part.x_km, part.y_km])).query(cells)
        nearest = np.minimum(nearest, distance)
        cover |= distance <= value
    if not cover.any():  # a lone look in the corner of a coarse cell
        cover = np.isfinite(paint(grid, looks, "first")).ravel()
    return nearest.reshape(grid.shape), cover.reshape(grid.shape)


def gather(grid: FireGrid, looks: Looks, enclosure_km: float = 3.0) -> Evidence:
    """What the looks say about each cell; gaps in the evidence narrower than twice `enclosure_km` count as enclosed."""
    cell_km = grid.cell_m / 1e3
    latest = paint(grid, looks, "last")
    seen_fire = np.isfinite(paint(grid, looks.take(is_fire_evidence(looks)), "first"))
    information = np.where(seen_fire, FIRE_SEEN, np.where(np.isfinite(latest), NO_FIRE_SEEN, NOT_SEEN)).astype(np.uint8)
    anchor = supported(looks)
    if len(anchor) == 0:
        nothing = np.zeros(grid.shape, bool)
        return Evidence(information, latest, np.full(grid.shape, np.inf), nothing, np.full(grid.shape, -np.inf))
    distance, cover = _distance_and_cover(grid, anchor)
    enclosed = closing(cover, enclosure_km / cell_km)
    inside = distance_transform_edt(np.pad(enclosed, 1))[1:-1, 1:-1]
    outside = distance_transform_edt(~enclosed) if enclosed.any() else np.full(grid.shape, np.inf)
    margin = np.where(enclosed, inside - 0.5, 0.5 - outside) * cell_km
    return Evidence(information, latest, distance, enclosed, margin)


def is_fire_evidence(looks: Looks) -> Mask:
    """Looks that saw fire or its scar: detections, and burned-area points of probability >= 0.5."""
    return (looks.kind == FIRE) | ((looks.kind == BURNED_AREA) & (looks.probability >= 0.5))
