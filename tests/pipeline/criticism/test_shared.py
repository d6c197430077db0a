"""Terms that many units share, from synthetic scores."""

import numpy as np
import pytest

from pipeline.criticism.prevalence import prevalence
from pipeline.criticism.shared import Evidence, SharedTerm, shared, still_needed

ALPHA = 0.003
TERMS = [
    SharedTerm(f"term {i}", (2 * i, 2 * i + 1) if i == 3 else (2 * i,), (0, 0) if i == 3 else (0,)) for i in range(8)
]
WIDTH = 16


def units(n, seed, theta=None, term=0, correlation=0.6, noise=1.0):
    """n units with correlated columns in arbitrary units; theta (n,) is the size of the first column of ``term``."""
    rng = np.random.default_rng(seed)
    root = np.sqrt(correlation) * np.ones((WIDTH, 1))
    gram = root @ root.T + (1.0 - correlation) * np.eye(WIDTH)
    measure = 10.0 ** rng.uniform(-9, 9, WIDTH)
    information = gram[None] * rng.uniform(0.5, 2.0, n)[:, None, None]
    score = np.stack([noise * np.linalg.cholesky(g) @ rng.standard_normal(WIDTH) for g in information])
    if theta is not None:
        score += information[:, :, 2 * term] * np.asarray(theta)[:, None]
    both = np.outer(measure, measure)
    return Evidence(score * measure, information * both, information * both, np.ones(n)), measure


def found(evidence, population=None):
    return shared(evidence, TERMS, population or evidence.score.shape[0], ALPHA)


def name_of(result):
    return None if result.found is None else result.found.name


def test_a_term_shared_at_snr_below_one_is_found_in_two_hundred_units():
    for seed in range(5):
        evidence, measure = units(200, seed, np.full(200, 0.7), term=2)
        result = found(evidence)
        assert name_of(result) == "term 2"
        size, sd = result.found.size[0] * measure[4], result.found.size_sd[0] * measure[4]
        assert abs(size - 0.7) < 4.0 * sd


def test_a_term_whose_sizes_have_either_sign_is_shared():
    rng = np.random.default_rng(5)
    evidence, _ = units(200, 5, rng.choice([-1.3, 1.3], 200), term=2)
    result = found(evidence)
    assert name_of(result) == "term 2"
    assert result.found.log_p_spread < result.found.log_p_common


@pytest.mark.parametrize("score", [5.0, 50.0, 5e3, 5e6])
@pytest.mark.parametrize("n", [1, 2, 12, 200])
def test_a_term_of_a_single_unit_is_never_shared(score, n):
    for seed in range(3):
        theta = np.zeros(n)
        theta[n // 2] = score
        assert found(units(n, seed, theta, term=1)[0]).found is None


def test_a_term_of_six_percent_of_the_population_is_not_shared_even_where_a_sample_holds_all_six():
    # Six of 100 units have the term.  The sample holds these six and ten others, each of which represents 9.4 units.
    theta = np.r_[np.full(6, 40.0), np.zeros(10)]
    evidence, _ = units(16, 3, theta)
    weights = np.r_[np.ones(6), np.full(10, 9.4)]
    evidence = Evidence(evidence.score, evidence.information, evidence.covariance, weights)
    assert found(evidence, 100).found is None


def test_an_odd_unit_does_not_mask_a_term_that_the_others_share():
    theta = np.full(100, 1.0)
    theta[7] = -500.0
    result = found(units(100, 2, theta, term=4)[0])
    assert name_of(result) == "term 4"
    assert result.aside[7]
    assert sum(result.aside) <= 3


def test_the_false_alarm_rate_is_at_most_alpha():
    alpha, trials = 0.1, 300
    names = sum(shared(units(30, s)[0], TERMS, 30, alpha).found is not None for s in range(trials))
    assert names <= alpha * trials


def test_noise_above_its_nominal_level_creates_no_evidence():
    names = sum(found(units(100, s, noise=1.3)[0]).found is not None for s in range(40))
    assert names <= 1


def test_terms_with_the_same_signature_are_the_only_rivals():
    evidence, _ = units(60, 1, np.full(60, 2.0), term=0)
    score, information = evidence.score.copy(), evidence.information.copy()
    # Column 2 (term 1) is column 0 in other units.
    score[:, 2] = 3.0 * score[:, 0]
    information[:, 2, :] = 3.0 * information[:, 0, :]
    information[:, :, 2] = information[:, 2, :]
    information[:, 2, 2] = 9.0 * information[:, 0, 0]
    result = found(Evidence(score, information, information, evidence.weights))
    assert result.found is not None
    assert {result.found.name, *result.rivals} == {"term 0", "term 1"}


def test_a_size_on_the_side_where_the_term_does_not_exist_is_not_shared():
    evidence, _ = units(100, 4, np.full(100, -1.0), term=0)
    sided = [SharedTerm("term 0", (0,), (1,)), *TERMS[1:]]
    result = shared(evidence, sided, 100, ALPHA)
    assert result.found is None or result.found.name != "term 0"


@pytest.mark.parametrize(("share", "sd"), [(1.0, 0.02), (0.4, 0.02), (0.4, 0.3)])
def test_prevalence_and_sizes_are_recovered(share, sd):
    inside = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        present = rng.random(120) < share
        sizes = np.where(present, rng.normal(3e8, 0.3e8, 120), 0.0) + 1e8 * sd * rng.standard_normal(120)
        estimate = prevalence(sizes, np.full(120, 1e8 * sd), np.ones(120))
        inside += estimate.low - 0.01 <= share <= estimate.high + 0.01
        assert abs(estimate.mean - 3e8) < 4.0 * estimate.mean_sd
        assert estimate.spread == pytest.approx(0.3e8, rel=0.6)
    assert inside >= 4


def test_a_term_is_still_needed_only_where_its_fitted_sizes_exceed_their_sd():
    rng = np.random.default_rng(0)
    noise, ones = rng.standard_normal(50), np.ones(50)
    assert not still_needed(noise, ones, ones, 50, ALPHA)
    assert still_needed(noise + 1.5, ones, ones, 50, ALPHA)
