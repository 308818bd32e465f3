"""The multi-head network: one backbone, a detection head and an arrival head (paper, section 5.2 and figure 7)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

SOURCE_COUNT = 4


def seeded(seed: int) -> torch.Generator:
    """A generator of its own, so that no global state decides a result."""
    return torch.Generator().manual_seed(seed)


class PaperNetwork(nn.Module):
    """The paper's reading: coordinates and source id in, dense layers with batch norm, ReLU and dropout, two heads.

    The paper gives about 10,000 parameters and no widths: three layers of 64 here.
    """

    def __init__(self, seed: int, width: int = 64, dropout: float = 0.2) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            layers: list[nn.Module] = []
            for inputs in (2 + SOURCE_COUNT, width, width):
                layers += [nn.Linear(inputs, width), nn.BatchNorm1d(width), nn.ReLU(), nn.Dropout(dropout)]
            self.backbone = nn.Sequential(*layers)
            self.detection_head = nn.Linear(width, 1)
            self.arrival_head = nn.Linear(width, 1)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Arrival (scaled) and fire logit of inputs (n, 2 + sources), both (n,)."""
        hidden = self.backbone(inputs)
        return self.arrival_head(hidden).squeeze(1), self.detection_head(hidden).squeeze(1)


def parameter_count(network: nn.Module) -> int:
    """Trainable parameters of a network."""
    return sum(p.numel() for p in network.parameters() if p.requires_grad)
