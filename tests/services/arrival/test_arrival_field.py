"""The default method's parts: spectral prior, daily clock, footprints, and what the fit recovers."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from services.arrival.field import FieldSettings, fit_field
from services.arrival.footprints import footprints, representative
from services.arrival.looks import FIRE, NO_FIRE, Looks
from services.arrival.spectral import cosine_field, daily
from tests.services.arrival.scored import case_of
from tests.services.arrival.seeds import TESTS
from tests.services.arrival.synthetic_fires import make_fire


def _looks(x: np.ndarray, y: np.ndarray, kind: int = NO_FIRE, radius: float = 0.2) -> Looks:
    same = np.full(x.size, radius)
    kinds = np.full(x.size, kind, np.int8)
    return Looks(x, y, np.zeros(x.size), kinds, np.zeros(x.size, np.int8), np.zeros(x.size), same, same)


def test_the_prior_has_unit_variance_and_forgets_beyond_its_length() -> None:
    field = cosine_field(60, 60, 0.5, 3.0)
    draws = field(torch.randn(600, *field.amplitude.shape, generator=torch.Generator().manual_seed(1)))
    draws = draws.reshape(600, 60, 60)
    assert float(draws[:, 30, 30].std()) == pytest.approx(1.0, abs=0.12)
    centre = draws[:, 30, 30]
    near, far = (float((centre * draws[:, 30, column]).mean()) for column in (31, 52))
    assert near > 0.8 and abs(far) < 0.15


def test_the_clock_keeps_order_days_and_the_mean_hour() -> None:
    steady = torch.linspace(0.0, 96.0, 961)[None]
    wall = daily(steady, torch.tensor([[1.5, -1.0]]))
    assert bool((wall.diff(dim=1) > 0).all())
    assert torch.allclose(wall[:, 240:] - wall[:, :-240], torch.tensor(24.0), atol=1e-3)
    assert float((wall - steady).mean().abs()) < 0.1 and float((wall - steady).abs().max()) > 1.5
    assert torch.allclose(daily(steady, torch.zeros(1, 2)), steady, atol=1e-4)


def test_shares_of_a_footprint_add_up_to_one_and_lie_around_it() -> None:
    x, y = np.meshgrid(np.arange(-3, 3, 0.1), np.arange(-3, 3, 0.1))
    cells = np.column_stack([x.ravel(), y.ravel()])
    pairs = footprints(_looks(np.array([0.03, 1.0]), np.array([0.0, -1.0]), radius=0.5), cells, 0.1)
    assert pairs is not None
    total = pairs.seen(torch.ones(1, pairs.look.numel()))
    assert torch.allclose(total, torch.ones(1, 2), atol=0.03)
    centre = pairs.seen(torch.tensor(cells[pairs.cell.numpy(), 0], dtype=torch.float32)[None])
    assert float(centre[0, 0]) == pytest.approx(0.03, abs=0.02) and float(centre[0, 1]) == pytest.approx(1.0, abs=0.03)
    assert footprints(_looks(np.zeros(0), np.zeros(0)), cells, 0.1) is None


def test_thinned_granules_are_noticed_and_their_looks_stand_for_more() -> None:
    x, y = (part.ravel() for part in np.meshgrid(np.arange(0, 20, 0.375), np.arange(0, 20, 0.375)))
    whole, weight, complete = representative(_looks(x, y))
    assert complete and (weight < 1.1).all() and float(whole.radius_km.max()) < 0.4
    few = np.random.default_rng(1).choice(x.size, x.size // 20, replace=False)
    thin, heavier, complete = representative(_looks(x[few], y[few]))
    assert not complete and (heavier > 1.5).all() and float(thin.radius_km.min()) > 0.5


def test_the_fit_recovers_a_front_that_runs_east() -> None:
    """Detections an hour behind a straight front of 1 km/h, and clear looks ahead of it."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(0, 20, 0.4), np.arange(0, 8, 0.4)))
    fire = replace(_looks(x, y, FIRE), time_h=x + 1.0 + 2.0 * (np.arange(x.size) % 2), probability=np.ones(x.size))
    case = case_of(make_fire(TESTS[5], observations=500))
    ignition = replace(case.ignition, time_h=0.0, x_km=0.0, y_km=4.0)
    field = fit_field(fire, case.grid, ignition, FieldSettings(clock=False), 0)
    line = np.arange(3.0, 18.0, 1.0)
    found = field.at(line, np.full(line.size, 4.0))[0]
    assert np.abs(found - line).mean() < 1.5
    assert np.polyfit(line, found, 1)[0] == pytest.approx(1.0, abs=0.15)
    assert (
        field.margin_at(np.array([10.0, 10.0]), np.array([4.0, 12.0])).tolist()[0]
        > 0
        > field.margin_at(np.array([10.0]), np.array([12.0]))
    )


def test_members_differ_and_are_the_same_again() -> None:
    case = case_of(make_fire(TESTS[5], observations=800))
    settings = FieldSettings(steps=20, members=3)
    first, again = (fit_field(case.looks, case.grid, case.ignition, settings, 4) for _ in range(2))
    np.testing.assert_array_equal(first.arrival_h, again.arrival_h)
    assert float(np.ptp(first.arrival_h, axis=0).max()) > 0.1
