"""How the reflectivity of a whole neighbourhood departs from its mean on a day.

A cell's few looks fall on different spots of it, and differ more by spot than by moisture; what is common to many
cells of a day is moisture. The two therefore have slopes of their own.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from services.retrieval.ease_grid import ease_grid

FloatArray = NDArray[np.float64]

KERNEL_KM = 75.0  # standard deviation of the Gaussian weight; fronts and drying spells are wider
REACH = 2.5  # kernels within which neighbours count
MAX_DENSE = 1500
PRIOR_LOOKS = 3.0  # looks of no anomaly that every neighbourhood starts with


class Neighbourhoods:
    """Who lies near whom among cell-days (``row``, ``column``, ``count``); only rows alike in ``groups`` (the day, the
    mode) see each other.
    """

    def __init__(self, cell_days: pd.DataFrame, groups: list[str], resolution_km: int) -> None:
        cell_km = ease_grid(resolution_km).cell_m / 1e3
        position = cell_days[["row", "column"]].to_numpy(dtype=np.float64) * cell_km / KERNEL_KM
        self._looks = cell_days["count"].to_numpy(dtype=np.float64)
        self._parts = [
            (index, _nearness(position[index])) for index in cell_days.groupby(groups, sort=True).indices.values()
        ]

    def anomaly(self, own_db: FloatArray) -> FloatArray:
        """Anomaly (dB) of the neighbourhood of each cell-day, the cell's own among it, (n,): weighted by looks and
        nearness, drawn to zero where looks are few.
        """
        result = np.zeros(len(self._looks))
        for index, near in self._parts:
            looks = self._looks[index]
            result[index] = (near @ (looks * own_db[index])) / (near @ looks + PRIOR_LOOKS)
        return result


def area_anomaly(cell_days: pd.DataFrame, groups: list[str], resolution_km: int) -> FloatArray:
    """``Neighbourhoods.anomaly`` of the column ``anomaly_db``, (n,)."""
    own_db = cell_days["anomaly_db"].to_numpy(dtype=np.float64)
    return Neighbourhoods(cell_days, groups, resolution_km).anomaly(own_db)


def _nearness(position: FloatArray) -> FloatArray | csr_matrix:
    """Gaussian weights between all rows (n, n); sparse where there are many."""
    if len(position) <= MAX_DENSE:
        squared = cdist(position, position, "sqeuclidean")
        return np.where(squared <= REACH**2, np.exp(-0.5 * squared), 0.0)
    tree = cKDTree(position)
    near = tree.sparse_distance_matrix(tree, REACH, output_type="coo_matrix").tocsr()  # itself at a stored 0
    near.data = np.exp(-0.5 * near.data**2)
    return near
