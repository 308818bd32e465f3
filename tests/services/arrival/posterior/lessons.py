"""What the network learns from: simulated fires as the service sees and fits them, with their truth on the square."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from services.arrival.extent import gather
from services.arrival.field import FieldSettings, fit_field
from services.arrival.grid import FireGrid
from services.arrival.posterior.channels import channels
from services.arrival.posterior.correction import FEWEST
from services.arrival.posterior.network import EDGE_KM, EDGE_SHARE, MOST_ODDS
from services.arrival.posterior.square import Square, square_around
from tests.services.arrival.posterior.training_fires import training_fire
from tests.services.arrival.scored import case_of
from tests.services.arrival.synthetic_fires import SyntheticFire

FEWEST_BURNED = 25
FINEST_CELL_M = 60.0
NEAR_KM = 4.0
LARGEST_OFFSET_H = 40.0


@dataclass(frozen=True)
class Lesson:
    """Of one fire, on its square (rows, columns): the channels, the true arrival's offset (h) from the fitted one (0
    unburned), what burned, what counts, and the log odds of burned that the edge of the sightings gives."""

    read: np.ndarray
    offset_h: np.ndarray
    burned: np.ndarray
    counts: np.ndarray
    edge: np.ndarray


def lesson(fire: SyntheticFire, cell_m: float) -> Lesson | None:
    """A fire's lesson; None where too little of it burned or was seen."""
    if np.isfinite(fire.arrival_h).sum() < FEWEST_BURNED or fire.detections["fire"].sum() < FEWEST:
        return None
    case = case_of(fire, cell_m)
    if len(case.looks.fire) < FEWEST:
        return None
    field = fit_field(case.looks, case.grid, case.ignition, FieldSettings(), 0)
    square = square_around(case.looks.fire)
    grid = FireGrid(case.grid.epsg, 1e3 * square.x_km, 1e3 * square.y_km, 1e3 * square.cell_km)
    evidence = gather(grid, case.looks.moved(*(-value for value in grid.origin_km)))
    read, arrival = channels(square, case.looks, field, evidence, case.ignition, case.end_h)
    lead_h = (fire.start - case.reference).total_seconds() / 3600.0
    truth = truth_at(fire, square, case.grid.origin_km) + lead_h
    burned = np.isfinite(truth)
    if burned.sum() < 15:
        return None
    offset = np.clip(np.where(burned, truth - arrival, 0.0), -LARGEST_OFFSET_H, LARGEST_OFFSET_H)
    edge = EDGE_SHARE * np.clip(evidence.margin_km / EDGE_KM, -MOST_ODDS, MOST_ODDS)
    counts = (evidence.distance_km < NEAR_KM) | burned
    return Lesson(read.astype(np.float16), offset.astype(np.float32), burned, counts, edge.astype(np.float32))


def truth_at(fire: SyntheticFire, square: Square, origin_km: tuple[float, float]) -> np.ndarray:
    """True arrival, hours since the fire's start, at the cells of a square around `origin_km` (UTM); NaN unburned."""
    cell_m = fire.x_m[1] - fire.x_m[0]
    row, column = (
        np.floor((1e3 * (axis + origin) - start) / cell_m + 0.5).astype(int)
        for axis, origin, start in (
            (square.y_km, origin_km[1], fire.y_m[0]),
            (square.x_km, origin_km[0], fire.x_m[0]),
        )
    )
    inside = ((row >= 0) & (row < fire.y_m.size))[:, None] & ((column >= 0) & (column < fire.x_m.size))
    picked = fire.arrival_h[np.clip(row, 0, fire.y_m.size - 1)][:, np.clip(column, 0, fire.x_m.size - 1)]
    return np.where(inside, picked, np.nan)


def lessons(seeds: Iterable[int]) -> Iterator[Lesson]:
    """The lessons of the training fires of these seeds, those left out that say too little."""
    for seed in seeds:
        fire, share = training_fire(seed)
        found = lesson(fire, max(500.0 * share, FINEST_CELL_M))
        if found is not None:
            yield found


def batch(chosen: list[Lesson], rng: np.random.Generator) -> tuple[Tensor, ...]:
    """Lessons stacked, each turned and mirrored at random: channels, offsets, burned, counts, edge."""
    columns: list[list[np.ndarray]] = [[] for _ in range(5)]
    for entry in chosen:
        turn = int(rng.integers(8))
        parts = (entry.read, entry.offset_h[None], entry.burned[None], entry.counts[None], entry.edge[None])
        for column, part in zip(columns, parts, strict=True):
            mirrored = part if turn < 4 else part[:, :, ::-1]
            column.append(np.ascontiguousarray(np.rot90(mirrored, turn % 4, (1, 2))))
    first, *rest = (torch.from_numpy(np.stack(column).astype(np.float32)) for column in columns)
    return first, *(part[:, 0] for part in rest)
