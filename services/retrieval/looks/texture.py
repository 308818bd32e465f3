"""Grey-level co-occurrence texture of delay-Doppler maps: dissimilarity, entropy and correlation in four angles.

Haralick et al. 1973, IEEE Trans. SMC 3(6); definitions as in scikit-image's ``graycomatrix(symmetric=True,
normed=True)`` and ``graycoprops`` (entropy in nats). Dissimilarity and correlation are sums over pixel pairs; only
entropy needs the matrix, and only the cells of it that were touched are visited and cleared.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

LEVELS = 16
ANGLES_DEG = (0, 45, 90, 135)
# (row, column) steps of scikit-image: round(sin(angle)), round(cos(angle))
STEPS = np.array([(0, 1), (1, 1), (1, 0), (1, -1)], dtype=np.int64)
PROPERTIES = ("dissimilarity", "entropy", "correlation")


@numba.njit(cache=True)
def _quantise(maps, levels):
    """Grey levels 0..levels-1 between each map's minimum and maximum; a flat map is all zero."""
    count, rows, columns = maps.shape
    grey = np.zeros(maps.shape, np.uint8)
    for n in range(count):
        low = maps[n, 0, 0]
        high = low
        for i in range(rows):
            for j in range(columns):
                value = maps[n, i, j]
                low = min(low, value)
                high = max(high, value)
        if high > low:
            scale = levels / (high - low)
            for i in range(rows):
                for j in range(columns):
                    grey[n, i, j] = min(np.int64((maps[n, i, j] - low) * scale), levels - 1)
    return grey


@numba.njit(cache=True)
def _texture(grey, levels, steps):
    count, rows, columns = grey.shape
    result = np.empty((count, steps.shape[0], 3), np.float64)
    matrix = np.zeros(levels * levels, np.int64)
    touched = np.empty(levels * levels, np.int64)
    for n in range(count):
        for a in range(steps.shape[0]):
            down, right = steps[a, 0], steps[a, 1]
            pairs, cells, total, squares, products, differences = 0, 0, 0, 0, 0, 0
            for i in range(rows - down):
                for j in range(max(0, -right), columns - max(0, right)):
                    first = np.int64(grey[n, i, j])
                    second = np.int64(grey[n, i + down, j + right])
                    pairs += 1
                    total += first + second
                    squares += first * first + second * second
                    products += first * second
                    differences += abs(first - second)
                    cell = min(first, second) * levels + max(first, second)
                    if matrix[cell] == 0:
                        touched[cells] = cell
                        cells += 1
                    matrix[cell] += 1
            entropy = 0.0
            for k in range(cells):
                cell = touched[k]
                share = matrix[cell] / pairs
                matrix[cell] = 0
                if cell // levels != cell % levels:
                    entropy -= share * np.log(share / 2.0)  # split over the cell and its mirror
                else:
                    entropy -= share * np.log(share)
            mean = total / (2.0 * pairs)
            variance = squares / (2.0 * pairs) - mean * mean
            covariance = products / pairs - mean * mean
            result[n, a, 0] = differences / pairs
            result[n, a, 1] = entropy
            result[n, a, 2] = covariance / variance if variance > 1e-15 else 1.0
    return result


def quantise(maps: NDArray, levels: int = LEVELS) -> NDArray[np.uint8]:
    """Grey levels 0..levels-1, (n, delay, Doppler), linear between each map's own minimum and maximum."""
    return _quantise(np.ascontiguousarray(maps), levels)


def texture(grey: NDArray[np.uint8], levels: int = LEVELS) -> NDArray[np.float64]:
    """Texture (n, angle, property) of grey-level maps (n, rows, columns); angles 0, 45, 90, 135 deg, distance 1.

    Properties in the order dissimilarity, entropy (nats), correlation (1 for a flat map, as in scikit-image).
    """
    return _texture(np.ascontiguousarray(grey, dtype=np.uint8), levels, STEPS)
