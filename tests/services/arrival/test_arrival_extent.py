"""What the looks say of each cell."""

import numpy as np
import pytest

from services.arrival.extent import closing, gather, paint, reach_and_enclosure, sightings_per_pixel
from services.arrival.grid import FireGrid
from services.arrival.looks import BURNED_AREA, FIRE, NO_FIRE, Looks

GRID = FireGrid(32613, 400_000 + 500 * (np.arange(40) + 0.5), 3_700_000 + 500 * (np.arange(40) + 0.5), 500.0)


def looks(rows: list[tuple[float, float, float, int, float, float]]) -> Looks:
    x, y, t, kind, probability, radius = (np.array(column, float) for column in zip(*rows, strict=True))
    kind = kind.astype(np.int8)
    return Looks(x, y, t, kind, np.zeros_like(kind), probability, radius, radius)


def test_information_tells_unseen_no_fire_and_fire_apart() -> None:
    evidence = gather(GRID, looks([(0.25, 0.25, 5, FIRE, 1, 0.2), (5.25, 5.25, 6, NO_FIRE, 0, 0.2)]))
    assert evidence.information[20, 20] == 2
    assert evidence.information[30, 30] == 1
    assert evidence.information[5, 5] == 0
    assert evidence.latest_h[30, 30] == 6 and np.isnan(evidence.latest_h[5, 5])


def test_footprints_cover_their_area() -> None:
    first = paint(GRID, looks([(0.25, 0.25, 5, FIRE, 1, 2.0)]), "first")
    area = np.isfinite(first).sum() * 0.25
    assert abs(area - np.pi * 4) < 1.5


def test_nothing_burns_far_from_evidence() -> None:
    evidence = gather(GRID, looks([(0.25, 0.25, 5, FIRE, 1, 0.2), (1.25, 0.25, 9, FIRE, 1, 0.2)]))
    assert evidence.enclosed[20, 20] and evidence.enclosed[20, 22]
    assert not evidence.enclosed[evidence.distance_km > 1.0].any()
    assert (evidence.margin_km[evidence.distance_km > 2.0] < -1).all()


def test_a_likely_burned_point_far_from_the_fire_draws_no_second_fire() -> None:
    near, far = (3.25, 0.25, 30, BURNED_AREA, 0.95, 1.0), (9.25, 9.25, 30, BURNED_AREA, 0.95, 1.0)
    evidence = gather(GRID, looks([(0.25, 0.25, 5, FIRE, 1, 0.2), near, far]))
    assert evidence.enclosed[20, 26]
    assert not evidence.enclosed[38, 38]
    doubtful = gather(GRID, looks([(0.25, 0.25, 5, FIRE, 1, 0.2), (3.25, 0.25, 30, BURNED_AREA, 0.4, 1.0)]))
    assert not doubtful.enclosed[20, 26]


def test_closing_fills_narrow_gaps_only_and_never_shrinks() -> None:
    mask = np.zeros((30, 30), bool)
    mask[10:20, 5] = mask[10:20, 9] = mask[10:20, 25] = True
    closed = closing(mask, 3.0)
    assert (closed | ~mask).all()
    assert closed[15, 7] and not closed[15, 17]


def test_a_lone_detection_in_the_corner_of_a_coarse_cell_is_kept() -> None:
    coarse = FireGrid(32613, 400_000 + 2000 * (np.arange(10) + 0.5), 3_700_000 + 2000 * (np.arange(10) + 0.5), 2000.0)
    evidence = gather(coarse, looks([(0.05, 0.05, 5, FIRE, 1, 0.2)]))
    assert evidence.enclosed.sum() == 1


def _pixels(share: float) -> Looks:
    """A burned square of 12 km of which a share of the 375 m pixels was sighted."""
    x, y = (part.ravel() for part in np.meshgrid(np.arange(-6, 6, 0.375), np.arange(-6, 6, 0.375)))
    chosen = np.random.default_rng(1).random(x.size) < share
    return looks([(a, b, 5, FIRE, 1, 0.2116) for a, b in zip(x[chosen], y[chosen], strict=True)])


def test_the_outline_reaches_farther_where_sightings_are_sparse() -> None:
    assert 0.9 < sightings_per_pixel(_pixels(1.0)) < 1.1
    assert 0.2 < sightings_per_pixel(_pixels(0.3)) < 0.45
    (dense_reach, dense_gap), (sparse_reach, sparse_gap) = (reach_and_enclosure(_pixels(s)) for s in (1.0, 0.3))
    assert dense_reach < 0.2 < 0.4 < sparse_reach and dense_gap < sparse_gap


def test_without_fine_sightings_the_outline_is_as_of_sparse_ones() -> None:
    coarse = looks([(0.0, 0.0, 5, FIRE, 1, 1.0)] * 20)
    assert sightings_per_pixel(coarse) == 0.0
    assert reach_and_enclosure(coarse) == pytest.approx((0.45, 3.0))
