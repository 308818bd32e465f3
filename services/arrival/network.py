"""The multi-head networks: one backbone, a detection head and an arrival head (paper, section 5.2 and figure 7)."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

MAX_PARAMETERS = 10_000
SOURCE_COUNT = 4


def seeded(seed: int) -> torch.Generator:
    """A generator of its own, so that no global state decides a result."""
    return torch.Generator().manual_seed(seed)


def _dense(generator: torch.Generator, members: int, inputs: int, outputs: int, gain: float = 1.0) -> nn.Parameter:
    weight = torch.randn(members, inputs, outputs, generator=generator)
    return nn.Parameter(weight * gain * math.sqrt(2.0 / inputs))


class FieldEnsemble(nn.Module):
    """`members` independent networks evaluated together: inputs (members, n, 2) in units of the fire's half extent.

    Fourier features let so small a network bend at the scale of the data (`length` in the same units). The arrival
    head sees the place only, since the fire arrives once, whoever looks; the detection head also gets the source,
    because sensors differ.
    """

    def __init__(self, members: int, length: float, seed: int, features: int = 24, width: int = 56) -> None:
        super().__init__()
        generator = seeded(seed)
        self.register_buffer("frequencies", torch.randn(members, 2, features, generator=generator) / length)
        inputs = 2 + 2 * features
        self.first = _dense(generator, members, inputs, width)
        self.first_bias = nn.Parameter(torch.zeros(members, 1, width))
        self.second = _dense(generator, members, width, width)
        self.second_bias = nn.Parameter(torch.zeros(members, 1, width))
        self.heads = _dense(generator, members, width, 2, gain=0.3)
        self.heads_bias = nn.Parameter(torch.zeros(members, 1, 2))
        self.source_logit = nn.Parameter(torch.zeros(members, SOURCE_COUNT))
        self.detection_raw = nn.Parameter(torch.zeros(members))
        self.clock = nn.Parameter(torch.zeros(members, 2))

    def forward(self, place: Tensor) -> tuple[Tensor, Tensor]:
        """Arrival (scaled, before the clock) and burned logit without a source, both (members, n)."""
        phase = torch.bmm(place, self.frequencies)
        inputs = torch.cat([place, torch.sin(phase), torch.cos(phase)], dim=2)
        hidden = torch.relu(torch.baddbmm(self.first_bias, inputs, self.first))
        hidden = torch.relu(torch.baddbmm(self.second_bias, hidden, self.second))
        out = torch.baddbmm(self.heads_bias, hidden, self.heads)
        return out[..., 0], out[..., 1]

    @property
    def detection(self) -> Tensor:
        """Probability that a burning place is seen burning, 0.2-0.9; (members, 1)."""
        return (0.2 + 0.7 * torch.sigmoid(self.detection_raw)).unsqueeze(1)

    def daily(self, steady_h: Tensor) -> Tensor:
        """Arrival on the wall clock from arrival at a steady pace, hours (members, n): fires run by day and rest by
        night.

        A sine of 24 h with learned phase and an amplitude that keeps time increasing.
        """
        omega = 2 * math.pi / 24.0
        size = self.clock.norm(dim=1, keepdim=True) + 1e-6
        limit = 0.85 / omega * torch.tanh(size) / size
        a, b = (self.clock[:, :1] * limit), (self.clock[:, 1:] * limit)
        return steady_h + a * torch.sin(omega * steady_h) + b * torch.cos(omega * steady_h)

    def parameters_per_member(self) -> int:
        return sum(p.numel() for p in self.parameters()) // self.first.shape[0]


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
