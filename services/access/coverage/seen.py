"""What a receiver's images cover of one set of places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.access.coverage.revisit import Visits, join_visits, visits
from services.access.coverage.search import Coverage
from services.access.specular.tracks import SpecularTrack

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """What a receiver's images cover: a row per image and place (input row), in order of time, then place.

    Of the point of highest gain that covers it: transmitter's index, incidence, distance, gain. ``ahead``, ``behind``:
    still covered at that along-track error (km); None where it was not asked for or no error is known. ``count`` rows
    and ``images`` there are, even where the rows were let go.
    """

    count: int
    images: int
    visits: Visits

    time_index: NDArray[np.int32]
    row: NDArray[np.int32]
    transmitter: NDArray[np.int16]
    incidence_deg: Array
    distance_km: Array
    rx_gain_dbi: Array
    nearest_km: NDArray[np.float32]
    ahead: NDArray[np.bool_] | None = None
    behind: NDArray[np.bool_] | None = None
    error_km: Array | None = None

    def without_rows(self) -> Seen:
        """The same, its rows let go."""
        empty = {name: value[:0] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **(empty | {"nearest_km": self.nearest_km}))


def seen_from(used: SpecularTrack, coverage: Coverage, step_s: int) -> Seen:
    """Coverage with the points' own figures; nothing said of errors."""
    point = coverage.point
    return Seen(
        len(coverage.row),
        int((np.diff(coverage.time_index, prepend=-1) != 0).sum()),
        visits(coverage.time_index, coverage.row, step_s),
        coverage.time_index,
        coverage.row,
        used.transmitter[point].astype(np.int16),
        used.incidence_deg[point],
        coverage.distance_km,
        used.rx_gain_dbi[point],
        coverage.nearest_km,
    )


def join_seen(parts: Sequence[Seen], step_s: int) -> Seen:
    """One receiver's parts of the horizon, in order of time, as one."""
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, value in vars(parts[0]).items()
        if isinstance(value, np.ndarray) and name != "nearest_km"
    }
    return replace(
        parts[0],
        count=sum(part.count for part in parts),
        images=sum(part.images for part in parts),
        visits=join_visits([part.visits for part in parts], step_s),
        nearest_km=np.minimum.reduce([part.nearest_km for part in parts]),
        **joined,
    )
