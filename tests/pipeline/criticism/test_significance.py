"""p-values: tails agree with scipy, and family-wise p-values are uniform where nothing is hidden."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pipeline.criticism.pairs import best_pairs
from pipeline.criticism.problem import Candidate, FitResult, ResidualBlock, TermParameter
from pipeline.criticism.scores import baseline, project
from pipeline.criticism.significance import log_any, log_tail, normal_log_tail, score_all, trials_of


def _fit(jacobian: np.ndarray, residual: np.ndarray, noise_known: bool) -> FitResult:
    return FitResult(True, (), {}, (ResidualBlock("block", residual[:, None]),), (jacobian,), noise_known=noise_known)


@pytest.mark.parametrize("known", [True, False])
def test_family_wise_p_values_are_uniform_where_nothing_is_hidden(known: bool) -> None:
    """The candidates include boundaries, a scanned grid, two parameters and nearly parallel signatures."""
    rng = np.random.default_rng(6)
    rows = 60
    x = np.linspace(-1.0, 1.0, rows)
    jac = np.stack([np.ones(rows), x], axis=1)
    lines = [np.stack([np.cos(f * x), np.sin(f * x)], axis=1) for f in np.arange(5.0, 15.0, 1.0)]
    columns = np.concatenate([np.stack([x**2, x**3, x**3 + 0.1 * x**4, np.abs(x), x**5, x**6], axis=1), *lines], axis=1)
    one = (TermParameter("a"),)
    candidates = [
        Candidate("square", one, (slice(0, 1),)),
        Candidate("cube", one, (slice(1, 2),)),
        Candidate("like", one, (slice(2, 3),)),
        Candidate("kink", (TermParameter("a", side=1),), (slice(3, 4),)),
        Candidate("two", (TermParameter("a", side=-1), TermParameter("b")), (slice(4, 6),)),
        Candidate(
            "line",
            (TermParameter("c"), TermParameter("s")),
            tuple(slice(6 + 2 * i, 8 + 2 * i) for i in range(10)),
            ({},) * 10,
        ),
    ]
    scale = 1.0 if known else 37.0
    p = []
    for _ in range(200):
        fit = _fit(jac, scale * rng.standard_normal(rows), known)
        scores, _ = score_all(project(baseline(fit), [columns]), candidates, known, draws=1000)
        p.append(min(score.p_value for score in scores))
    assert stats.kstest(p, "uniform").pvalue > 0.003
    assert sum(value < 0.05 for value in p) <= stats.binom.ppf(0.999, 200, 0.05)


def test_a_pair_is_significant_where_neither_of_its_terms_is() -> None:
    rng = np.random.default_rng(8)
    rows = 24
    jac = np.ones((rows, 1))
    shared, own = rng.standard_normal(rows), rng.standard_normal((rows, 6))
    own[:, 0] = shared + 0.15 * own[:, 0]
    own[:, 1] = shared + 0.15 * own[:, 1]
    candidates = [Candidate(f"t{i}", (TermParameter("a"),), (slice(i, i + 1),)) for i in range(6)]
    residual = 40.0 * (own[:, 0] - own[:, 1]) / np.linalg.norm(own[:, 0] - own[:, 1]) + rng.standard_normal(rows)
    projected = project(baseline(_fit(jac, residual, False)), [own])
    scores, _ = score_all(projected, candidates, known=False, draws=2000)
    pairs = best_pairs(projected, candidates, known=False, draws=2000)
    assert min(score.p_value for score in scores) > 0.05
    assert set(pairs[0].names) == {"t0", "t1"}
    assert pairs[0].p_value < 0.01


@pytest.mark.parametrize("k", [1, 2, 3, 7])
def test_log_tails_agree_with_scipy_and_continue_below_underflow(k: int) -> None:
    t = np.array([0.0, 0.5, 3.0, 30.0, 300.0, 1000.0])
    assert log_tail(t, k) == pytest.approx(stats.chi2.logsf(t, k), rel=1e-9, abs=1e-12)
    assert log_tail(t, k, 20) == pytest.approx(np.log(stats.f.sf(t / k, k, 20)), rel=1e-9, abs=1e-12)
    # The slope is continuous where the asymptotic series takes over.
    far = np.array([1100.0, 1140.0, 1180.0, 1220.0])
    assert np.diff(log_tail(far, k)) == pytest.approx(-20.0 + (k / 2.0 - 1.0) * np.diff(np.log(far)), rel=1e-3)


def test_trials_of_inverts_log_any() -> None:
    assert np.exp(log_any(np.log(1e-3), 50.0)) == pytest.approx(1.0 - 0.999**50)
    assert trials_of(float(np.log(1e-3)), 1.0 - 0.999**50) == pytest.approx(50.0)
    assert float(log_any(-800.0, 10.0)) == pytest.approx(-800.0 + np.log(10.0))
    assert np.exp(normal_log_tail(1.959964)) == pytest.approx(0.05, rel=1e-6)
