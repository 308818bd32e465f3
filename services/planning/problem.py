"""The planning problem in whole seconds: what may be collected, downlinked and powered, and when.

Everything downstream (model, local search, emission) works on this one immutable description. Times are integer seconds
from ``horizon_start``; intervals are half-open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ACTIVE_WEIGHT = 10.0
"""Factor on active-fire rewards in equation 1 of the paper."""


@dataclass(frozen=True)
class SatelliteLimits:
    """Storage, power and availability of one satellite (``spacecraft`` contract; Wh, W, seconds from horizon start)."""

    name: str
    storage_images: int
    downlink_s_per_image: int
    battery_capacity_wh: float
    battery_min_wh: float
    battery_initial_wh: float
    generation_w: float
    nominal_w: float
    collect_w: float
    downlink_w: float
    stored_images_initial: int = 0
    uplink_margin_s: float = 0.0
    unavailable: tuple[tuple[float, float], ...] = ()
    slew: Mapping[str, Mapping[str, int]] | None = None
    """Seconds to turn from one pointing (outer key) to another."""
    pointing_initial: str | None = None


@dataclass(frozen=True)
class Pass:
    """One contact cut to the seconds that lie wholly inside it: satellite and station index, [start_s, end_s)."""

    satellite: int
    station: int
    start_s: int
    end_s: int


@dataclass(frozen=True)
class Targets:
    """Targets in table order: ids, whether active, and value in the objective (10 r for active, r for pre-fire).

    ``pinned`` marks those that a person demands, whatever they are worth (None: none).
    """

    target_id: IntArray
    active: BoolArray
    value: FloatArray
    pinned: BoolArray | None = None

    def demanded(self) -> BoolArray:
        """Mask of the pinned targets."""
        return np.zeros(len(self.value), bool) if self.pinned is None else self.pinned

    def counted(self) -> BoolArray:
        """Mask of the targets that an image may be kept for: rewarded, active or pinned ones."""
        return (self.value > 0) | self.active | self.demanded()


@dataclass(frozen=True)
class Images:
    """Collectable images: id, satellite index, second; covered target indices in CSR form (``start``, ``target``).

    ``pointing`` is the index into `PlanningProblem.pointings` (None: all alike).
    """

    image_id: IntArray
    satellite: IntArray
    second: IntArray
    start: IntArray
    target: IntArray
    pointing: IntArray | None = None

    def pointing_of(self) -> IntArray:
        """Pointing index of every image."""
        return np.zeros(len(self), np.int64) if self.pointing is None else self.pointing

    def __len__(self) -> int:
        return len(self.image_id)

    def covered(self, image: int) -> IntArray:
        """Target indices that one image covers."""
        return self.target[self.start[image] : self.start[image + 1]]

    def image_of_entry(self) -> IntArray:
        """Image index of every CSR entry, aligned with ``target``."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))


@dataclass(frozen=True)
class Frozen:
    """Commands of the previous plan that still run: collects (rows) and the station of every downlink second.

    ``image`` is the index into `Images` of a frozen collect, or -1 where the new opportunities do not know it.
    ``downlink`` is (satellites, seconds) with the station index or -1. ``dropped`` counts previous command seconds
    that the spacecraft could not execute (empty or full storage, lost contact, low battery). ``pointing`` is that of
    every collect (index into `PlanningProblem.pointings`, -1: unknown; None: agility is off).
    """

    satellite: IntArray
    second: IntArray
    image: IntArray
    image_id: IntArray
    downlink: NDArray[np.int16]
    dropped: int = 0
    pointing: IntArray | None = None


@dataclass(frozen=True)
class PlanningProblem:
    """A complete, validated planning case; see `services.planning.building.build_problem`."""

    horizon_start: pd.Timestamp
    horizon_s: int
    satellites: tuple[SatelliteLimits, ...]
    stations: tuple[str, ...]
    passes: tuple[Pass, ...]
    sunlit: BoolArray
    commandable: BoolArray
    images: Images
    targets: Targets
    frozen: Frozen
    uplink_contact: tuple[pd.Timestamp | None, ...]
    opportunity_count: IntArray
    """Images per target in the table, commandable or not: tells 'never seen' from 'seen at the wrong time'."""
    first_s: IntArray | None = None
    """First second of each satellite at which new commands may start (None: the first)."""
    pointings: tuple[str, ...] = ()
    """Names of the pointings that images are taken under (none: agility is off)."""

    def commands_from(self) -> IntArray:
        """First second of each satellite at which new commands may start."""
        return np.zeros(len(self.satellites), np.int64) if self.first_s is None else self.first_s

    @property
    def frozen_images(self) -> IntArray:
        """Indices of images already committed by the previous plan."""
        return self.frozen.image[self.frozen.image >= 0]

    def covered_targets(self, images: IntArray) -> BoolArray:
        """Mask over targets of those that at least one of ``images`` covers."""
        mask = np.zeros(len(self.targets.value), bool)
        chosen = np.zeros(len(self.images), bool)
        chosen[images] = True
        mask[self.images.target[chosen[self.images.image_of_entry()]]] = True
        return mask

    def objective(self, images: IntArray) -> float:
        """Equation 1 for a set of collected images."""
        return float(self.targets.value[self.covered_targets(images)].sum())
