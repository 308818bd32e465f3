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
# Footprints this small (radius, km) outline a fire; sightings per pixel at which its rim is mostly seen, or mostly not.
FINE_KM = 0.35
SELDOM, OFTEN = 0.6, 0.95
DENSE_REACH_KM, SPARSE_REACH_KM = 0.17, 0.45
DENSE_ENCLOSURE_KM, SPARSE_ENCLOSURE_KM = 1.5, 3.0
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


def sightings_per_pixel(fire: Looks) -> float:
    """How often a burned pixel was seen burning, on average: the area of all fine footprints over that of the region
    which they and the gaps between them make up. 0 where too few fine sightings tell."""
    fine = fire.take(fire.radius_km <= FINE_KM)
    if len(fine) < 8:
        return 0.0
    low = np.array([fine.x_km.min(), fine.y_km.min()])
    size = np.array([np.ptp(fine.x_km), np.ptp(fine.y_km)]) + 4.0
    cell_km = max(0.1, float(size.max()) / 300.0)
    columns, rows = np.ceil(size / cell_km).astype(int)
    x, y = np.meshgrid(*(low[k] - 2.0 + cell_km * (np.arange(n) + 0.5) for k, n in enumerate((columns, rows))))
    tree = cKDTree(np.column_stack([fine.x_km, fine.y_km]))
    covered = tree.query(np.column_stack([x.ravel(), y.ravel()]))[0].reshape(x.shape) <= 0.3
    region_km2 = float(closing(covered, 1.5 / cell_km).sum()) * cell_km**2
    return float((np.pi * fine.radius_km**2).sum()) / max(region_km2, cell_km**2)


def reach_and_enclosure(looks: Looks) -> tuple[float, float]:
    """How far (km) the burned region reaches around a fine sighting, and half the widest gap it closes.

    Where each pixel was sighted about once, sightings outline the fire themselves; where most burned between passes
    or under cloud, its rim was missed as well as its inside, and the outline lies beyond the outermost sightings.
    """
    sparse = float(np.clip((OFTEN - sightings_per_pixel(looks.fire)) / (OFTEN - SELDOM), 0.0, 1.0))
    return (
        DENSE_REACH_KM + sparse * (SPARSE_REACH_KM - DENSE_REACH_KM),
        DENSE_ENCLOSURE_KM + sparse * (SPARSE_ENCLOSURE_KM - DENSE_ENCLOSURE_KM),
    )


def _distance_and_cover(grid: FireGrid, looks: Looks, reach_km: float) -> tuple[Floats, Mask]:
    """Distance (km) from each cell centre to the nearest look, and whether it lies within a look's reach."""
    x, y = grid.cell_centres_km()
    cells = np.column_stack([x.ravel(), y.ravel()])
    nearest, cover = np.full(len(cells), np.inf), np.zeros(len(cells), bool)
    # Of a coarse cell (a kilometre and more) the inner part burned, not its corners.
    reach = np.where(looks.radius_km <= 0.6, reach_km, np.minimum(0.7 * looks.radius_km, looks.radius_km - 0.1))
    reach = np.maximum(reach, 0.5 * grid.cell_m / 1e3)
    for value in np.unique(np.round(reach, 2)):
        part = looks.take(np.round(reach, 2) == value)
        distance, _ = cKDTree(np.column_stack([part.x_km, part.y_km])).query(cells)
        nearest = np.minimum(nearest, distance)
        cover |= distance <= value
    if not cover.any():  # a lone look in the corner of a coarse cell
        cover = np.isfinite(paint(grid, looks, "first")).ravel()
    return nearest.reshape(grid.shape), cover.reshape(grid.shape)


def gather(grid: FireGrid, looks: Looks) -> Evidence:
    """What the looks say about each cell."""
    cell_km = grid.cell_m / 1e3
    latest = paint(grid, looks, "last")
    seen_fire = np.isfinite(paint(grid, looks.take(is_fire_evidence(looks)), "first"))
    information = np.where(seen_fire, FIRE_SEEN, np.where(np.isfinite(latest), NO_FIRE_SEEN, NOT_SEEN)).astype(np.uint8)
    anchor = supported(looks)
    if len(anchor) == 0:
        nothing = np.zeros(grid.shape, bool)
        return Evidence(information, latest, np.full(grid.shape, np.inf), nothing, np.full(grid.shape, -np.inf))
    reach_km, enclosure_km = reach_and_enclosure(looks)
    distance, cover = _distance_and_cover(grid, anchor, reach_km)
    enclosed = closing(cover, enclosure_km / cell_km)
    inside = distance_transform_edt(np.pad(enclosed, 1))[1:-1, 1:-1]
    outside = distance_transform_edt(~enclosed) if enclosed.any() else np.full(grid.shape, np.inf)
    margin = np.where(enclosed, inside - 0.5, 0.5 - outside) * cell_km
    return Evidence(information, latest, distance, enclosed, margin)


def is_fire_evidence(looks: Looks) -> Mask:
    """Looks that saw fire or its scar: detections, and burned-area points of probability >= 0.5."""
    return (looks.kind == FIRE) | ((looks.kind == BURNED_AREA) & (looks.probability >= 0.5))
