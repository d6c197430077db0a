"""The answers of compare, diagnose and refine for a modal record: poles and residues that were identified by somebody else.

Without a declared sd the noise level is unknown: errors are null, relative errors are given, significance comes from F-tests at
5 % family-wise, and pairs are tried where no single effect passes.  With a declared sd the rules are those of a campaign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from msgspec import structs

from ...criticism.fit_tests import FitTests, Rules, fit_tests
from ...criticism.ladder import Diagnosis, Ladder
from ...criticism.pairs import best_pairs
from ...criticism.problem import FitResult
from ...criticism.scores import Score
from ...device.model import DEFAULT_COMPARE_MODEL, Model
from ...experiment.files.modal_record import ModalRecord
from ...inference.modal.axes import NAMES
from ..answers import ComparisonAnswer, DiagnosisAnswer, Noise, PairAnswer, RefinementAnswer, TermTest
from ..common import RegressionAnswers, diagnosis_answer, misfit, refinement_answer
from ..next_experiment.separating import Proposal
from ..where.modal import entries_by_misfit, explained_entries
from ..where.regions import LISTED
from .problem import ModalProblem

ALPHA_UNKNOWN_NOISE = 0.05


def modal_answers(record: ModalRecord, model: Model = DEFAULT_COMPARE_MODEL) -> ModalAnswers:
    """Prepare the answers for a modal record.

    Raises
    ------
    MeasurementError : the record's modes are not those of the plant of ``model``.
    """
    return ModalAnswers(ModalProblem(record, model))


@dataclass(frozen=True, eq=False)
class ModalAnswers(RegressionAnswers[ModalProblem]):
    """Answers about one modal record; the fits are kept by ``problem``."""

    @property
    def rules(self) -> Rules:
        """With an unknown noise level the few rows of a modal record can reach no smaller probability."""
        return Rules() if self.problem.noise_known else Rules(alpha=ALPHA_UNKNOWN_NOISE)

    @cached_property
    def comparison(self) -> ComparisonAnswer:
        """How well the given model explains the modal record: relative error, and with a declared noise error [sigma]."""
        fit = self.fitted()
        if not fit.ok:
            return ComparisonAnswer(error={}, relative_error={}, where=(), parameters={}, fit_ok=False, why=fit.why)
        error = fit.error_of("fit")
        return ComparisonAnswer(
            error={"fit": error, "validate": None},
            relative_error=dict(fit.relative_error),
            misfit={"fit": misfit(error), "validate": None},
            noise=Noise(
                sigma=tuple(self.problem.relative_sd(fit).tolist()),
                from_="declared" if self.problem.noise_known else "residual",
                unit="norm of each mode",
            ),
            where=entries_by_misfit(self.problem, fit),
            parameters=dict(fit.parameters),
            fit_ok=True,
            dof=fit.dof,
            **self._axes(fit),
        )

    def diagnosis(
        self, found: Diagnosis, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> DiagnosisAnswer:
        """What the given model lacks, with F-tests and pairs; ``proposals`` are none."""
        answer = diagnosis_answer(found)
        if not found.fit.ok:
            return answer
        tests = self._tests(found.fit)
        pairs = best_pairs(tests.projected, tests.signatures.candidates, self.problem.noise_known)[:LISTED]
        candidates = []
        for candidate, score in zip(answer.candidates, found.scores):
            refit = self.problem.fit((score.name,), tests.fit)
            after = refit.relative_error.get("fit") if refit.ok else None
            candidates.append(structs.replace(candidate, relative_error_after=after, **_test_of(tests, score)))
        return structs.replace(
            answer,
            candidates=tuple(candidates),
            pairs=tuple(PairAnswer(p.names, p.delta_chi2 / tests.fit.chi2, p.p_value) for p in pairs),
            relative_error=dict(tests.fit.relative_error),
            dof=tests.fit.dof,
            declared=self.problem.declared,
            invisible=(*answer.invisible, *self.problem.unseen),
        )

    def refinement(
        self, ladder: Ladder, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> RefinementAnswer:
        """The ladder; ``proposals`` are none."""
        answer = refinement_answer(ladder)
        if not ladder.rungs:
            return answer
        fits = [self.fitted(rung.terms) for rung in ladder.rungs]
        first, last = fits[0], self.fitted(ladder.terms)
        added = [
            {},
            *(self._test_among_all(before, rung.term) for (before, _), rung in zip(pairwise(fits), ladder.rungs[1:])),
        ]
        return structs.replace(
            answer,
            ladder=tuple(
                structs.replace(rung, dof=fit.dof, **self._axes(fit), **tests)
                for rung, fit, tests in zip(answer.ladder, fits, added)
            ),
            regions=explained_entries(ladder),
            relative_error={"before": first.relative_error["fit"], "after": last.relative_error["fit"]},
            where=entries_by_misfit(self.problem, last),
            candidates_left=_term_tests(self._tests(last)),
            invisible=self.problem.unseen,
            declared=self.problem.declared,
        )

    def _tests(self, fit: FitResult) -> FitTests:
        return fit_tests(self.problem, fit, self.rules)

    def _test_among_all(self, before: FitResult, term: str | None) -> dict[str, Any]:
        """The test of ``term`` on the rung before it was added, and the most significant of the others."""
        tests = self._tests(before)
        own = [_test_of(tests, score) for score in tests.scores if score.name == term]
        rivals = tuple(test for test in _term_tests(tests) if test.effect != term)
        return {**(own[0] if own else {}), "rivals": rivals[:LISTED]}

    def _axes(self, fit: FitResult) -> dict[str, Any]:
        """theta and split, and the paper's four thetas with the effects of the fit taken out."""
        four = self.problem.thetas(fit)
        if four is None:
            return dict(fit.derived)
        thetas = zip(four.theta_deg.tolist(), four.sd_deg.tolist())
        return {**fit.derived, "four_thetas_deg": dict(zip(NAMES, thetas)), "theta_spread_deg": four.spread_deg}


def _term_tests(tests: FitTests) -> tuple[TermTest, ...]:
    """The absent terms that these data could have shown, most significant first."""
    return tuple(TermTest(effect=score.name, **_test_of(tests, score)) for score in tests.scores if score.detectable)


def _test_of(tests: FitTests, score: Score) -> dict[str, Any]:
    """F (chi2 per degree of freedom where the noise is known), its degrees of freedom, p alone and family-wise."""
    left = tests.fit.dof - score.parameters
    spare = 1.0 if tests.fit.noise_known else max(tests.fit.chi2 - score.delta_chi2, 1e-300) / max(left, 1)
    return {
        "F": score.delta_chi2 / score.parameters / spare,
        "F_dof": (score.parameters, None if tests.fit.noise_known else left),
        "share_of_chi2": score.delta_chi2 / max(tests.fit.chi2, 1e-300),
        "p_single": float(np.exp(score.log_p_single)),
        "p_value": score.p_value,
    }
