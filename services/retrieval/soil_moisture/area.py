"""How the reflectivity of a whole neighbourhood departs from its mean on a day.

A cell's few looks fall on different spots of it, and differ more by spot than by moisture; what is common to many
cells of a day is moisture. The two therefore have slopes of their own.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.retrieval.ease_grid import ease_grid

FloatArray = NDArray[np.float64]

KERNEL_KM = 75.0  # standard deviation of the Gaussian weight; fronts and drying spells are wider
REACH = 2.5  # kernels within which neighbours count
PRIOR_LOOKS = 3.0  # looks of no anomaly that every neighbourhood starts with


def area_anomaly(cell_days: pd.DataFrame, groups: list[str], resolution_km: int) -> FloatArray:
    """Anomaly (dB) of the neighbourhood of each cell-day, the cell itself among it, (n,).

    ``cell_days`` has ``row``, ``column``, ``anomaly_db`` (the cell's own) and ``count`` (looks); only rows alike in
    ``groups`` (the day, the mode) see each other. Weighted by looks and nearness, drawn to zero where looks are few.
    """
    result = np.zeros(len(cell_days))
    cell_km = ease_grid(resolution_km).cell_m / 1e3
    position = cell_days[["row", "column"]].to_numpy(dtype=np.float64) * cell_km / KERNEL_KM
    value = cell_days["anomaly_db"].to_numpy(dtype=np.float64)
    looks = cell_days["count"].to_numpy(dtype=np.float64)
    for index in cell_days.groupby(groups, sort=True).indices.values():
        result[index] = _smooth(position[index], value[index], looks[index])
    return result


def _smooth(position: FloatArray, value: FloatArray, looks: FloatArray) -> FloatArray:
    tree = cKDTree(position)
    near = tree.sparse_distance_matrix(tree, REACH, output_type="coo_matrix").tocsr()  # itself at a stored 0
    near.data = np.exp(-0.5 * near.data**2)
    return (near @ (looks * value)) / (near @ looks + PRIOR_LOOKS)
