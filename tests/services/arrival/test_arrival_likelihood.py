"""Each source says what it can say and no more."""

import torch

from services.arrival import likelihood
from services.arrival.network import FieldEnsemble, PaperNetwork, parameter_count

ARRIVAL = torch.tensor([-20.0, -4.0, 3.0, 20.0])
TIME = torch.zeros(4)


def test_a_detection_wants_the_arrival_within_the_residence_before_it() -> None:
    cost = likelihood.fire_seen(ARRIVAL, TIME, 8.0, 1.0)
    assert cost.argmin() == 1
    assert cost[3] > 10 and cost[0] > 10


def test_a_look_without_fire_forbids_only_burning_now_and_is_bounded() -> None:
    cost = likelihood.no_fire_seen(ARRIVAL, TIME, 8.0, torch.tensor(0.6), 1.0)
    assert cost[1] > 0.8
    assert cost[0] < 0.01, "it may have burned out long ago"
    assert cost[3] < 0.01, "it may not have come yet"
    assert float(cost.max()) <= -float(torch.log(torch.tensor(0.4))) + 1e-6


def test_a_burned_point_has_no_residence_limit() -> None:
    cost = likelihood.burned_seen(ARRIVAL, TIME, torch.full((4,), 0.9), 1.0)
    assert torch.isclose(cost[0], cost[1], atol=0.03)
    assert cost[3] > cost[0] + 1
    unburned = likelihood.burned_seen(ARRIVAL, TIME, torch.full((4,), 0.1), 1.0)
    assert unburned[3] < unburned[0] - 1


def test_a_burned_point_of_even_odds_says_nothing() -> None:
    cost = likelihood.burned_seen(ARRIVAL, TIME, torch.full((4,), 0.5), 1.0)
    assert torch.allclose(cost, cost[0].expand(4), atol=1e-5)


def test_the_papers_penalties_are_one_sided() -> None:
    late, early = likelihood.one_sided(torch.tensor([5.0, -5.0]), torch.zeros(2), torch.ones(2))
    assert late.tolist() == [5.0, 0.0] and early.tolist() == [0.0, 0.0]


def test_networks_keep_to_ten_thousand_parameters() -> None:
    assert FieldEnsemble(3, 0.3, 0).parameters_per_member() <= 10_000
    assert parameter_count(PaperNetwork(0)) <= 10_000


def test_the_daily_clock_never_runs_backwards() -> None:
    ensemble = FieldEnsemble(1, 0.3, 0)
    ensemble.clock.data = torch.tensor([[30.0, -20.0]])
    hours = ensemble.daily(torch.linspace(0, 96, 2000)[None]).detach()
    assert (hours.diff(dim=1) > 0).all()
    assert float((hours - torch.linspace(0, 96, 2000)).abs().max()) > 2
