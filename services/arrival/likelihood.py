"""What each kind of look says about the arrival time T, as negative log-likelihoods (hours; torch tensors of one
shape).

Sources differ: an active-fire detection at t says burning at t (t - residence <= T <= t); a no-fire look says not
burning at t, which is "not yet" as well as "no longer", or missed; a burned-area point says only T <= t, with its
probability.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid, relu, softplus


def fire_seen(arrival: Tensor, time: Tensor, residence: float, softness_h: float) -> Tensor:
    """Burning at `time`: outside the window [time - residence, time] the cost grows linearly, so outliers cannot
    dominate."""
    late = softplus((arrival - time) / softness_h)
    early = softplus((time - residence - arrival) / softness_h)
    return late + early


def no_fire_seen(arrival: Tensor, time: Tensor, residence: float, detection: Tensor, softness_h: float) -> Tensor:
    """Not seen burning at `time`: 1 - P(detect) inside the burning window, 1 outside it. Bounded: one look proves
    little."""
    burning = torch.sigmoid((time - arrival) / softness_h) * torch.sigmoid((arrival + residence - time) / softness_h)
    return -torch.log1p(-detection * burning)


def burned_seen(arrival: Tensor, time: Tensor, probability: Tensor, softness_h: float) -> Tensor:
    """Burned at `time` with a probability: T <= time with it, T > time without it; 0.5 says nothing."""
    odds = torch.logit(probability.clamp(0.05, 0.95))
    gap = (time - arrival) / softness_h
    burned, unburned = logsigmoid(gap), logsigmoid(-gap)
    return -torch.logaddexp(burned + logsigmoid(odds), unburned + logsigmoid(-odds))


def one_sided(arrival: Tensor, time: Tensor, is_fire: Tensor) -> tuple[Tensor, Tensor]:
    """The paper's penalties (section 5.2), hours: later than a fire seen; earlier than a look that saw no fire."""
    return relu(arrival - time) * is_fire, relu(time - arrival) * (1 - is_fire)
