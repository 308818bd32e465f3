"""The network that says how much later or earlier than fitted a place burned, and whether it burned by the end.

A small U-Net on the square of cells (Ronneberger et al. 2015), its weights in `models/posterior.npz` with a card beside
it. Its answer is the mean over the eight turns and mirrorings of the square, so that no direction is preferred.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

MODEL = Path(__file__).parents[1] / "models" / "posterior.npz"
# Offsets (h) from the fitted arrival that the network gives probabilities to.
EARLIEST_H, OFFSET_STEP_H, OFFSETS = -36.0, 1.5, 49
# Log odds of burned that the region of the sightings gives alone, by the distance (km) to its edge.
EDGE_KM, MOST_ODDS, EDGE_SHARE = 0.4, 6.0, 0.5
Singles = NDArray[np.float32]
Weights = dict[str, Tensor]


@cache
def weights() -> Weights:
    """The trained weights as single floats, read once."""
    with np.load(MODEL, allow_pickle=False) as stored:
        return {name: torch.from_numpy(stored[name].astype(np.float32)) for name in stored.files}


def _layer(own: Weights, name: str, x: Tensor) -> Tensor:
    kernel = own[f"{name}.weight"]
    return functional.relu(functional.conv2d(x, kernel, own[f"{name}.bias"], padding=kernel.shape[-1] // 2))


def _twice(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def forward(own: Weights, channels: Tensor) -> Tensor:
    """Logits (1, OFFSETS + 1, rows, columns) of channels (1, n, rows, columns): of every offset, and of burned beyond
    what the region's edge says. Sides must be multiples of four."""
    stem = _layer(own, "stem", channels)
    full = _layer(own, "full", stem)
    half = _layer(own, "half_b", _layer(own, "half_a", functional.avg_pool2d(full, 2)))
    quarter = _layer(own, "quarter_b", _layer(own, "quarter_a", functional.avg_pool2d(half, 2)))
    whole = functional.linear(quarter.mean((2, 3)), own["whole.weight"], own["whole.bias"])
    quarter = quarter + functional.relu(whole)[:, :, None, None]
    half = _layer(own, "half_up", torch.cat([_twice(quarter), half], 1))
    full = _layer(own, "full_b", _layer(own, "full_a", torch.cat([_twice(half), full], 1)))
    head = _layer(own, "head", torch.cat([full, stem], 1))
    return functional.conv2d(head, own["out.weight"], own["out.bias"])


def predict(channels: Singles, margin_km: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities (OFFSETS, rows, columns) of the offsets from the fitted arrival, and log odds (rows, columns) of
    burned by the end, of channels (n, rows, columns) and the distance to the region's edge (km, inside positive)."""
    torch.set_num_threads(1)  # sums split over threads would round differently
    own = weights()
    x = torch.from_numpy(channels)[None]
    probability, odds = torch.zeros(OFFSETS, *x.shape[2:]), torch.zeros(x.shape[2:])
    with torch.no_grad():
        for turns in range(4):
            for mirrored in (False, True):
                turned = torch.rot90(x, turns, (2, 3))
                logits = forward(own, turned.flip(3) if mirrored else turned)
                back = torch.rot90(logits.flip(3) if mirrored else logits, -turns, (2, 3))[0]
                probability += torch.softmax(back[:OFFSETS], 0) / 8.0
                odds += back[OFFSETS] / 8.0
    edge = np.clip(margin_km / EDGE_KM, -MOST_ODDS, MOST_ODDS)
    return probability.numpy().astype(float), odds.numpy().astype(float) + EDGE_SHARE * edge
