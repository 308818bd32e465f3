"""What a burned-area look says beyond what burns anyway: Bayes, and nothing where it says nothing."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from services.prioritization.prefire.burn_evidence import excess_probability, log_likelihood_ratio


def looks(probability: list[float], prior: float | None) -> pd.DataFrame:
    frame = pd.DataFrame({"burned_probability": probability})
    return frame if prior is None else frame.assign(prior_probability=prior)


def test_a_look_at_its_prior_says_nothing() -> None:
    assert log_likelihood_ratio(looks([0.04], 0.04)) == pytest.approx([0.0])
    assert excess_probability(looks([0.04, 0.01], 0.04)) == pytest.approx([0.0, 0.0])


def test_the_ratio_takes_any_prior_to_its_posterior() -> None:
    """P(look | burned) 0.3 and P(look | unburned) 0.02, seen under two priors, are one and the same evidence."""
    for prior in (0.04, 0.5):
        posterior = 0.3 * prior / (0.3 * prior + 0.02 * (1 - prior))
        assert log_likelihood_ratio(looks([posterior], prior)) == pytest.approx([np.log(15.0)])


def test_a_table_without_prior_is_taken_at_even_odds() -> None:
    assert log_likelihood_ratio(looks([0.5], None)) == pytest.approx([0.0])
    assert excess_probability(looks([1.0], None)) == pytest.approx([1.0])


def test_certainty_is_bounded() -> None:
    assert np.abs(log_likelihood_ratio(looks([0.0, 1.0], 0.04))).max() <= 5.0
