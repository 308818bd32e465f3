"""The paper's network as the paper describes it (section 5.2): the baseline that the default method has to beat.

Inputs are coordinates and source id; the loss is binary cross-entropy plus one-sided consistency penalties; classes
are balanced by undersampling; Adam at 1e-4, early stopping with a patience of 50 epochs. Widths and loss weights are
not in the paper: three layers of 64, equal weights. A constant bias correction, as in its figure 8, is optional.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, one_hot

from services.arrival import likelihood
from services.arrival.looks import BURNED_AREA, FIRE, NO_FIRE, SOURCES, Looks
from services.arrival.network import PaperNetwork, seeded

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PaperSettings:
    epochs: int = 300
    learning_rate: float = 1e-4
    patience: int = 50
    batch: int = 128
    validation_share: float = 0.2
    bias_correction: bool = False


@dataclass(frozen=True)
class PaperField:
    """A fitted network; local km in, hours out."""

    network: PaperNetwork
    low_km: Floats
    high_km: Floats
    low_h: float
    high_h: float
    source: int
    shift_h: float

    def inputs(self, x_km: Floats, y_km: Floats, source: NDArray[np.int8]) -> Tensor:
        scaled = 2 * (np.column_stack([x_km, y_km]) - self.low_km) / (self.high_km - self.low_km) - 1
        place = torch.tensor(scaled, dtype=torch.float32)
        return torch.cat([place, one_hot(torch.tensor(source, dtype=torch.long), len(SOURCES)).float()], dim=1)

    def hours(self, scaled: Tensor) -> Tensor:
        return self.low_h + (self.high_h - self.low_h) * (scaled + 1) / 2

    def folded(self) -> FoldedNetwork:
        """The network for inference: batch norm folded into the dense layers, plain arrays, no framework."""
        layers = []
        blocks = list(self.network.backbone)
        for dense, norm in zip(blocks[0::4], blocks[1::4], strict=True):
            gain = (norm.weight / torch.sqrt(norm.running_var + norm.eps)).detach()
            weight = (dense.weight.detach() * gain[:, None]).T.contiguous().numpy()
            layers.append((weight, ((dense.bias.detach() - norm.running_mean) * gain + norm.bias.detach()).numpy()))
        heads = [self.network.arrival_head, self.network.detection_head]
        weight = torch.cat([head.weight.detach() for head in heads]).T.contiguous().numpy()
        layers.append((weight, torch.cat([head.bias.detach() for head in heads]).numpy()))
        return FoldedNetwork(
            tuple(layers), self.low_km, self.high_km, self.low_h + self.shift_h, self.high_h + self.shift_h
        )

    @torch.no_grad()
    def at(self, x_km: Floats, y_km: Floats) -> tuple[Floats, Floats]:
        """Arrival h and fire probability at points, as the commonest fire sensor would see them; both (1, n)."""
        self.network.eval()
        source = np.full(x_km.size, self.source, np.int8)
        scaled, logit = self.network(self.inputs(x_km.ravel(), y_km.ravel(), source))
        arrival = self.hours(scaled).numpy().astype(float) + self.shift_h
        return arrival[None], torch.sigmoid(logit).numpy().astype(float)[None]


@dataclass(frozen=True)
class FoldedNetwork:
    """A fitted network as dense layers (weight, bias) on plain arrays; local km and source id in, hours and fire
    probability out. About ten times as fast as the framework for a single sample."""

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    low_km: Floats
    high_km: Floats
    low_h: float
    high_h: float

    def __call__(self, x_km: Floats, y_km: Floats, source: NDArray[np.int8]) -> tuple[Floats, Floats]:
        """Arrival h and fire probability of points (n,) as their sources would see them; both (n,)."""
        values = np.zeros((x_km.size, 2 + len(SOURCES)), np.float32)
        values[:, 0] = 2 * (x_km - self.low_km[0]) / (self.high_km[0] - self.low_km[0]) - 1
        values[:, 1] = 2 * (y_km - self.low_km[1]) / (self.high_km[1] - self.low_km[1]) - 1
        values[np.arange(x_km.size), 2 + source] = 1.0
        for weight, bias in self.layers[:-1]:
            values = np.maximum(values @ weight + bias, 0.0)
        weight, bias = self.layers[-1]
        out = (values @ weight + bias).astype(float)
        hours = self.low_h + (self.high_h - self.low_h) * (out[:, 0] + 1) / 2
        return hours, 1.0 / (1.0 + np.exp(-np.clip(out[:, 1], -30.0, 30.0)))


def undersample(is_fire: NDArray[np.bool_], generator: torch.Generator) -> NDArray[np.int64]:
    """Indices of all fire looks and as many others, in order."""
    fire, other = np.flatnonzero(is_fire), np.flatnonzero(~is_fire)
    if other.size > fire.size:
        other = other[torch.randperm(other.size, generator=generator)[: fire.size].numpy()]
    return np.sort(np.concatenate([fire, other]))


def _loss(field: PaperField, inputs: Tensor, time: Tensor, label: Tensor) -> Tensor:
    scaled, logit = field.network(inputs)
    late, early = likelihood.one_sided(field.hours(scaled), time, label)
    return binary_cross_entropy_with_logits(logit, label) + (late + early).mean() / (field.high_h - field.low_h)


def _new_field(looks: Looks, seed: int) -> PaperField:
    fire = looks.take(looks.kind != NO_FIRE)
    low = np.array([looks.x_km.min(), looks.y_km.min()]) - 0.5
    high = np.array([looks.x_km.max(), looks.y_km.max()]) + 0.5
    common = int(np.bincount(fire.source, minlength=len(SOURCES)).argmax())
    return PaperField(
        PaperNetwork(seed), low, high, float(looks.time_h.min()) - 1.0, float(looks.time_h.max()) + 1.0, common, 0.0
    )


def fit_paper(looks: Looks, settings: PaperSettings, seed: int) -> PaperField:
    """Train on looks with at least one fire. Deterministic in its inputs and `seed`."""
    torch.set_num_threads(1)
    generator = seeded(seed)
    burned = (looks.kind == FIRE) | ((looks.kind == BURNED_AREA) & (looks.probability >= 0.5))
    chosen = undersample(burned, generator)
    used, label = looks.take(chosen), torch.tensor(burned[chosen], dtype=torch.float32)
    field = _new_field(looks, seed)
    inputs, time = field.inputs(used.x_km, used.y_km, used.source), torch.tensor(used.time_h, dtype=torch.float32)
    order = torch.randperm(len(used), generator=generator)
    held = max(int(len(used) * settings.validation_share), 1)
    validation, training = (order[:held], order[held:]) if len(used) >= 10 else (order, order)
    _train(field, inputs, time, label, training, validation, settings, generator, seed)
    if not settings.bias_correction:
        return field
    fire = looks.fire
    shift = float(np.median(fire.time_h - field.at(fire.x_km, fire.y_km)[0][0])) if len(fire) else 0.0
    return PaperField(field.network, field.low_km, field.high_km, field.low_h, field.high_h, field.source, shift)


def _train(
    field: PaperField,
    inputs: Tensor,
    time: Tensor,
    label: Tensor,
    training: Tensor,
    validation: Tensor,
    settings: PaperSettings,
    generator: torch.Generator,
    seed: int,
) -> None:
    optimiser = torch.optim.Adam(field.network.parameters(), lr=settings.learning_rate)
    best, best_state, waited = np.inf, copy.deepcopy(field.network.state_dict()), 0
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)  # dropout draws from the global generator
        for _ in range(settings.epochs):
            field.network.train()
            shuffled = training[torch.randperm(training.numel(), generator=generator)]
            for rows in shuffled.split(settings.batch):
                if rows.numel() < 2 and training.numel() > 1:
                    continue  # batch norm needs two
                if rows.numel() < 2:
                    field.network.eval()
                optimiser.zero_grad()
                _loss(field, inputs[rows], time[rows], label[rows]).backward()
                optimiser.step()
            field.network.eval()
            with torch.no_grad():
                value = float(_loss(field, inputs[validation], time[validation], label[validation]))
            if value < best - 1e-5:
                best, best_state, waited = value, copy.deepcopy(field.network.state_dict()), 0
            else:
                waited += 1
                if waited >= settings.patience:
                    break
    field.network.load_state_dict(best_state)
