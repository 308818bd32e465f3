"""The support vector machine: roots of its decision function, its kernel, and a front it must find."""

import numpy as np
import pytest

from services.arrival.looks import FIRE, NO_FIRE, Looks
from services.arrival.svm import SvmSettings, first_root, fit_svm
from shared.errors import DomainError


def _front(no_fire: bool = True) -> Looks:
    """A front that runs east at 1 km/h from x = 0: burning up to 4 km behind it, clear ahead of it."""
    rng = np.random.default_rng(1)
    x, y, t = rng.uniform(0, 30, 4000), rng.uniform(0, 10, 4000), np.repeat(np.arange(2.0, 30.0, 2.8), 400)
    burning = (x <= t) & (x > t - 4)
    kept = burning | (x > t) if no_fire else burning
    kind = np.where(burning, FIRE, NO_FIRE).astype(np.int8)[kept]
    radius = np.full(kind.size, 0.2)
    return Looks(x[kept], y[kept], t[kept], kind, np.zeros_like(kind), (kind == FIRE).astype(float), radius, radius)


def test_the_first_root_of_several_counts() -> None:
    time = np.linspace(0, 1, 60)
    values = np.vstack([np.cos(4 * np.pi * time + np.pi), time - 0.3, -np.ones(60), np.ones(60)])
    roots = first_root(time, values)
    assert roots[0] == pytest.approx(0.125, abs=2e-3)
    assert roots[1] == pytest.approx(0.3, abs=1e-3)
    assert np.isnan(roots[2]) and roots[3] == 0.0


def test_the_factored_decision_function_is_the_machines_own() -> None:
    from sklearn.metrics.pairwise import rbf_kernel

    surface = fit_svm(_front(), SvmSettings(), 0)
    place, time = np.array([[0.2, 0.5], [0.7, 0.1]]), np.array([0.1, 0.5, 0.9])
    points = np.array([[*where, when] for where in place for when in time])
    plain = rbf_kernel(points, surface.support, gamma=surface.gamma) @ surface.coefficients + surface.intercept
    np.testing.assert_allclose(surface.decision(place, time).ravel(), plain, atol=1e-8)


def test_it_finds_a_straight_front() -> None:
    surface = fit_svm(_front(), SvmSettings(gamma_factor=4.0), 0)
    line = np.arange(6.0, 25.0)
    found = surface.at(line, np.full(line.size, 5.0))
    assert np.abs(found - line).mean() < 2.5
    assert np.isnan(surface.at(np.array([300.0]), np.array([5.0]))).all()


def test_same_seed_same_surface() -> None:
    first, again = (fit_svm(_front(), SvmSettings(most_points=600), 3) for _ in range(2))
    np.testing.assert_array_equal(first.support, again.support)


def test_one_class_is_refused_unless_artificial_points_make_the_other() -> None:
    with pytest.raises(DomainError) as caught:
        fit_svm(_front(no_fire=False), SvmSettings(sheet=0), 0)
    assert caught.value.field == "detections"
    assert fit_svm(_front(no_fire=False), SvmSettings(), 0).support.size > 0
