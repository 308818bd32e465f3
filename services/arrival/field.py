"""The improved network method: an ensemble of Fourier-feature fields fitted to the likelihood of every look."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, smooth_l1_loss

from services.arrival import likelihood
from services.arrival.extent import Evidence, supported
from services.arrival.grid import FireGrid
from services.arrival.looks import GNSSR, Looks
from services.arrival.network import FieldEnsemble, seeded

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FieldSettings:
    """Choices of the fit; lengths in km, times in hours. Tuned on the tuning seeds of the synthetic fires only."""

    members: int = 4
    steps: int = 500
    learning_rate: float = 6e-3
    length_km: float = 4.0
    softness_h: float = 1.0
    near_km: float = 4.0
    far_km: float = 0.6
    batch: int = 128
    smoothness: float = 0.05
    burned_area_weight: float = 0.3
    detection_weight: float = 0.5
    ignition_sd_h: float = 3.0
    clock: bool = True
    residence_h: float = 5.5


@dataclass(frozen=True)
class Ignition:
    """Where (local km; None: unknown) and when (hours) the fire was reported to have started."""

    time_h: float
    x_km: float | None = None
    y_km: float | None = None


@dataclass(frozen=True)
class Group:
    """Looks that enter one term of the loss, as tensors; `rows` (members, m) index what each member may draw."""

    place: Tensor
    time: Tensor
    probability: Tensor
    radius: Tensor
    source: Tensor
    rows: Tensor

    def draw(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Places within footprints (members, count, 2) km and the indices drawn."""
        pick = torch.randint(self.rows.shape[1], (self.rows.shape[0], count), generator=generator)
        index = self.rows.gather(1, pick)
        jitter = torch.randn(*index.shape, 2, generator=generator) * (0.5 * self.radius[index]).unsqueeze(2)
        return self.place[index] + jitter, index


def _group(looks: Looks, members: int, generator: torch.Generator, share: float = 0.8) -> Group | None:
    """A group in which each member sees about `share` of the granules: members then disagree where single passes
    decide."""
    if len(looks) == 0:
        return None
    granule = np.unique(np.round(looks.time_h, 2), return_inverse=True)[1]
    rows = []
    size = 4096
    for _ in range(members):
        kept = torch.rand(int(granule.max()) + 1, generator=generator).numpy() < share
        allowed = np.flatnonzero(kept[granule])
        if allowed.size == 0:
            allowed = np.arange(len(looks))
        pick = (
            torch.randint(allowed.size, (size,), generator=generator).numpy()
            if allowed.size > size
            else np.resize(allowed, size)
        )
        rows.append(allowed[pick] if allowed.size > size else pick)
    tensor = [
        torch.tensor(a, dtype=torch.float32)
        for a in (np.column_stack([looks.x_km, looks.y_km]), looks.time_h, looks.probability, looks.radius_km)
    ]
    return Group(*tensor, torch.tensor(looks.source, dtype=torch.long), torch.tensor(np.array(rows), dtype=torch.long))


@dataclass(frozen=True)
class Field:
    """A fitted ensemble; local km in, hours out."""

    network: FieldEnsemble
    centre_km: Tensor
    half_km: float
    centre_h: float
    spread_h: float
    use_clock: bool

    def evaluate(self, place_km: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Arrival h, burned logit and steady-pace arrival h of places (members, n, 2); each (members, n)."""
        scaled, logit = self.network((place_km - self.centre_km) / self.half_km)
        steady = self.centre_h + self.spread_h * scaled
        return (self.network.daily(steady) if self.use_clock else steady), logit, steady

    @torch.no_grad()
    def at(self, x_km: Floats, y_km: Floats, chunk: int = 32768) -> tuple[Floats, Floats]:
        """Arrival h and burned probability of every member at points (n,); both (members, n)."""
        places = torch.tensor(np.column_stack([x_km.ravel(), y_km.ravel()]), dtype=torch.float32)
        members = self.network.first.shape[0]
        parts = [self.evaluate(part.expand(members, -1, -1)) for part in places.split(chunk)]
        arrival = torch.cat([part[0] for part in parts], dim=1).numpy().astype(float)
        probability = torch.cat([torch.sigmoid(part[1]) for part in parts], dim=1).numpy().astype(float)
        return arrival, probability


@dataclass(frozen=True)
class _Terms:
    fire: Group | None
    near: Group | None
    near_weight: float
    burned_area: Group | None
    unburned: Group | None
    enclosed: Tensor | None
    ignition: Ignition
    anchor: Tensor


def _prepare(
    looks: Looks,
    grid: FireGrid,
    evidence: Evidence,
    ignition: Ignition,
    settings: FieldSettings,
    generator: torch.Generator,
) -> _Terms:
    fire, no_fire = looks.fire, looks.no_fire
    anchor = supported(looks)
    distance, _ = (
        cKDTree(np.column_stack([anchor.x_km, anchor.y_km])).query(np.column_stack([no_fire.x_km, no_fire.y_km]))
        if len(no_fire)
        else (np.zeros(0), 0)
    )
    near = no_fire.take(distance <= settings.near_km)
    column = np.clip(
        ((no_fire.x_km + grid.origin_km[0]) * 1e3 - grid.x_m[0]) / grid.cell_m + 0.5, 0, grid.shape[1] - 1
    ).astype(int)
    row = np.clip(
        ((no_fire.y_km + grid.origin_km[1]) * 1e3 - grid.y_m[0]) / grid.cell_m + 0.5, 0, grid.shape[0] - 1
    ).astype(int)
    outside = (distance > settings.far_km) & ~evidence.enclosed[row, column]
    x, y = grid.cell_centres_km()
    inner = evidence.enclosed
    enclosed = torch.tensor(np.column_stack([x[inner], y[inner]]), dtype=torch.float32) if inner.any() else None
    args = (settings.members, generator)
    return _Terms(
        _group(fire, *args),
        _group(near, *args),
        min(len(near) / max(len(fire), 1), 4.0),
        _group(looks.burned_area, *args),
        _group(no_fire.take(outside), *args),
        enclosed,
        ignition,
        torch.tensor(np.column_stack([anchor.x_km, anchor.y_km]), dtype=torch.float32),
    )


def _arrival_loss(field: Field, terms: _Terms, settings: FieldSettings, generator: torch.Generator) -> Tensor:
    network, soft = field.network, settings.softness_h
    loss = torch.zeros(())
    if terms.fire is not None:
        place, index = terms.fire.draw(settings.batch, generator)
        arrival, logit, _ = field.evaluate(place)
        time = terms.fire.time[index]
        loss = loss + likelihood.fire_seen(arrival, time, settings.residence_h, soft).mean(1).sum()
        logit = logit + network.source_logit.gather(1, terms.fire.source[index])
        loss = (
            loss
            + settings.detection_weight
            * binary_cross_entropy_with_logits(logit, torch.ones_like(logit), reduction="none").mean(1).sum()
        )
    if terms.near is not None:
        place, index = terms.near.draw(settings.batch, generator)
        arrival, _, _ = field.evaluate(place)
        cost = likelihood.no_fire_seen(arrival, terms.near.time[index], settings.residence_h, network.detection, soft)
        loss = loss + terms.near_weight * cost.mean(1).sum()
    if terms.burned_area is not None:
        place, index = terms.burned_area.draw(settings.batch // 4, generator)
        arrival, logit, _ = field.evaluate(place)
        probability = terms.burned_area.probability[index]
        cost = likelihood.burned_seen(arrival, terms.burned_area.time[index], probability, soft)
        logit = logit + network.source_logit[:, GNSSR : GNSSR + 1]
        cost = cost + settings.detection_weight * binary_cross_entropy_with_logits(logit, probability, reduction="none")
        loss = loss + settings.burned_area_weight * cost.mean(1).sum()
    return loss


def _extent_loss(field: Field, terms: _Terms, settings: FieldSettings, generator: torch.Generator) -> Tensor:
    members = settings.members
    loss = torch.zeros(())
    if terms.unburned is not None:
        place, index = terms.unburned.draw(settings.batch, generator)
        _, logit, _ = field.evaluate(place)
        logit = logit + field.network.source_logit.gather(1, terms.unburned.source[index])
        loss = loss + binary_cross_entropy_with_logits(logit, torch.zeros_like(logit), reduction="none").mean(1).sum()
    if terms.enclosed is not None:
        pick = torch.randint(terms.enclosed.shape[0], (members, settings.batch // 4), generator=generator)
        _, logit, _ = field.evaluate(terms.enclosed[pick])
        loss = (
            loss + 0.5 * binary_cross_entropy_with_logits(logit, torch.ones_like(logit), reduction="none").mean(1).sum()
        )
    return settings.detection_weight * loss


def _prior_loss(field: Field, terms: _Terms, settings: FieldSettings, generator: torch.Generator) -> Tensor:
    """Smoothness of the steady-pace arrival, the ignition, and no arrival before it."""
    members, step = settings.members, 0.25 * settings.length_km
    pick = torch.randint(terms.anchor.shape[0], (members, 48), generator=generator)
    centre = terms.anchor[pick] + torch.randn(members, 48, 2, generator=generator) * 0.5 * settings.length_km
    angle = torch.rand(members, 48, 1, generator=generator) * 2 * math.pi
    offset = step * torch.cat([torch.cos(angle), torch.sin(angle)], dim=2)
    arrival, _, steady = field.evaluate(torch.cat([centre - offset, centre, centre + offset], dim=1))
    low, middle, high = steady.split(48, dim=1)
    loss = settings.smoothness * ((low - 2 * middle + high) / settings.softness_h).abs().mean(1).sum()
    early = torch.relu(terms.ignition.time_h - arrival) / settings.ignition_sd_h
    loss = loss + 0.5 * early.mean(1).sum()
    if terms.ignition.x_km is not None:
        place = torch.tensor([[terms.ignition.x_km, terms.ignition.y_km]]).float().expand(members, -1, -1)
        off = (field.evaluate(place)[0] - terms.ignition.time_h) / settings.ignition_sd_h
        loss = loss + 0.2 * smooth_l1_loss(off, torch.zeros_like(off), reduction="sum")
    return loss


def fit_field(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, settings: FieldSettings, seed: int
) -> Field:
    """Fit the ensemble to looks (at least one fire detection or burned-area point). Deterministic in its inputs and
    `seed`."""
    torch.set_num_threads(1)
    generator = seeded(seed)
    anchor = supported(looks)
    low = np.array([anchor.x_km.min(), anchor.y_km.min()]) - 2.0
    high = np.array([anchor.x_km.max(), anchor.y_km.max()]) + 2.0
    half = float((high - low).max() / 2)
    times = np.append(anchor.time_h, ignition.time_h)
    field = Field(
        FieldEnsemble(settings.members, settings.length_km / half, seed),
        torch.tensor((low + high) / 2, dtype=torch.float32),
        half,
        float(np.median(anchor.time_h)),
        float(max(times.std(), 6.0)),
        settings.clock,
    )
    terms = _prepare(looks, grid, evidence, ignition, settings, generator)
    optimiser = torch.optim.Adam(field.network.parameters(), lr=settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
        optimiser, settings.steps, eta_min=settings.learning_rate * 0.02
    )
    for _ in range(settings.steps):
        optimiser.zero_grad()
        loss = _arrival_loss(field, terms, settings, generator)
        loss = loss + _extent_loss(field, terms, settings, generator) + _prior_loss(field, terms, settings, generator)
        loss.backward()
        optimiser.step()
        schedule.step()
    return field
