"""R-hat and ESS against arviz_stats and the closed form of an autoregressive process; independence chains against emcee."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from arviz_stats.base.array import array_stats
from emcee.model import Model
from scipy.signal import lfilter

from pipeline.inference.screening.convergence import rhat_and_ess, split_chains
from pipeline.inference.screening.sample import _independence_chains, _log_t, _t_draws


def autoregressive(a, shape, random):
    """Stationary x[k] = a x[k-1] + e[k] along the second axis."""
    e = random.standard_normal(shape)
    e[:, 0] /= np.sqrt(1.0 - a**2)
    return lfilter([1.0], [1.0, -a], e, axis=1)


@pytest.mark.parametrize("a", [0.0, 0.6, 0.95, -0.4])
@pytest.mark.parametrize("shape", [(4, 1250, 12), (5, 101, 3), (4, 8, 2)])
def test_rhat_and_ess_equal_those_of_arviz(a, shape):
    draws = autoregressive(a, shape, np.random.default_rng(5))
    draws[0] += 0.3
    series, (rhat, ess) = np.moveaxis(draws, -1, 0), rhat_and_ess(split_chains(draws))
    np.testing.assert_allclose(rhat, array_stats.rhat(series, method="split"), rtol=1e-12)
    np.testing.assert_allclose(ess, array_stats.ess(series, method="mean"), rtol=1e-9)


def test_the_ess_of_an_autoregressive_process_is_n_times_1_minus_a_over_1_plus_a():
    a = 0.7
    draws = autoregressive(a, (4, 20_000, 40), np.random.default_rng(6))
    found = rhat_and_ess(split_chains(draws))[1] / (80_000 * (1.0 - a) / (1.0 + a))
    # The sd of one estimate is about 4 %; the mean of 40 is known to 0.6 %, with a bias of the truncation of 1 %.
    assert np.mean(found) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("at", [0.0, 0.1, -1e3])
def test_a_chain_that_does_not_move_has_the_ess_of_independent_draws(at):
    still = np.full((4, 100, 1), at)
    rhat, ess = rhat_and_ess(split_chains(still))
    assert ess == 400.0
    # Rounding of the mean of other numbers leaves a variance.
    assert at != 0.0 or np.isnan(rhat).all()


class Chances:
    """What emcee's move draws to accept: the given uniform numbers, step by step."""

    def __init__(self, steps):
        self.steps = iter(steps)

    def rand(self, count):
        numbers = next(self.steps)
        assert numbers.size == count
        return numbers


def test_independence_chains_are_those_of_emcee():
    def log_density(x):
        return -0.5 * np.sum(x**2, axis=1) - 0.1 * np.abs(x[:, 0]) ** 3

    ensembles, walkers, size, steps = 3, 40, 5, 30
    start = np.random.default_rng(7).normal(size=(ensembles, walkers, size))
    density = log_density(start.reshape(-1, size)).reshape(ensembles, walkers)
    seed = np.random.SeedSequence(8)
    points, accepted = _independence_chains(log_density, start, density, steps, slice(None), seed)
    random = np.random.Generator(np.random.SFC64(8))
    proposals = _t_draws(steps * ensembles * walkers, size, random).reshape(steps, ensembles, walkers, size)
    chances = random.random((steps, ensembles, walkers))
    for e in range(ensembles):
        proposed = iter(proposals[:, e])

        def propose(x, random, proposed=proposed):
            y = next(proposed)
            return y, _log_t(x) - _log_t(y)

        move, chance = emcee.moves.MHMove(propose), Chances(chances[:, e])
        state = emcee.State(start[e], log_prob=log_density(start[e]))
        model = Model(log_density, lambda x: (log_density(x), None), map, chance)
        shares = np.zeros(walkers)
        for step in range(steps):
            state, moved = move.propose(model, state)
            shares += moved
            np.testing.assert_array_equal(points[e, :, step], state.coords)
        assert accepted[e] == pytest.approx(shares.mean() / steps)
        assert 0.5 < accepted[e] < 1.0
