"""Past fires of the same kind of place and season, so that a rating can say how unusual it is there and then.

The training table has neither dates nor places. What both it and a case of the loop know is how far the season has
dried (KBDI, thirds of the training fires) and how high the place lies (below 200 m, to 600 m, above): the group of a
fire is that pair, or the season alone where the height is unknown or the pair has fewer than 100 training fires.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

Array = npt.NDArray[np.float64]

SEASONS = ("wet", "drying", "dry")
PLACES = ("lowland", "hills", "upland")
ELEVATION_EDGES_M = (200.0, 600.0)
FEWEST_FIRES = 100
ALL = "all"


@dataclass(frozen=True)
class ReferenceGroups:
    """101 quantiles of the training margins by group (``"dry hills"``, ``"dry"``, ``"all"``), and its fires."""

    kbdi_edges_mm: list[float]
    elevation_edges_m: list[float]
    quantiles: dict[str, list[float]]
    fires: dict[str, int]

    def group(self, kbdi_mm: float, elevation_m: float = float("nan")) -> str:
        """The narrowest known group of a place and season; NaN where unknown."""
        if np.isnan(kbdi_mm) or not self.kbdi_edges_mm:
            return ALL
        season = SEASONS[int(np.searchsorted(self.kbdi_edges_mm, kbdi_mm, side="right"))]
        if not np.isnan(elevation_m):
            pair = f"{season} {PLACES[int(np.searchsorted(self.elevation_edges_m, elevation_m, side='right'))]}"
            if pair in self.quantiles:
                return pair
        return season if season in self.quantiles else ALL

    def percentile(self, margin: float, group: str) -> float:
        """Share of the group's training fires (per cent) that scored lower."""
        known = self.quantiles[group]
        return float(np.interp(margin, known, np.linspace(0, 100, len(known))))


def of_fires(frame: pd.DataFrame, margin: Array) -> ReferenceGroups:
    """The groups of training fires with their margins (n,); elevation_m and kbdi_mm are used where there."""
    drought = frame.get("kbdi_mm", pd.Series(np.nan, index=frame.index)).to_numpy(dtype=np.float64)
    height = frame.get("elevation_m", pd.Series(np.nan, index=frame.index)).to_numpy(dtype=np.float64)
    members = {ALL: np.ones(len(margin), dtype=bool)}
    edges: list[float] = []
    if np.isfinite(drought).any():
        edges = [float(edge) for edge in np.nanquantile(drought, [1 / 3, 2 / 3])]
        stage = np.searchsorted(edges, drought, side="right")
        band = np.searchsorted(ELEVATION_EDGES_M, height, side="right")
        for s, season in enumerate(SEASONS):
            members[season] = (stage == s) & np.isfinite(drought)
            for b, place in enumerate(PLACES):
                members[f"{season} {place}"] = members[season] & (band == b) & np.isfinite(height)
    kept = {name: chosen for name, chosen in members.items() if name == ALL or chosen.sum() >= FEWEST_FIRES}
    quantiles = {
        name: [float(q) for q in np.quantile(margin[chosen], np.linspace(0, 1, 101))] for name, chosen in kept.items()
    }
    return ReferenceGroups(edges, list(ELEVATION_EDGES_M), quantiles, {n: int(c.sum()) for n, c in kept.items()})
