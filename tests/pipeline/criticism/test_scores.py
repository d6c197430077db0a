"""Scores: exact for linear models, and accurate where the baseline absorbs nearly the whole signature."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.criticism.problem import FitResult, ResidualBlock
from pipeline.criticism.scores import baseline, project
from pipeline.criticism.significance import score_all


def _fit(jacobian: list[np.ndarray], residual: list[np.ndarray]) -> FitResult:
    blocks = tuple(ResidualBlock(str(i), r[:, None]) for i, r in enumerate(residual))
    return FitResult(True, (), {}, blocks, tuple(jacobian))


def test_a_score_is_accurate_where_a_millionth_of_the_signature_survives() -> None:
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


def test_a_rank_deficient_baseline_is_projected_out_completely() -> None:
    rng = np.random.default_rng(2)
    thin = rng.standard_normal((200, 3))
    fit = _fit([np.concatenate([thin, thin[:, :1] + thin[:, 1:2]], axis=1)], [rng.standard_normal(200)])
    base = baseline(fit)
    assert base.upper.shape == (3, 4)
    assert np.abs(thin.T @ base.residual[0]).max() < 1e-10
    assert np.abs(base.basis[0] @ base.upper - fit.jacobian[0]).max() < 1e-10


def test_expected_delta_chi2_and_estimate_of_a_linear_term_equal_those_of_its_refit(toy: Any) -> None:
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


def test_a_one_sided_term_explains_nothing_of_the_opposite_sign(toy: Any) -> None:
    problem = toy.problem(5, {"kink": -15.0})
    fit = problem.fit(())
    signatures = problem.signatures(fit)
    scores, _ = score_all(project(baseline(fit), signatures.blocks), signatures.candidates, draws=500)
    kink = next(score for score in scores if score.name == "kink")
    assert kink.delta_chi2 == 0.0
    assert kink.estimate["kink0"][0] == 0.0
    assert kink.p_value > 0.9
