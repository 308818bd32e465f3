"""Which cells a look sees, and how much of its footprint each one fills."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from services.arrival.looks import Looks

Floats = NDArray[np.float64]
LARGEST_REACH_KM = 1.2
# A look that stands for others beside it (a thinned granule) counts at most twice.
REPRESENTS, MOST_WEIGHT = 0.3, 2.0


@dataclass(frozen=True)
class Footprints:
    """Pairs (look, cell) with the share of the look's footprint that the cell fills; per look its time (h),
    probability and weight."""

    look: Tensor
    cell: Tensor
    share: Tensor
    time: Tensor
    probability: Tensor
    weight: Tensor

    def seen(self, state: Tensor) -> Tensor:
        """Footprint means (members, looks) of a state per pair (members, pairs)."""
        out = torch.zeros(state.shape[0], self.time.numel())
        return out.index_add(1, self.look, self.share * state)


def footprints(looks: Looks, cells_km: Floats, cell_km: float, weight: Floats | None = None) -> Footprints | None:
    """Pairs of looks with cell centres (n, 2) km under a Gaussian footprint with its geolocation error; None without
    looks."""
    if len(looks) == 0:
        return None
    # A Gaussian of 0.45 radii has the footprint's mean square extent; 0.3 radii are added for geolocation.
    sigma = np.round(np.maximum(0.54 * looks.radius_km, 0.4 * cell_km), 2)
    tree = cKDTree(cells_km)
    look, cell, share = [], [], []
    for value in np.unique(sigma):
        chosen = np.flatnonzero(sigma == value)
        reach = max(2.0 * value, 0.75 * cell_km)
        near = tree.query_ball_point(
            np.column_stack([looks.x_km[chosen], looks.y_km[chosen]]), reach, return_sorted=True
        )
        counts = np.array([len(entry) for entry in near])
        index = np.repeat(chosen, counts)
        place = np.fromiter((k for entry in near for k in entry), np.int64, counts.sum())
        offset = cells_km[place] - np.column_stack([looks.x_km[index], looks.y_km[index]])
        whole = 2 * np.pi * value**2 * (1 - np.exp(-0.5 * (reach / value) ** 2))
        look.append(index)
        cell.append(place)
        share.append(np.exp(-0.5 * (offset**2).sum(axis=1) / value**2) * cell_km**2 / whole)
    rows, columns, shares = np.concatenate(look), np.concatenate(cell), np.concatenate(share)
    total = np.bincount(rows, shares, len(looks))
    shares = shares / np.maximum(total[rows], 0.7)  # partly off the grid: what is missing saw nothing here
    order = np.argsort(rows, kind="stable")

    def tensor(values: Floats) -> Tensor:
        return torch.tensor(values, dtype=torch.float32)

    return Footprints(
        torch.tensor(rows[order]),
        torch.tensor(columns[order]),
        tensor(shares[order]),
        tensor(looks.time_h),
        tensor(looks.probability),
        tensor(np.ones(len(looks)) if weight is None else weight),
    )


def representative(no_fire: Looks) -> tuple[Looks, Floats, bool]:
    """No-fire looks with the reach that each stands for, their weights, and whether the granules are complete.

    Tables are often thinned: of a granule's pixels without fire only some are kept. The distance to the nearest
    neighbour in the same granule shows it; each look then speaks for the land around it, up to 1.2 km.
    """
    reach = no_fire.radius_km.copy()
    granule = np.round(no_fire.time_h * 20).astype(np.int64) * 8 + no_fire.source
    for value in np.unique(granule):
        rows = np.flatnonzero(granule == value)
        if rows.size < 3:
            continue
        places = np.column_stack([no_fire.x_km[rows], no_fire.y_km[rows]])
        spacing = float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))
        reach[rows] = np.clip(spacing, reach[rows], np.maximum(LARGEST_REACH_KM, reach[rows]))
    ratio = reach / no_fire.radius_km
    complete = bool(len(no_fire) and np.median(ratio) < 2.0)
    weight = np.clip(REPRESENTS * ratio**2, 1.0, MOST_WEIGHT)
    return replace(no_fire, radius_km=reach), weight, complete
