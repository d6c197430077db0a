"""Terms that many units share: scores made by hand, no physics."""

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
    """n units with correlated columns of unit information (in odd units of measurement), theta (n,) of the first column."""
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


def name_of(seen):
    return None if seen.found is None else seen.found.name


def test_two_hundred_units_of_snr_below_one_show_what_they_share():
    for seed in range(5):
        evidence, measure = units(200, seed, np.full(200, 0.7), term=2)
        seen = found(evidence)
        assert name_of(seen) == "term 2"
        size, sd = seen.found.size[0] * measure[4], seen.found.size_sd[0] * measure[4]
        assert abs(size - 0.7) < 4.0 * sd


def test_sizes_of_either_sign_are_shared_too():
    rng = np.random.default_rng(5)
    evidence, _ = units(200, 5, rng.choice([-1.3, 1.3], 200), term=2)
    seen = found(evidence)
    assert name_of(seen) == "term 2"
    assert seen.found.log_p_spread < seen.found.log_p_common


@pytest.mark.parametrize("score", [5.0, 50.0, 5e3, 5e6])
@pytest.mark.parametrize("n", [1, 2, 12, 200])
def test_one_odd_unit_is_never_promoted(score, n):
    for seed in range(3):
        theta = np.zeros(n)
        theta[n // 2] = score
        assert found(units(n, seed, theta, term=1)[0]).found is None


def test_a_few_odd_units_of_many_are_not_promoted_even_where_only_the_odd_are_looked_at():
    # Six of 100 units carry it; the six and a sample of ten were looked at, each of which stands for nine.
    theta = np.r_[np.full(6, 40.0), np.zeros(10)]
    evidence, _ = units(16, 3, theta)
    weights = np.r_[np.ones(6), np.full(10, 9.4)]
    evidence = Evidence(evidence.score, evidence.information, evidence.covariance, weights)
    assert found(evidence, 100).found is None


def test_an_odd_unit_does_not_mask_what_the_others_share():
    theta = np.full(100, 1.0)
    theta[7] = -500.0
    seen = found(units(100, 2, theta, term=4)[0])
    assert name_of(seen) == "term 4"
    assert seen.aside[7]
    assert sum(seen.aside) <= 3


def test_the_null_is_called_shared_at_most_as_often_as_said():
    alpha, trials = 0.1, 300
    names = sum(shared(units(30, s)[0], TERMS, 30, alpha).found is not None for s in range(trials))
    assert names <= alpha * trials


def test_noise_that_is_everywhere_stronger_than_said_makes_no_evidence():
    names = sum(found(units(100, s, noise=1.3)[0]).found is not None for s in range(40))
    assert names <= 1


def test_terms_of_one_shape_are_rivals_and_others_are_not():
    evidence, _ = units(60, 1, np.full(60, 2.0), term=0)
    score, information = evidence.score.copy(), evidence.information.copy()
    # Column 2 (term 1) is column 0 in other units.
    score[:, 2] = 3.0 * score[:, 0]
    information[:, 2, :] = 3.0 * information[:, 0, :]
    information[:, :, 2] = information[:, 2, :]
    information[:, 2, 2] = 9.0 * information[:, 0, 0]
    seen = found(Evidence(score, information, information, evidence.weights))
    assert seen.found is not None
    assert {seen.found.name, *seen.rivals} == {"term 0", "term 1"}


def test_a_size_where_the_term_does_not_exist_is_not_its_size():
    evidence, _ = units(100, 4, np.full(100, -1.0), term=0)
    sided = [SharedTerm("term 0", (0,), (1,)), *TERMS[1:]]
    seen = shared(evidence, sided, 100, ALPHA)
    assert seen.found is None or seen.found.name != "term 0"


@pytest.mark.parametrize(("share", "sd"), [(1.0, 0.02), (0.4, 0.02), (0.4, 0.3)])
def test_the_share_that_carries_and_its_sizes_are_recovered(share, sd):
    inside = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        carries = rng.random(120) < share
        sizes = np.where(carries, rng.normal(3e8, 0.3e8, 120), 0.0) + 1e8 * sd * rng.standard_normal(120)
        told = prevalence(sizes, np.full(120, 1e8 * sd), np.ones(120))
        inside += told.low - 0.01 <= share <= told.high + 0.01
        assert abs(told.mean - 3e8) < 4.0 * told.mean_sd
        assert told.spread == pytest.approx(0.3e8, rel=0.6)
    assert inside >= 4


def test_fitted_sizes_that_are_noise_are_not_needed_and_true_ones_are():
    rng = np.random.default_rng(0)
    noise, ones = rng.standard_normal(50), np.ones(50)
    assert not still_needed(noise, ones, ones, 50, ALPHA)
    assert still_needed(noise + 1.5, ones, ones, 50, ALPHA)
