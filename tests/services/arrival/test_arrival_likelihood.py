"""Each source says what it can say and no more."""

import torch

from services.arrival import likelihood
from services.arrival.network import PaperNetwork, parameter_count

AGE = torch.tensor([[20.0, 4.0, -3.0, -20.0]])  # hours since arrival at the time of the look
RESIDENCE = torch.tensor([[8.0]])
RATE = torch.tensor([[0.6]])


def _share() -> torch.Tensor:
    return likelihood.burning(AGE, RESIDENCE, 0.8, 0.8)


def test_a_detection_wants_the_arrival_within_the_residence_before_it() -> None:
    cost = likelihood.footprint_seen(_share(), RATE, True)[0]
    assert cost.argmin() == 1
    assert cost[3] > 4 and cost[0] > 2


def test_a_stray_detection_costs_no_more_than_a_false_alarm() -> None:
    cost = likelihood.footprint_seen(torch.zeros(1, 1), RATE, True)
    assert float(cost) <= -float(torch.log(torch.tensor(likelihood.FALSE_ALARM))) + 1e-4


def test_a_look_without_fire_forbids_only_burning_now_and_is_bounded() -> None:
    cost = likelihood.footprint_seen(_share(), RATE, False)[0]
    assert cost[1] > 0.7
    assert cost[0] < 0.05, "it may have burned out long ago"
    assert cost[3] < 0.01, "it may not have come yet"
    assert float(cost.max()) <= -float(torch.log(torch.tensor(0.4))) + 1e-6


def test_a_small_burning_part_of_a_pixel_may_be_seen() -> None:
    part, nothing = (likelihood.footprint_seen(torch.full((1, 1), share), RATE, True) for share in (0.15, 0.0))
    assert float(part) < 0.4 * float(nothing)


def test_a_burned_point_says_the_share_burned_by_then_and_nothing_of_when() -> None:
    long_ago, just_now, not_yet = (torch.sigmoid(torch.tensor([[hours / 0.8]])) for hours in (60.0, 6.0, -20.0))
    burned = torch.tensor([0.9])
    costs = [float(likelihood.share_burned(share, burned)) for share in (long_ago, just_now, not_yet)]
    assert abs(costs[0] - costs[1]) < 0.03
    assert costs[2] > costs[0] + 1
    unburned = torch.tensor([0.1])
    assert float(likelihood.share_burned(not_yet, unburned)) < float(likelihood.share_burned(long_ago, unburned)) - 1


def test_a_burned_point_of_even_odds_says_nothing() -> None:
    cost = likelihood.share_burned(torch.tensor([[0.0, 0.3, 1.0]]), torch.full((3,), 0.5))
    assert torch.allclose(cost, cost[0, 0].expand(1, 3), atol=1e-5)


def test_the_papers_penalties_are_one_sided() -> None:
    late, early = likelihood.one_sided(torch.tensor([5.0, -5.0]), torch.zeros(2), torch.ones(2))
    assert late.tolist() == [5.0, 0.0] and early.tolist() == [0.0, 0.0]


def test_the_network_keeps_to_ten_thousand_parameters() -> None:
    assert parameter_count(PaperNetwork(0)) <= 10_000
