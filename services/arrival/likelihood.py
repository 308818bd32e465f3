"""What each kind of look says about the arrival time T, as negative log-likelihoods (hours; torch tensors).

Sources differ: an active-fire detection at t says that something in its footprint burns at t (t - residence <= T <= t);
a no-fire look says that nothing was seen burning at t, which is "not yet" as well as "no longer", or missed; a
burned-area point says only which share of its footprint, of kilometres, had burned by t, with no residence limit.
Cloud gives no look at all, hence no information.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import relu

FALSE_ALARM = 3e-3
SATURATION = 3.0
SHARPNESS = 8.0
FADING = 0.3


def burning(age: Tensor, residence: Tensor, softness_h: float, sharpest_h: float) -> Tensor:
    """How surely a place burns `age` hours after arrival (0..1): from 0 to about `residence`, fading out.

    `softness_h` blurs the window while the fit is coarse; at `sharpest_h` its end still fades over 0.3 residence,
    since cooling ground is seen less and less.
    """
    end = softness_h if softness_h > sharpest_h else sharpest_h + FADING * residence
    return torch.sigmoid(age / softness_h) * torch.sigmoid((residence - age) / end)


def footprint_seen(share: Tensor, detection: Tensor, is_fire: bool) -> Tensor:
    """Cost of (not) seeing fire in footprints of which `share` burns, at a detection rate for a fully burning one.

    A small burning share already lights a thermal pixel (saturation); a false alarm is possible, so that one stray
    detection cannot dominate, and a missed fire is 1 - detection, so that one look without fire proves little.
    """
    rate = detection * (1 - torch.exp(-SATURATION * share))
    return -torch.log(FALSE_ALARM + rate) if is_fire else -torch.log1p(-rate)


def share_burned(share: Tensor, probability: Tensor) -> Tensor:
    """Cost of a footprint's burned share under a stated probability of burned: 0.5 says nothing; how long ago it
    burned does not enter."""
    says = probability.clamp(0.05, 0.95)
    mostly = torch.sigmoid(SHARPNESS * (share - 0.5))
    return -torch.log(says * mostly + (1 - says) * (1 - mostly))


def one_sided(arrival: Tensor, time: Tensor, is_fire: Tensor) -> tuple[Tensor, Tensor]:
    """The paper's penalties (section 5.2), hours: later than a fire seen; earlier than a look that saw no fire."""
    return relu(arrival - time) * is_fire, relu(time - arrival) * (1 - is_fire)
