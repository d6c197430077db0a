"""Posterior of a device: E ensembles of n walkers, L + B steps, P = 14 parameters, J = 36 features of a sense, r = 16 rows."""

import numpy as np
from bench.device import device
from bench.naive import log_posterior

from pipeline.inference.screening.batch import local_rows, whole_rows
from pipeline.inference.screening.sample import sample
from workflows.screening.settings import POSTERIOR_STREAM, device_seed

PART = "posterior"
WALKERS, STEPS, SHORT = 32, 2000, 10


def of_device():
    d, one = device(), device().fitted[0]
    return d, one.scoring, one.sampler


def start_points(fit, random):
    return random.multivariate_normal(fit.x, fit.covariance, size=WALKERS, method="eigh")


def test_part_posterior(timed):
    d, scoring, sampler = of_device()
    fit, size = scoring.fit, scoring.fit.x.size
    points = sampler.ensembles * sampler.walkers
    moves = points * (sampler.steps + sampler.burn)
    calls = moves + points
    rows, features = local_rows(fit.likelihood, fit.x).design.shape
    found = timed.part(
        PART,
        lambda: sample(fit, sampler, device_seed(d.config, POSTERIOR_STREAM, 0)),
        {"normal": size * calls, "flop": calls * 2 * rows * features},
        "E n (L + B + 1) calls of P normals and 4 r J flops",
    )
    assert found.move == "laplace"
    assert found.ess > 1000.0


def test_peer_emcee(timed):
    import emcee

    d, scoring, _ = of_device()
    (data,) = scoring.data
    start = start_points(scoring.fit, np.random.default_rng(4))
    fit = scoring.fit
    # The plain likelihood is that of the compressed one, up to a constant.
    moved = fit.x + 2.0 * np.sqrt(np.diag(fit.covariance)) * np.eye(fit.x.size)[0]
    ours = np.diff(whole_rows(fit.likelihood).log_likelihood(np.stack([fit.x, moved])))[0]
    plain = [log_posterior(x, data, d.noise.sigma_v, scoring.prior) for x in (fit.x, moved)]
    assert abs(ours - (plain[1] - plain[0])) < 1e-3 * abs(ours)

    def work():
        sampler = emcee.EnsembleSampler(WALKERS, fit.x.size, log_posterior, args=(data, d.noise.sigma_v, scoring.prior))
        sampler.run_mcmc(start, SHORT, skip_initial_state_check=True)

    timed.peer(
        PART,
        "emcee, 32 walkers, plain numpy likelihood",
        work,
        STEPS / SHORT,
        f"{SHORT} of {STEPS} steps timed; still too short to converge",
    )


def test_peer_emcee_compiled(timed):
    import emcee

    _, scoring, _ = of_device()
    fit = scoring.fit
    start, steps, rows = start_points(fit, np.random.default_rng(4)), 100, whole_rows(fit.likelihood)

    def work():
        sampler = emcee.EnsembleSampler(WALKERS, fit.x.size, rows.log_likelihood, vectorize=True)
        sampler.run_mcmc(start, steps, skip_initial_state_check=True)

    timed.peer(
        PART,
        "emcee, 32 walkers, this project's likelihood",
        work,
        STEPS / steps,
        f"{steps} of {STEPS} steps timed; still too short to converge",
    )
