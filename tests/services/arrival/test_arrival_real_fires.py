"""Real outlines and simulated WRF-SFIRE fires: the extent that the default method must not lose again."""

from pathlib import Path

import numpy as np

from services.arrival.fires import map_case
from services.arrival.inference import DEFAULT_METHOD
from tests.services.arrival.mapped_fires import OutlineScore, compare, score_outlines
from tests.services.arrival.scored import case_of, score, truth_on
from tests.services.arrival.seeds import TESTS
from tests.services.arrival.wrf_sfire_fires import arrival_maps, wrf_sfire_fire


def test_small_simulated_fires_keep_their_outline(real_data: Path) -> None:
    found = []
    for index in (2, 4):
        fire = wrf_sfire_fire(arrival_maps(real_data)[index], TESTS[index])
        case = case_of(fire, 100.0)
        found.append(score(map_case(case, DEFAULT_METHOD, 0), truth_on(case, fire)))
    assert np.mean([entry.f1 for entry in found]) > 0.7
    assert np.mean([entry.mae_h for entry in found]) < 8.0


def test_the_tunnel_fires_outlines_are_met_better_than_by_support_vectors(real_data: Path) -> None:
    scores = compare(real_data, "Tunnel", (DEFAULT_METHOD, "svm"))
    ours, peer = (np.mean([entry.sorensen for entry in scores[method]]) for method in (DEFAULT_METHOD, "svm"))
    assert len(scores["svm"]) == 4
    assert ours > 0.75 and ours > peer


def test_a_fire_without_any_detection_is_not_scored(real_data: Path) -> None:
    assert compare(real_data, "Cooks Peak", (DEFAULT_METHOD,)) == {}


def test_an_outline_is_reached_only_within_its_bracket() -> None:
    from types import SimpleNamespace

    from tests.services.arrival.mapped_fires import Outline

    inside = np.zeros((5, 5), bool)
    inside[1:4, 1:4] = True
    fresh = inside.copy()
    fresh[2, 2] = False
    outline = Outline(inside, fresh, 10.0, 20.0, 26.0)
    case = SimpleNamespace(end_h=50.0)

    def scored(hours: float) -> OutlineScore:
        arrival = SimpleNamespace(arrival_h=np.where(inside, hours, np.nan))
        return score_outlines(case, arrival, [outline])[0]

    assert scored(18.0) == OutlineScore(1.0, 0.0, 1.0)
    assert scored(7.0) == OutlineScore(0.0, 3.0, 1.0)
    assert scored(30.0) == OutlineScore(0.0, 4.0, 0.0)
