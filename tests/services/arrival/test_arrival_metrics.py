"""Scores against hand-worked and sampled figures."""

import numpy as np
import pytest

from services.arrival import metrics


def test_errors_count_cells_burned_in_both() -> None:
    mae, bias = metrics.mean_error_h(np.array([1.0, 5.0, np.nan]), np.array([2.0, 2.0, 3.0]))
    assert (mae, bias) == (2.0, 1.0)


def test_sorensen_of_half_overlap() -> None:
    assert metrics.sorensen(np.array([1, 1, 0, 0], bool), np.array([0, 1, 1, 0], bool)) == 0.5
    assert metrics.sorensen(np.zeros(3, bool), np.zeros(3, bool)) == 1.0


def test_crps_of_a_normal_agrees_with_its_sampled_definition() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.normal(2.0, 3.0, 400_000), rng.normal(2.0, 3.0, 400_000)
    sampled = np.abs(first - 4.0).mean() - 0.5 * np.abs(first - second).mean()
    value = metrics.crps_normal_h(np.array([2.0]), np.array([3.0]), np.array([4.0]))
    assert value == pytest.approx(sampled, rel=0.01)


def test_coverage() -> None:
    assert metrics.interval_coverage(np.array([0.0, 0.0]), np.array([1.0, 1.0]), np.array([0.5, 2.0])) == 0.5
