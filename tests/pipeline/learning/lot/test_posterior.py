"""The posterior of the spreads of a lot against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

from pipeline.learning.lot.measured import MeasuredLot
from pipeline.learning.lot.model import LotModel, RandomPart, means
from pipeline.learning.lot.posterior import SCALE, influential, posterior, sampled
from pipeline.learning.lot.profile import profiled
from pipeline.learning.lot.reml import fitted


def one_way(lots: int, devices: int, between: float, seed: int) -> tuple[MeasuredLot, float, float]:
    """A balanced one-way design with mean squares of its expectation: lot, SS between, SS within."""
    g = np.random.default_rng(seed)
    a = g.normal(size=lots)
    e = g.normal(size=(lots, devices))
    e -= e.mean(axis=1, keepdims=True)
    e *= np.sqrt(lots * (devices - 1) / np.sum(e**2))
    a -= a.mean()
    a *= np.sqrt((lots - 1) * (between**2 + 1.0 / devices) / max(float(np.sum(a**2)), 1e-300))
    y = (a[:, None] + e).reshape(-1, 1)
    n = len(y)
    names = tuple(f"L{k // devices}" for k in range(n))
    none = np.full(n, np.nan)
    lot = MeasuredLot(
        "lot", ("y",), ("1",), y, np.zeros((n, 1, 1)), {"lot": names, "wafer": names}, none, none, 50.0, none,
        tuple(map(str, range(n))),
    )  # fmt: skip
    return lot, devices * float(np.sum(a**2)), float(np.sum(e**2))


def model(n: int, levels: tuple[str, ...]) -> LotModel:
    parts = tuple(RandomPart(level, level, np.ones((n, 1, 1))) for level in levels)  # type: ignore[arg-type]
    return LotModel((means(n, 1),), parts, np.zeros((n, 1)))


def prior(s: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + (s / SCALE) ** 2)


def test_one_spread_has_a_chi_square_posterior():
    # Flat in the sd: SS / s^2 is chi-square with N - 2 degrees of freedom.
    lot, _, within = one_way(1, 40, 0.0, 1)
    fit = fitted(lot, model(40, ("device",)))
    found = posterior(fit, 1, seed=2)
    exact = np.sqrt(within / chi2.ppf([0.95, 0.5, 0.05], 38))
    own = found.spreads["device"]
    assert found.converged
    # The sd of a 5 % quantile of 1000 independent draws is 0.07 sd of the posterior, which is 0.12 here.
    assert [own.low, own.median, own.high] == pytest.approx(exact, abs=3 * 0.07 * 0.12)
    assert own.reml == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("between", [1.5, 0.2])
def test_a_balanced_one_way_design_has_the_posterior_of_its_two_mean_squares(between, count):
    lots, devices = 8, 10
    lot, ss_between, ss_within = one_way(lots, devices, between, 3)
    fit = fitted(lot, model(lots * devices, ("lot", "device")))
    found = sampled(fit, np.array([0, 1][:count]), fit.interval(), seed=4)
    assert found.converged
    # SSB / (s_e^2 + n s_a^2) and SSW / s_e^2 are independent chi-squares: the density on a grid, then its quantiles.
    a = np.linspace(1e-4, 8.0, 4000)[:, None]
    e = np.linspace(0.6, 1.7, 400)[None, :]
    whole = e**2 + devices * a**2
    log_p = -0.5 * (lots - 1) * np.log(whole) - 0.5 * ss_between / whole
    log_p += -lots * (devices - 1) * np.log(e) - 0.5 * ss_within / e**2
    density = np.exp(log_p - log_p.max()) * prior(a) * prior(e)
    cumulative = np.cumsum(density.sum(axis=1)) / density.sum()
    exact = np.interp([0.05, 0.5, 0.95], cumulative, a[:, 0])
    drawn = np.quantile(found.draws[..., 0], [0.05, 0.5, 0.95])
    spread = (exact[2] - exact[0]) / 3.3
    # Draws of 1000 independent ones: 0.07 sd at the median, 0.15 sd in the long upper tail.
    assert drawn == pytest.approx(exact, abs=4 * 0.07 * spread)
    if count == 2:
        own = np.cumsum(density.sum(axis=0)) / density.sum()
        expected = np.interp([0.05, 0.5, 0.95], own, e[0])
        assert np.quantile(found.draws[..., 1], [0.05, 0.5, 0.95]) == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("between", [0.05, 0.6, 2.0])
def test_the_profile_is_the_maximum_over_the_other_variances(between):
    # Two levels of devices on wafers of lots, the lots without any spread of their own, so that one variance is at zero.
    g = np.random.default_rng(11)
    lots, wafers, devices = 4, 3, 6
    lot, wafer = np.divmod(np.repeat(np.arange(lots * wafers), devices), wafers)
    y = g.normal(size=lots * wafers)[np.repeat(np.arange(lots * wafers), devices)] + g.normal(size=lot.size)
    none = np.full(lot.size, np.nan)
    measured = MeasuredLot(
        "lot", ("y",), ("1",), y[:, None], np.zeros((lot.size, 1, 1)),
        {"lot": tuple(map(str, lot)), "wafer": tuple(f"{a}-{b}" for a, b in zip(lot, wafer))}, none, none, 50.0, none,
        tuple(map(str, range(lot.size))),
    )  # fmt: skip
    fit = fitted(measured, model(lot.size, ("lot", "wafer", "device")))
    own, variances = profiled(fit, np.array([1]), np.array([between**2]), fit.variances)

    def value(log_v: np.ndarray) -> float:
        return -fit.at(np.array([np.exp(log_v[0]), between**2, np.exp(log_v[1])]))

    best = minimize(value, [-2.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 2000})
    assert variances[1] == pytest.approx(between**2)
    # The last step may have promised 0.02 in 2 ln L.
    assert own == pytest.approx(-best.fun, abs=0.02)


def test_the_spread_that_is_known_least_matters_most():
    lot, _, _ = one_way(5, 40, 1.0, 5)
    fit = fitted(lot, model(200, ("lot", "device")))
    assert influential(fit, 2, fit.interval()).tolist() == [0, 1]


def test_the_same_seed_gives_the_same_draws():
    lot, _, _ = one_way(1, 12, 0.0, 6)
    fit = fitted(lot, model(12, ("device",)))
    first, second, other = (posterior(fit, 1, seed=seed).spreads["device"].high for seed in (9, 9, 10))
    assert first == second != other
