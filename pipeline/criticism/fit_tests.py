"""Tests of one fit (absent terms, structure in the residual), and tests of whether a fit with one more term is better.

A larger fit is judged on the fitted data by the decrease of chi2 and by the Wald statistic of the term (Wald 1943),
W = theta' C^-1 theta with the covariance C of its sizes theta, and on held-out data (``held_out``).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .announce import announce
from .budget import ALPHA, CLEAR_SNR, DRAWS
from .goodness import ResidualTests, excess, goodness
from .held_out import PairedDifference, held_out_difference
from .problem import FitResult, Problem, Region, Signatures
from .scores import Baseline, Projected, Score, baseline, project
from .significance import Null, log_tail, score_all

#: Residual over record of a coarse fit: beside a friction that reached a sixth of the misfit of magnet-beam.lvm (56 %), a
#: hardening that explains nearly all of it was not refitted, because it turns the phase over many cycles.
_COARSE = 1.0 / 3.0
#: Why a term is refused whose refit ended at a limit.
AT_LIMIT = "after its refit, a parameter is at the limit of its range, or the term duplicates part of the model"
Outcome = Literal["accepted", "failed", "at limit", "insignificant", "little", "unsupported"]


@dataclass(frozen=True)
class Rules:
    """Rules of forward selection, diagnosis and refinement.

    Parameters
    ----------
    alpha : family-wise probability of naming a term where none is present.
    alpha_left : probability of calling noise structured ("unknown").
    rungs : largest number of terms that may be added where the noise is known, so that structure that is left shows that the
        library lacks something; elsewhere the candidates are the only limit.
    least_share : smallest share of the misfit that a term must explain; less means that something else is missing.
    least_expected : smallest share of the misfit that a score must expect for a refit to be worth its time.
    same_promise : promises that differ by less than this share are equal: a refused term is not refitted again while its own has
        changed by less, and candidates that promise less than a refit has reached by more are not refitted.
    class_refits : number of rivals of a term that are refitted in its place.
    draws, seed : of the simulated nulls.
    """

    alpha: float = ALPHA
    alpha_left: float = ALPHA
    rungs: int = 4
    least_share: float = 0.15
    least_expected: float = 0.05
    same_promise: float = 0.2
    class_refits: int = 4
    draws: int = DRAWS
    seed: int = 0


@dataclass(frozen=True, eq=False)
class FitTests:
    """Tests of one fit.

    Parameters
    ----------
    fit, base : the fit and its baseline.
    signatures, projected : absent terms at this fit, and their columns with the baseline projected out.
    scores, null : of the absent terms, most significant first, and the null that gave their p-values.
    goodness : tests of structure in the residual.
    regions, excess : residual energy by region; the misfit, that above the common noise level or what one family of generic
        shapes explains, whichever is larger (0 where the level is unknown).
    """

    fit: FitResult
    base: Baseline
    signatures: Signatures
    projected: Projected
    scores: tuple[Score, ...]
    null: Null
    goodness: ResidualTests
    regions: tuple[Region, ...]
    excess: float

    @property
    def invisible(self) -> tuple[str, ...]:
        """Terms that these data could not have shown, however strong within their range."""
        return tuple(sorted(score.name for score in self.scores if not score.detectable))

    def significant(self, alpha: float) -> tuple[Score, ...]:
        """Candidates that these data could show whose p-value, family-wise, is below ``alpha``; most significant first."""
        return tuple(score for score in self.scores if score.p_value < alpha and score.detectable)

    def curved(self, alpha: float) -> tuple[Score, ...]:
        """Candidates that these data may show by their second order only, where structure at ``alpha`` asks for one."""
        names = self.signatures.curved if self.is_structured(alpha) else self.signatures.beside
        return tuple(score for score in self.scores if score.name in names)

    @property
    def is_coarse(self) -> bool:
        """Whether so much is left that scores, which know the first order alone, promise too little."""
        return (self.fit.relative_error.get("fit") or 0) > _COARSE

    def is_structured(self, alpha: float) -> bool:
        """Whether structure is left in the residual, at ``alpha``."""
        return self.goodness.p_value < alpha

    def is_significant(self, delta_chi2: float, parameters: int, alpha: float) -> bool:
        """Whether a refit lowers chi2 as significantly as the score of its term had to, at ``alpha``."""
        critical = max(self.null.critical(alpha), np.log(alpha))
        return bool(_log_p_of_decrease(self, delta_chi2, parameters) <= critical)

    def is_negligible(self, delta_chi2: float, parameters: int, alpha: float) -> bool:
        """Whether ``parameters`` of the fit could be removed, at this increase of chi2, without a significant loss."""
        return bool(_log_p_of_increase(self, delta_chi2, parameters) > self.null.critical(alpha))


def fit_tests(problem: Problem, fit: FitResult, rules: Rules) -> FitTests:
    """Test a fit: scores of the absent terms, structure in the residual, energy by region.  ``fit.ok`` must hold."""
    announce("testing the absent effects")
    base = baseline(fit)
    with ThreadPoolExecutor(1) as pool:
        # The tests of the residual do not need the signatures, so both run at the same time.
        residual_tests = pool.submit(_residual_tests, problem, fit, base)
        signatures = problem.signatures(fit)
        projected = project(base, signatures.blocks, signatures.grams)
        scores, null = score_all(
            projected, signatures.candidates, fit.noise_known, rules.draws, rules.seed, signatures.local
        )
        regions, structure = residual_tests.result()
    # The energy of regions does not see a misfit that lies in few directions.
    misfit = max(excess(regions), structure.explained) if fit.noise_known else 0.0
    return FitTests(fit, base, signatures, projected, scores, null, structure, regions, misfit)


def _residual_tests(problem: Problem, fit: FitResult, base: Baseline) -> tuple[tuple[Region, ...], ResidualTests]:
    regions = tuple(problem.regions(fit))
    # Only a known noise level can say that something is left.
    probes = problem.probes(fit) if fit.noise_known else Signatures((), ())
    return regions, goodness(fit, base, probes, regions, problem.spectrum(fit))


def _log_p_of_decrease(tests: FitTests, delta_chi2: float, parameters: int) -> float:
    """log p of a decrease of chi2 by added ``parameters``, at the noise level of the tested fit (at least the nominal)."""
    if tests.fit.noise_known:
        return float(log_tail(delta_chi2 / max(tests.goodness.level, 1.0) ** 2, parameters))
    dof = max(tests.fit.dof - parameters, 1)
    # chi2 of the larger fit is known to rounding.
    left = max(tests.fit.chi2 - delta_chi2, np.finfo(float).eps * tests.fit.chi2, 1e-300)
    return float(log_tail(delta_chi2 * dof / left, parameters, dof))


def _log_p_of_increase(tests: FitTests, delta_chi2: float, parameters: int) -> float:
    """log p of an increase of chi2 by removed ``parameters``."""
    if tests.fit.noise_known:
        return _log_p_of_decrease(tests, delta_chi2, parameters)
    dof = max(tests.fit.dof, 1)
    return float(log_tail(delta_chi2 * dof / max(tests.fit.chi2, 1e-300), parameters, dof))


def residual_variance(fit: FitResult) -> float:
    """Variance of the rows of a fit [sigma^2]: chi2 / dof, but at least 1 where the noise level is known."""
    level = fit.chi2 / max(fit.dof, 1)
    return max(1.0, level) if fit.noise_known else max(level, 1e-300)


def log_p_without(fit: FitResult, smaller: FitResult) -> float:
    """log P of the increase of chi2 from ``fit`` to the ``smaller`` fit, which has fewer terms.

    The increase is divided by chi2 / dof of ``fit``, but at least by 1 where the noise level is known.
    """
    increase = max(smaller.chi2 - fit.chi2, 0.0) / residual_variance(fit)
    parameters = max(smaller.dof - fit.dof, 1)
    return float(log_tail(increase, parameters, None if fit.noise_known else max(fit.dof, 1)))


def wald(fit: FitResult, term: str) -> float:
    """W = theta' C^-1 theta of a term in the fit (Wald 1943), with C from (J' J)^-1 and the noise level of the fit.

    Parameters at their null or without one are left out; W is 0 where no other is left.
    """
    gram = sum((jac.T @ jac for jac in fit.jacobian), np.zeros((fit.jacobian[0].shape[1],) * 2))
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    covariance = np.linalg.pinv(gram / scale / scale[:, None], rcond=1e-14, hermitian=True)
    own = [i for i, shift in zip(fit.columns[term], fit.shifts[term]) if shift != 0.0]
    if not own:
        return 0.0
    theta = np.array([shift for shift in fit.shifts[term] if shift != 0.0]) * scale[own]
    part = covariance[np.ix_(own, own)]
    return float(theta @ np.linalg.pinv(part, hermitian=True) @ theta) / residual_variance(fit)


def is_clear(fit: FitResult, term: str) -> bool:
    """Whether W > 64: the size of a term in the fit differs from zero by more than 8 sigma."""
    return wald(fit, term) > CLEAR_SNR**2


def _is_nonzero(fit: FitResult, term: str) -> bool:
    """Whether the size of a term exceeds its sd; chi2 that falls without that comes from a discontinuity at the null."""
    return not any(fit.shifts.get(term, ())) or wald(fit, term) > 1.0


@dataclass(frozen=True)
class RefitTest:
    """Test of a fit with more terms.

    Parameters
    ----------
    delta_chi2, held : decrease of the fitted and of the held-out chi2.
    outcome : "accepted", or one of the five reasons not to add the terms; see ``refit_test``.
    reason : the same in words.
    """

    delta_chi2: float
    held: PairedDifference
    outcome: Outcome = "accepted"
    reason: str = ""


def refit_test(tests: FitTests, parameters: int, fit: FitResult, added: Sequence[str], rules: Rules) -> RefitTest:
    """Whether ``fit``, which adds the terms ``added`` with ``parameters`` in all, is better than the tested fit.

    failed            it has no useful result, or raised chi2
    at limit          an added parameter ended at the limit of its range
    insignificant     chi2 falls by less than ``alpha`` asks, or a size is below its sd
    little            it explains less than ``least_share`` of the misfit
    unsupported       the held-out chi2 rises against expectation; where the noise level is unknown, it does not fall by more
                      than 2 sd, because an F-test takes every remaining misfit for white noise
    """
    delta_chi2, held = tests.fit.chi2 - fit.chi2, PairedDifference(0.0, 0.0)
    outcome: Outcome = "accepted"
    reason = ""
    if not fit.ok or fit.chi2 > tests.fit.chi2 * (1.0 + 1e-9):
        outcome, why = "failed", fit.why or "it did not converge"
        reason = "its fit raised chi2" if fit.ok else f"its fit failed: {why}"
    elif set(added) & set(fit.at_limit):
        outcome, reason = "at limit", AT_LIMIT
    elif not all(_is_nonzero(fit, name) for name in added):
        outcome, reason = "insignificant", "after its refit, its size is not significantly different from zero"
    elif not tests.is_significant(delta_chi2, parameters, rules.alpha):
        outcome, reason = "insignificant", "after its refit, the decrease of chi2 is not significant"
    elif delta_chi2 < rules.least_share * tests.excess:
        outcome = "little"
        reason = f"after its refit, it explains less than {100 * rules.least_share:.0f} % of the misfit"
    else:
        held = held_out_difference(tests.fit, fit)
        if held.status == "refused":
            outcome, reason = "unsupported", f"the held-out chi2 rises by {-held.delta_chi2:.3g} +- {held.sd:.2g}"
        elif not fit.noise_known and fit.held and held.status != "confirmed":
            change = f"the held-out chi2 falls by {held.delta_chi2:.3g} +- {held.sd:.2g} only"
            outcome, reason = "unsupported", f"{change}, and the noise level is unknown"
    return RefitTest(delta_chi2, held, outcome, reason)
