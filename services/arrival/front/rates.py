"""How fast each part of a front has moved, from the arrival field: the rate that the next day is measured against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter

DAY_H = 24.0
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FrontRates:
    """Displacement of the front over the last `window_h` hours: on average `mean_km`, and by direction
    mean_km + east_km cos(a) + north_km sin(a) with a the direction from east; `local_km` (rows, columns) is that of
    the front nearest to each cell, smoothed along it."""

    window_h: float
    mean_km: float
    east_km: float
    north_km: float
    local_km: Floats

    @property
    def swing_km(self) -> float:
        """Half the difference between the fastest and the slowest direction, km."""
        return float(np.hypot(self.east_km, self.north_km))

    @property
    def heading_rad(self) -> float:
        """Direction of the fastest growth, radians from east to north."""
        return float(np.arctan2(self.north_km, self.east_km))

    def towards(self, angle_rad: Floats, turn_rad: float = 0.0, floor: float = 0.06, swing: float = 1.0) -> Floats:
        """Displacement, km, by direction, the head turned and its lead scaled; never below a share of the mean."""
        lead = swing * self.swing_km * np.cos(angle_rad - self.heading_rad - turn_rad)
        return np.maximum(self.mean_km + lead, floor * self.mean_km)


def rate_of_spread_km_h(arrival_h: Floats, cell_km: float) -> Floats:
    """Rate of spread 1 / |grad T| (rows, columns), km/h, of an arrival field; NaN where it or a neighbour is unburned.

    A field without slope (cells that one pass saw together) has no rate: infinity is returned as NaN.
    """
    if min(arrival_h.shape) < 2:
        return np.full(arrival_h.shape, np.nan)
    d_row, d_column = np.gradient(arrival_h, cell_km)
    slope = np.hypot(d_row, d_column)
    with np.errstate(divide="ignore"):
        return np.where(slope > 0, 1.0 / slope, np.nan)


def window_hours(arrival_h: Floats, end_h: float) -> float:
    """Hours over which the front's motion is taken: a whole day, so that day and night both count; less for a fire
    younger than two."""
    age = end_h - float(np.nanmin(arrival_h))
    return float(min(DAY_H, max(age / 2, 6.0)))


def _outward(burned: Mask) -> tuple[Floats, Floats]:
    """Unit vectors (east, north) out of a burned area, from its smoothed outline."""
    d_row, d_column = np.gradient(-gaussian_filter(burned.astype(float), 2.0))
    length = np.hypot(d_row, d_column) + 1e-12
    return d_column / length, d_row / length


def front_rates(arrival_h: Floats, end_h: float, cell_km: float, along_cells: float = 1.05) -> FrontRates:
    """Displacement of the front up to `end_h`; the field holds at least one burned cell (NaN: unburned).

    Each cell of the present front is measured from what had burned a window before; a first-order harmonic of the
    direction is fitted to all of them (ridge-damped), since a front's own noise is as large as its asymmetry.
    """
    burned = np.isfinite(arrival_h)
    window = window_hours(arrival_h, end_h)
    before = burned & (arrival_h <= end_h - window)
    if not before.any():
        before = burned & (arrival_h <= np.nanquantile(arrival_h, 0.05))
    distance, nearest = distance_transform_edt(~before, return_indices=True)
    row, column = np.indices(burned.shape)
    moved = distance > 1.01
    east, north = _outward(burned)
    safe = np.maximum(distance, 1.0)
    east = np.where(moved, (column - nearest[1]) / safe, east)
    north = np.where(moved, (row - nearest[0]) / safe, north)
    front = burned & ~binary_erosion(burned, border_value=1)
    if not front.any():
        front = burned
    run = distance * cell_km
    design = np.column_stack([np.ones(int(front.sum())), east[front], north[front]])
    damping = np.diag([0.0, 2.0, 2.0])
    mean, to_east, to_north = np.linalg.solve(design.T @ design + damping, design.T @ run[front])
    weight = gaussian_filter(front.astype(float), along_cells)
    local = gaussian_filter(np.where(front, run, 0.0), along_cells) / np.maximum(weight, 1e-12)
    _, at = distance_transform_edt(~burned, return_indices=True)
    return FrontRates(window, max(float(mean), 0.05), float(to_east), float(to_north), local[at[0], at[1]])
