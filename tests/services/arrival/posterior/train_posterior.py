"""Learn the correction anew: `python -m tests.services.arrival.posterior.train_posterior` writes its weights.

Every fire is made, observed and fitted first (some 3 s of one core), then the network sees each of them once an epoch
(50 ms), turned and mirrored at random. One thread and fixed seeds: the same fires give the same weights.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from services.arrival.posterior.network import EARLIEST_H, MODEL, OFFSET_STEP_H, OFFSETS
from tests.services.arrival.posterior.lessons import Lesson, batch, lessons
from tests.services.arrival.seeds import TRAINING, TRAINING_SMALL

WIDTHS = (32, 48, 64)
FIRES, SMALL, EPOCHS, BATCH, RATE = 1250, 300, 43, 8, 2.5e-3
# Hours: a fire counts by its own error, so that hopeless ones do not outweigh the well-seen; scale of the first guess.
EASE_H, TYPICAL_H = 2.0, 2.5
EXTENT_WEIGHT, OVERLAP_WEIGHT = 4.0, 1.0


def _layer(into: int, out: int, side: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(into, out, side, padding=side // 2, bias=False), nn.BatchNorm2d(out), nn.ReLU(inplace=False)
    )


class Learner(nn.Module):
    """The network of `services.arrival.posterior.network` while it learns: with batch normalisation after each layer
    and of what it reads. At first it says nothing: a wide distribution about the fitted arrival."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        a, b, c = WIDTHS
        self.read = nn.BatchNorm2d(channels, affine=False)
        self.layers = nn.ModuleDict(
            {
                "stem": _layer(channels, a, 1),
                "full": _layer(a, a),
                "half_a": _layer(a, b),
                "half_b": _layer(b, b),
                "quarter_a": _layer(b, c),
                "quarter_b": _layer(c, c),
                "half_up": _layer(c + b, b),
                "full_a": _layer(b + a, a),
                "full_b": _layer(a, a),
            }
        )
        self.whole, self.head, self.out = nn.Linear(c, c), nn.Conv2d(2 * a, a, 1), nn.Conv2d(a, OFFSETS + 1, 1)
        offset = EARLIEST_H + OFFSET_STEP_H * torch.arange(OFFSETS)
        nn.init.zeros_(self.out.weight)
        with torch.no_grad():
            self.out.bias[:OFFSETS] = -1.2 * torch.log(1 + (offset / TYPICAL_H) ** 2)
            self.out.bias[OFFSETS] = 0.0

    def forward(self, channels: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of the offsets (n, OFFSETS, rows, columns), and of burned beyond the edge's (n, rows, columns)."""
        layer = self.layers
        stem = layer["stem"](self.read(channels))
        full = layer["full"](stem)
        half = layer["half_b"](layer["half_a"](functional.avg_pool2d(full, 2)))
        quarter = layer["quarter_b"](layer["quarter_a"](functional.avg_pool2d(half, 2)))
        quarter = quarter + functional.relu(self.whole(quarter.mean((2, 3))))[:, :, None, None]
        half = layer["half_up"](torch.cat([self._twice(quarter), half], 1))
        full = layer["full_b"](layer["full_a"](torch.cat([self._twice(half), full], 1)))
        out = self.out(functional.relu(self.head(torch.cat([full, stem], 1))))
        return out[:, :OFFSETS], out[:, OFFSETS]

    @staticmethod
    def _twice(x: Tensor) -> Tensor:
        return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)

    def folded(self) -> dict[str, np.ndarray]:
        """The weights with every normalisation taken into the convolution before it, half precision."""
        found: dict[str, Tensor] = {}
        for name, part in self.layers.items():
            convolution, norm = part[0], part[1]
            kernel, bias = convolution.weight.double(), torch.zeros(convolution.out_channels, dtype=torch.double)
            if name == "stem":
                scale = 1 / torch.sqrt(self.read.running_var.double() + self.read.eps)
                bias = -(kernel[:, :, 0, 0] * (self.read.running_mean.double() * scale)).sum(1)
                kernel = kernel * scale[None, :, None, None]
            scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
            found[f"{name}.weight"] = kernel * scale[:, None, None, None]
            found[f"{name}.bias"] = (bias - norm.running_mean.double()) * scale + norm.bias.double()
        for name in ("whole", "head", "out"):
            part = getattr(self, name)
            found |= {f"{name}.weight": part.weight, f"{name}.bias": part.bias}
        return {name: values.detach().numpy().astype(np.float16) for name, values in found.items()}


def ranked_score(logits: Tensor, offset_h: Tensor) -> Tensor:
    """Continuous ranked probability score, h, of each cell (n, rows, columns)."""
    reached = torch.softmax(logits, 1).cumsum(1)[:, :-1]
    edges = (EARLIEST_H + OFFSET_STEP_H * (torch.arange(OFFSETS - 1) + 0.5))[None, :, None, None]
    truth = torch.clamp((edges - offset_h[:, None]) / OFFSET_STEP_H + 0.5, 0, 1)
    return ((reached - truth) ** 2).sum(1) * OFFSET_STEP_H


def loss(learner: Learner, stacked: tuple[Tensor, ...]) -> Tensor:
    """Ranked score over burned cells, cross entropy and overlap of what burned; every fire counts alike."""
    read, offset, burned, counts, edge = stacked
    with torch.autocast("cpu", dtype=torch.bfloat16):
        logits, odds = learner(read)
    logits, odds = logits.float(), odds.float() + edge
    cells = burned.sum((1, 2)).clamp(min=1)
    weight = (2.0 * TYPICAL_H) / (EASE_H + (offset.abs() * burned).sum((1, 2)) / cells)
    hours = (ranked_score(logits, offset) * burned).sum((1, 2)) / cells * weight
    crossed = functional.binary_cross_entropy_with_logits(odds, burned, reduction="none") * counts
    extent = crossed.sum((1, 2)) / cells.clamp(min=60)
    said = torch.sigmoid(odds) * counts
    both, whole = (said * burned).sum((1, 2)), said.sum((1, 2)) + burned.sum((1, 2))
    overlap = 1 - (2 * both + 20) / (whole + 20)
    return hours.mean() + EXTENT_WEIGHT * (extent + OVERLAP_WEIGHT * overlap).mean()


def train(given: list[Lesson], epochs: int) -> Learner:
    """A learner that has seen every lesson once an epoch. Deterministic."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    learner, count = Learner(given[0].read.shape[0]), max(len(given) // BATCH, 1)
    optimiser = torch.optim.AdamW(learner.parameters(), lr=RATE, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=count * epochs, pct_start=0.15)
    for _ in range(epochs):
        order = rng.permutation(len(given))
        for k in range(count):
            cost = loss(learner, batch([given[i] for i in order[k * BATCH : (k + 1) * BATCH]], rng))
            optimiser.zero_grad()
            cost.backward()
            nn.utils.clip_grad_norm_(learner.parameters(), 2.0)
            optimiser.step()
            schedule.step()
    return learner


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--file", type=Path, default=MODEL)
    parser.add_argument("--fires", type=int, default=FIRES)
    parser.add_argument("--small", type=int, default=SMALL)
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    given = list(lessons([*TRAINING[: chosen.fires], *TRAINING_SMALL[: chosen.small]]))
    np.savez(chosen.file, **train(given, chosen.epochs).folded())


if __name__ == "__main__":
    main()
