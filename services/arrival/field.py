"""The default method: a smooth field of arrival times fitted to the likelihood of every look.

Arrival at a steady pace is a first guess from the detections plus a Gaussian field with Matern covariance; a daily
clock turns it into hours. The most probable field is found by gradient descent on the looks' likelihood, footprint by
footprint, with the residence time and the detection rate of this fire found along with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree
from torch import Tensor

from services.arrival import likelihood
from services.arrival.extent import gather, supported
from services.arrival.footprints import Footprints, footprints, representative
from services.arrival.grid import FireGrid
from services.arrival.looks import Ignition, Looks
from services.arrival.spectral import CosineField, cosine_field, daily

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FieldSettings:
    """Choices of the fit; lengths in km, times in hours. Tuned on the tuning seeds of the synthetic fires only."""

    members: int = 1
    steps: int = 150
    learning_rate: float = 0.1
    length_km: float = 4.0
    spread_h: float = 25.0
    softness_h: float = 0.8
    first_softness_h: float = 4.0
    residence_h: float = 5.5
    residence_spread: float = 0.3
    lead_h: float = 1.5
    guess_smoothing_km: float = 1.5
    full_size_km: float = 9.0
    near_km: float = 3.0
    edge_km: float = 0.3
    cells: int = 90
    finest_km: float = 0.15
    coarsest_km: float = 0.4
    clock: bool = True
    no_fire: bool = True


@dataclass(frozen=True)
class Field:
    """A fitted field on its own grid: `x_km`, `y_km` cell centres, `arrival_h` (members, rows, columns), and the
    signed distance (km, inside positive) to the edge of the burned region."""

    x_km: Floats
    y_km: Floats
    arrival_h: Floats
    margin_km: Floats
    residence_h: float
    detection: float
    parameters: int

    def _index(self, x_km: Floats, y_km: Floats) -> Floats:
        step = self.x_km[1] - self.x_km[0]
        return np.stack([(np.ravel(y_km) - self.y_km[0]) / step, (np.ravel(x_km) - self.x_km[0]) / step])

    def at(self, x_km: Floats, y_km: Floats) -> Floats:
        """Arrival, hours, of every member at points (n,), bilinear; (members, n)."""
        index = self._index(x_km, y_km)
        return np.stack([map_coordinates(member, index, order=1, mode="nearest") for member in self.arrival_h])

    def margin_at(self, x_km: Floats, y_km: Floats) -> Floats:
        """Signed distance (km) to the edge of the burned region at points (n,); far outside beyond the grid."""
        return map_coordinates(self.margin_km, self._index(x_km, y_km), order=1, mode="constant", cval=-9.0)


@dataclass(frozen=True)
class _Model:
    prior: CosineField
    guess: Tensor
    burned: Tensor
    fire: Footprints | None
    no_fire: Footprints | None
    burned_area: Footprints | None
    residence_spread: float


@dataclass(frozen=True)
class _Unknowns:
    """What the fit changes: white amplitudes, clock, and standardised residence time and detection rate."""

    white: Tensor
    clock: Tensor
    physics: Tensor


def working_grid(grid: FireGrid, anchor: Looks, settings: FieldSettings, margin_km: float = 3.0) -> FireGrid:
    """The grid of the fit: the evidence and a margin, in about `cells` cells a side between the finest and coarsest."""
    x, y = (np.array([v.min() - margin_km, v.max() + margin_km]) for v in (anchor.x_km, anchor.y_km))
    longest = max(np.ptp(x), np.ptp(y))
    cell_km = float(np.clip(longest / settings.cells, settings.finest_km, settings.coarsest_km))
    cell_km = max(cell_km, longest / 400.0)
    axes = [
        (low[0] + cell_km * (np.arange(max(math.ceil(np.ptp(low) / cell_km), 4)) + 0.5) + origin) * 1e3
        for low, origin in zip((x, y), grid.origin_km, strict=True)
    ]
    return FireGrid(grid.epsg, axes[0], axes[1], cell_km * 1e3)


def first_guess(
    anchor: Looks,
    ignition: Ignition,
    cells_km: Floats,
    shape: tuple[int, int],
    smoothing_cells: float,
    lead_h: float,
) -> Floats:
    """A first arrival (cells,): the earliest sighting around each sighting, spread by inverse distance and smoothed,
    growing beyond the last one at half the fire's typical pace."""
    place, time = np.column_stack([anchor.x_km, anchor.y_km]), anchor.time_h - lead_h
    if ignition.x_km is not None:
        place, time = np.vstack([place, [ignition.x_km, ignition.y_km]]), np.append(time, ignition.time_h)
    run = np.hypot(*(place - place[np.argmin(time)]).T)
    far = run > 1.0
    pace = float(np.median((time - time.min())[far] / run[far])) if far.sum() > 5 else 8.0
    tree = cKDTree(place)
    first = np.array([time[near].min() for near in tree.query_ball_point(place, 0.35)])
    distance, index = tree.query(cells_km, k=list(range(1, min(8, len(place)) + 1)))
    weight = 1 / (distance + 0.3) ** 2
    guess = (weight * first[index]).sum(axis=1) / weight.sum(axis=1)
    guess += 0.5 * float(np.clip(pace, 2, 25)) * np.maximum(distance[:, 0] - 0.3, 0)
    guess = np.maximum(guess, min(ignition.time_h, time.min()))
    return gaussian_filter(guess.reshape(shape), smoothing_cells, mode="nearest").ravel()


def _model(looks: Looks, anchor: Looks, grid: FireGrid, ignition: Ignition, settings: FieldSettings) -> _Model:
    """The fit's fixed parts; `looks` are in the working grid's local coordinates."""
    x, y = grid.cell_centres_km()
    cells, cell_km = np.column_stack([x.ravel(), y.ravel()]), grid.cell_m / 1e3
    evidence = gather(grid, looks)
    no_fire, complete = looks.no_fire, False
    weight = np.ones(0)
    if len(no_fire):
        places = cKDTree(np.column_stack([anchor.x_km, anchor.y_km]))
        near = places.query(np.column_stack([no_fire.x_km, no_fire.y_km]))[0] < settings.near_km
        no_fire, weight, complete = representative(no_fire.take(near))
    # A small fire bends on its own scale: lengths shrink with the side of a square of its area.
    size = float(np.clip(np.sqrt(evidence.enclosed.sum()) * cell_km / settings.full_size_km, 0.15, 1.0))
    smoothing = size * settings.guess_smoothing_km / cell_km
    guess = first_guess(anchor, ignition, cells, grid.shape, smoothing, settings.lead_h)
    margin = np.clip(evidence.margin_km / settings.edge_km, -8.0, 8.0).ravel()
    return _Model(
        cosine_field(*grid.shape, cell_km, size * settings.length_km),
        torch.tensor(guess, dtype=torch.float32),
        torch.sigmoid(torch.tensor(margin, dtype=torch.float32)),
        footprints(looks.fire, cells, cell_km),
        footprints(no_fire, cells, cell_km, weight) if settings.no_fire else None,
        footprints(looks.burned_area, cells, cell_km),
        # Only complete granules say how long a place burns: of thinned ones the looks that matter are missing.
        settings.residence_spread if complete else 0.02,
    )


def _evaluate(model: _Model, unknowns: _Unknowns, settings: FieldSettings) -> Tensor:
    """Arrival h (members, cells)."""
    steady = model.guess + settings.spread_h * model.prior(unknowns.white)
    return daily(steady, unknowns.clock) if settings.clock else steady


def _physics(unknowns: _Unknowns, model: _Model, settings: FieldSettings) -> tuple[Tensor, Tensor]:
    """Residence h and detection rate, both (members, 1)."""
    residence = settings.residence_h * torch.exp(model.residence_spread * unknowns.physics[:, :1])
    return residence, 0.1 + 0.8 * torch.sigmoid(unknowns.physics[:, 1:])


def _loss(model: _Model, unknowns: _Unknowns, settings: FieldSettings, soft: float, weights: list[Tensor]) -> Tensor:
    arrival = _evaluate(model, unknowns, settings)
    residence, detection = _physics(unknowns, model, settings)
    loss = 0.5 * sum((part**2).sum() for part in (unknowns.white, unknowns.clock, unknowns.physics))
    for looks, own, is_fire in ((model.fire, weights[0], True), (model.no_fire, weights[1], False)):
        if looks is not None:
            age = looks.time[looks.look] - arrival[:, looks.cell]
            alight = likelihood.burning(age, residence, soft, settings.softness_h) * model.burned[looks.cell]
            cost = likelihood.footprint_seen(looks.seen(alight), detection, is_fire)
            loss = loss + (own * looks.weight * cost).sum()
    if model.burned_area is not None:
        looks = model.burned_area
        age = looks.time[looks.look] - arrival[:, looks.cell]
        share = looks.seen(torch.sigmoid(age / soft) * model.burned[looks.cell])
        loss = loss + likelihood.share_burned(share, looks.probability).sum()
    return loss


def fit_field(looks: Looks, grid: FireGrid, ignition: Ignition, settings: FieldSettings, seed: int) -> Field:
    """Fit to looks with at least one fire detection or burned-area point. Deterministic in its inputs and `seed`.

    With several members each is fitted to looks weighted at random (the Bayesian bootstrap, Rubin 1981).
    """
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    work = working_grid(grid, supported(looks), settings)
    shift = np.subtract(work.origin_km, grid.origin_km)
    moved = looks.moved(-shift[0], -shift[1])
    start = ignition.moved(-shift[0], -shift[1])
    model = _model(moved, supported(moved), work, start, settings)
    members = settings.members
    unknowns = _Unknowns(
        *(torch.zeros(members, *size, requires_grad=True) for size in (model.prior.amplitude.shape, (2,), (2,)))
    )
    weights = [
        torch.empty(members, count).exponential_(generator=generator) if members > 1 else torch.ones(1, count)
        for count in (len(part.time) if part is not None else 0 for part in (model.fire, model.no_fire))
    ]
    _descend(model, unknowns, settings, weights)
    with torch.no_grad():
        arrival = _evaluate(model, unknowns, settings).numpy().astype(float).reshape(members, *work.shape)
        residence, detection = (float(value.mean()) for value in _physics(unknowns, model, settings))
    margin = gather(work, moved).margin_km
    x, y = work.x_m / 1e3 - grid.origin_km[0], work.y_m / 1e3 - grid.origin_km[1]
    count = sum(part.numel() for part in (unknowns.white, unknowns.clock, unknowns.physics)) // members
    return Field(x, y, arrival, np.maximum(margin, -9.0), residence, detection, count)


def _descend(model: _Model, unknowns: _Unknowns, settings: FieldSettings, weights: list[Tensor]) -> None:
    slow = {"params": [unknowns.clock, unknowns.physics], "lr": 0.3 * settings.learning_rate}
    optimiser = torch.optim.Adam([{"params": [unknowns.white], "lr": settings.learning_rate}, slow])
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda step: 0.02 + 0.5 * (1 + math.cos(math.pi * min(step / settings.steps, 1.0)))
    )
    for step in range(settings.steps):
        # Wide windows first: a guess far off still feels which way to go.
        narrowed = min(step / (0.4 * settings.steps), 1.0)
        soft = settings.first_softness_h + (settings.softness_h - settings.first_softness_h) * narrowed
        optimiser.zero_grad()
        _loss(model, unknowns, settings, soft, weights).backward()
        optimiser.step()
        schedule.step()
