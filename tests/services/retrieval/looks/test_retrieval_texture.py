"""Texture against scikit-image; shape features against maps whose shape is known."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.feature import graycomatrix, graycoprops

from services.retrieval.looks.features import SHAPE_FEATURES, shape_features, texture_features
from services.retrieval.looks.texture import LEVELS, quantise, texture


def _scikit(grey: np.ndarray) -> np.ndarray:
    matrix = graycomatrix(grey, [1], np.deg2rad([0, 45, 90, 135]), LEVELS, symmetric=True, normed=True)
    share = matrix[:, :, 0]
    entropy = -np.sum(share * np.log(np.where(share > 0, share, 1.0)), axis=(0, 1))
    return np.stack([graycoprops(matrix, "dissimilarity")[0], entropy, graycoprops(matrix, "correlation")[0]], axis=1)


@pytest.mark.parametrize("shape", [(17, 11), (69, 111)])
def test_texture_equals_scikit_image(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    smooth = np.cumsum(rng.standard_normal((30, *shape)), axis=2)
    maps = np.concatenate([smooth, rng.gamma(2.0, 1.0, (30, *shape))])
    grey = quantise(maps)
    assert grey.min() == 0 and grey.max() == LEVELS - 1
    expected = np.stack([_scikit(one) for one in grey])
    assert np.abs(texture(grey) - expected).max() < 1e-6


def test_flat_map_has_no_texture() -> None:
    grey = quantise(np.ones((1, 17, 11)))
    assert np.allclose(texture(grey)[0], _scikit(grey[0]))
    assert np.allclose(texture(grey)[0], [[0.0, 0.0, 1.0]] * 4)


def test_quantising_is_linear_between_the_extremes() -> None:
    levels = quantise(np.linspace(-3.0, 5.0, 17 * 11).reshape(1, 17, 11)).ravel()
    assert np.array_equal(levels, np.minimum(np.linspace(0, 16, 187).astype(int), 15))


def test_texture_features_are_mean_and_range_over_angles() -> None:
    maps = np.random.default_rng(0).gamma(2.0, 1.0, (5, 17, 11))
    angles = texture(quantise(maps))
    assert np.allclose(texture_features(maps), np.hstack([angles.mean(1), angles.max(1) - angles.min(1)]))


def _response(delay_step: float, doppler_step: float, shape: tuple[int, int]) -> np.ndarray:
    delay = (np.arange(shape[0]) - shape[0] // 2) * delay_step
    doppler = (np.arange(shape[1]) - shape[1] // 2) * doppler_step
    return np.maximum(1 - np.abs(delay), 0)[:, None] ** 2 * np.sinc(doppler * 1e-3)[None, :] ** 2


def test_shape_of_a_pure_coherent_reflection_is_that_of_the_ambiguity_function() -> None:
    """Half-power widths of tri^2 and sinc^2: 2 (1 - 1/sqrt 2) = 0.586 chips, 0.886 kHz; the same for both map sizes."""
    fine = shape_features(_response(0.0638, 50.0, (69, 111))[None], 0.0638, 50.0)[0]
    coarse = shape_features(_response(0.2552, 500.0, (17, 11))[None], 0.2552, 500.0)[0]
    names = list(SHAPE_FEATURES)
    assert fine[names.index("delay_width_chips")] == pytest.approx(0.586, abs=0.064)
    assert fine[names.index("doppler_width_hz")] == pytest.approx(886.0, abs=50.0)
    for name in ("leading_slope", "trailing_slope"):
        assert fine[names.index(name)] == pytest.approx(1.0, abs=0.01)
        assert coarse[names.index(name)] == pytest.approx(1.0, abs=0.01)
    assert coarse[names.index("volume_far")] == pytest.approx(fine[names.index("volume_far")], abs=0.35)


def test_spreading_power_lowers_coherence_and_widens_the_map() -> None:
    mirror = _response(0.2552, 500.0, (17, 11))
    tail = np.exp(-np.maximum(np.arange(17) - 8, 0) / 3.0)[:, None] * np.where(np.arange(17) >= 8, 1.0, 0.0)[:, None]
    spread = 0.4 * mirror + 0.6 * tail * np.ones((1, 11))
    both = shape_features(np.stack([mirror, spread]), 0.2552, 500.0)
    names = list(SHAPE_FEATURES)
    assert both[1, names.index("coherence")] < 0.5 * both[0, names.index("coherence")]
    assert both[1, names.index("doppler_spread_hz")] > both[0, names.index("doppler_spread_hz")]
    assert both[1, names.index("trailing_slope")] < both[0, names.index("trailing_slope")]
