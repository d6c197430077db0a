"""Scores, their projection and their null: exact for linear models, calibrated for noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from pipeline.criticism.pairs import best_pairs
from pipeline.criticism.problem import Candidate, FitResult, ResidualBlock, TermParameter
from pipeline.criticism.scores import baseline, project
from pipeline.criticism.significance import log_any, log_tail, normal_log_tail, score_all, trials_of


def _fit(jacobian: list[np.ndarray], residual: list[np.ndarray], **options: Any) -> FitResult:
    blocks = tuple(ResidualBlock(str(i), r[:, None]) for i, r in enumerate(residual))
    return FitResult(True, (), {}, blocks, tuple(jacobian), **options)


def test_a_signature_of_which_a_millionth_survives_is_still_right() -> None:
    rng = np.random.default_rng(1)
    jacobian = [rng.standard_normal((300, 5)) * 10.0 ** np.array([-6, 0, 3, 8, 2]) for _ in range(2)]
    fresh = [rng.standard_normal(300) for _ in range(2)]
    q, _ = np.linalg.qr(np.concatenate(jacobian))
    pure = np.concatenate(fresh)
    pure = pure - q @ (q.T @ pure)
    hidden = [
        (j @ np.array([3e6, 1, 1e-3, 1e-8, 0.01]) + 1e-6 * f)[:, None] for j, f in zip(jacobian, np.split(pure, 2))
    ]
    residual = list(np.split(pure, 2))
    projected = project(baseline(_fit(jacobian, residual)), hidden)
    score = projected.score[0] * projected.norms[0]
    assert score == pytest.approx(1e-6 * float(pure @ pure), rel=1e-5)


def test_a_rank_deficient_baseline_is_projected_out_whole() -> None:
    rng = np.random.default_rng(2)
    thin = rng.standard_normal((200, 3))
    fit = _fit([np.concatenate([thin, thin[:, :1] + thin[:, 1:2]], axis=1)], [rng.standard_normal(200)])
    base = baseline(fit)
    assert base.upper.shape == (3, 4)
    assert np.abs(thin.T @ base.residual[0]).max() < 1e-10
    assert np.abs(base.basis[0] @ base.upper - fit.jacobian[0]).max() < 1e-10


def test_the_expected_fall_and_estimate_of_a_linear_term_are_those_of_its_refit(toy: Any) -> None:
    problem = toy.problem(4, {"cube": 12.0})
    fit = problem.fit(())
    signatures = problem.signatures(fit)
    scores, _ = score_all(project(baseline(fit), signatures.blocks), signatures.candidates, draws=500)
    for score in scores:
        refit = problem.fit((score.name,))
        assert score.delta_chi2 == pytest.approx(fit.chi2 - refit.chi2, rel=1e-6, abs=1e-6), score.name
        value, sd = score.estimate[f"{score.name}0"]
        assert value == pytest.approx(refit.parameters[f"{score.name}0"][0], rel=1e-6, abs=1e-9)
        if score.name == "cube":
            assert value > 0.0
            assert sd == pytest.approx(refit.parameters["cube0"][1], rel=1e-6)


def test_a_term_that_exists_on_one_side_only_gains_nothing_on_the_other(toy: Any) -> None:
    problem = toy.problem(5, {"kink": -15.0})
    fit = problem.fit(())
    signatures = problem.signatures(fit)
    scores, _ = score_all(project(baseline(fit), signatures.blocks), signatures.candidates, draws=500)
    kink = next(score for score in scores if score.name == "kink")
    assert kink.delta_chi2 == 0.0
    assert kink.estimate["kink0"][0] == 0.0
    assert kink.p_value > 0.9


@pytest.mark.parametrize("known", [True, False])
def test_family_p_values_are_uniform_when_nothing_is_hidden(known: bool) -> None:
    """Boundaries, a scanned grid, two-parameter and nearly parallel candidates together."""
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
        fit = _fit([jac], [scale * rng.standard_normal(rows)], noise_known=known)
        scores, _ = score_all(project(baseline(fit), [columns]), candidates, known, draws=1000)
        p.append(min(score.p_value for score in scores))
    assert stats.kstest(p, "uniform").pvalue > 0.003
    assert sum(value < 0.05 for value in p) <= stats.binom.ppf(0.999, 200, 0.05)


def test_pairs_are_found_where_neither_member_shows_alone() -> None:
    rng = np.random.default_rng(8)
    rows = 24
    jac = np.ones((rows, 1))
    shared, own = rng.standard_normal(rows), rng.standard_normal((rows, 6))
    own[:, 0] = shared + 0.15 * own[:, 0]
    own[:, 1] = shared + 0.15 * own[:, 1]
    candidates = [Candidate(f"t{i}", (TermParameter("a"),), (slice(i, i + 1),)) for i in range(6)]
    residual = 40.0 * (own[:, 0] - own[:, 1]) / np.linalg.norm(own[:, 0] - own[:, 1]) + rng.standard_normal(rows)
    projected = project(baseline(_fit([jac], [residual], noise_known=False)), [own])
    scores, _ = score_all(projected, candidates, known=False, draws=2000)
    pairs = best_pairs(projected, candidates, known=False, draws=2000)
    assert min(score.p_value for score in scores) > 0.05
    assert set(pairs[0].names) == {"t0", "t1"}
    assert pairs[0].p_value < 0.01


@pytest.mark.parametrize("k", [1, 2, 3, 7])
def test_tails_join_the_known_ones_and_go_on_beyond_underflow(k: int) -> None:
    t = np.array([0.0, 0.5, 3.0, 30.0, 300.0, 1000.0])
    assert log_tail(t, k) == pytest.approx(stats.chi2.logsf(t, k), rel=1e-9, abs=1e-12)
    assert log_tail(t, k, 20) == pytest.approx(np.log(stats.f.sf(t / k, k, 20)), rel=1e-9, abs=1e-12)
    # Across the switch to the asymptotic series the slope is continuous.
    far = np.array([1100.0, 1140.0, 1180.0, 1220.0])
    assert np.diff(log_tail(far, k)) == pytest.approx(-20.0 + (k / 2.0 - 1.0) * np.diff(np.log(far)), rel=1e-3)


def test_the_number_of_trials_inverts_the_probability_of_any() -> None:
    assert np.exp(log_any(np.log(1e-3), 50.0)) == pytest.approx(1.0 - 0.999**50)
    assert trials_of(float(np.log(1e-3)), 1.0 - 0.999**50) == pytest.approx(50.0)
    assert float(log_any(-800.0, 10.0)) == pytest.approx(-800.0 + np.log(10.0))
    assert np.exp(normal_log_tail(1.959964)) == pytest.approx(0.05, rel=1e-6)
