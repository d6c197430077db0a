"""What the answers for campaigns and for modal records share: candidates, classes, verdict and ladder, from criticism."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Self, TypeVar

from msgspec import UNSET
from msgspec.structs import replace

from ..criticism.fit_tests import Rules
from ..criticism.goodness import Agreement
from ..criticism.ladder import Diagnosis, Ladder, Rung
from ..criticism.problem import FitResult, Problem
from ..criticism.scores import Score
from ..criticism.selection import ForwardSelection, forward_selection
from ..criticism.verdict import TermClass
from ..experiment.record import Record
from .answers import BadSamples, CandidateAnswer, DiagnosisAnswer, RefinementAnswer, RungAnswer, SizeDisagreement

if TYPE_CHECKING:
    from .next_experiment.separating import Proposal

P = TypeVar("P", bound=Problem)

#: Degeneracies of plant "gyro" that no linear experiment can resolve.
GAUGES = (
    "common rotation of the drive and sense electrodes (theta rotates with them)",
    "up-down tilt about the other axis (absorbed by updown_gain)",
    "linear part of electrostatic softening (absorbed by the frequencies and theta)",
)


@dataclass(frozen=True, eq=False)
class RegressionAnswers(ABC, Generic[P]):
    """What the answers of regressions share; the fits are kept by ``problem``."""

    problem: P

    @property
    @abstractmethod
    def rules(self) -> Rules:
        """Those of the selection."""

    def selected(self, rules: Rules) -> tuple[Self, ForwardSelection]:
        """The selection of effects, and these answers."""
        return self, forward_selection(self.problem, (), rules)

    def fitted(self, terms: Sequence[str] = ()) -> FitResult:
        """The fit of the given model with ``terms``."""
        return self.problem.fit(tuple(terms))

    def proposals(self, terms: Sequence[str], classes: Sequence[TermClass]) -> tuple[Proposal, ...]:
        """For every class the record that separates it; none, because drive files are those of time records."""
        return ()

    def first_diagnosis(self, found: Diagnosis) -> DiagnosisAnswer:
        """What the given model lacks."""
        return self.diagnosis(found)

    @abstractmethod
    def diagnosis(
        self, found: Diagnosis, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> DiagnosisAnswer:
        """What the given model lacks; ``proposals`` separate its classes."""


def diagnosis_answer(found: Diagnosis) -> DiagnosisAnswer:
    """A diagnosis without what only one kind of measurement has."""
    number = {name: k for k, item in enumerate(found.classes) for name in item.members}
    return DiagnosisAnswer(
        verdict=found.verdict,
        effects=found.terms,
        candidates=tuple(
            _candidate(score, found.error_after.get(score.name), number.get(score.name)) for score in found.scores
        ),
        classes=classes_of(found.classes),
        invisible=found.invisible,
        error=found.error,
        p_left=found.p_left,
        left=found.left,
        wrong_form=_disagreements(found.wrong_form),
        why=found.why,
        imitating=found.imitating,
    )


def refinement_answer(ladder: Ladder) -> RefinementAnswer:
    """A ladder without what only one kind of measurement has."""
    answer = RefinementAnswer(
        ladder=tuple(_rung(rung) for rung in ladder.rungs),
        verdict=ladder.verdict,
        effects=ladder.terms,
        classes=classes_of(ladder.classes),
        wrong_form=_disagreements(ladder.wrong_form),
        refused=dict(ladder.refused),
        regions=(),
        p_left=ladder.p_left,
        left=ladder.left,
        why=ladder.why,
        not_refitted=tuple(
            name for name in ladder.refused if not any(name in terms for terms in ladder.selection.fits)
        ),
        not_tried=ladder.selection.not_tried,
        imitating=ladder.imitating,
    )
    if not ladder.rungs:
        return answer
    first, last = (tests.fit for tests in (ladder.selection.tests[0], ladder.selection.tests[-1]))
    return replace(
        answer,
        theta_before_deg=first.derived.get("theta_deg", UNSET),
        split_before_hz=first.derived.get("split_hz", UNSET),
        theta_deg=last.derived.get("theta_deg", UNSET),
        split_hz=last.derived.get("split_hz", UNSET),
        parameters=dict(last.parameters),
    )


def bad_samples_of(records: Sequence[Record]) -> tuple[BadSamples, ...]:
    """The bad samples of marked records, in their order."""
    return tuple(
        BadSamples(record=record.name, channel=f"sense{one.channel + 1}", **one.seconds(record.sample_rate_hz))
        for record in records
        for one in record.bad or ()
    )


def classes_of(found: Sequence[TermClass]) -> tuple[tuple[str, ...], ...]:
    """Members of every class of more than one effect."""
    return tuple(item.members for item in found if len(item.members) > 1)


def misfit(error: float | None) -> float | None:
    """sqrt(max(error^2 - 1, 0)) of an error [sigma]; it still changes where the error rounds to 1.000."""
    return None if error is None else math.sqrt(max(error * error - 1.0, 0.0))


def _rung(rung: Rung) -> RungAnswer:
    return RungAnswer(
        effect=rung.term,
        status=rung.status,
        error_fit=rung.error_fit,
        error_validate=rung.error_validate,
        misfit_fit=misfit(rung.error_fit),
        misfit_validate=misfit(rung.error_validate),
        relative_error=rung.relative_error,
        delta_chi2=rung.delta_chi2,
        explained=rung.explained,
        held_out_fall=rung.held_delta_chi2,
        held_out_sd=rung.held_sd,
        terms=rung.terms,
        dropped=rung.dropped,
        parameters=dict(rung.parameters),
        derived=dict(rung.derived),
    )


def _candidate(score: Score, error_after: float | None, number: int | None) -> CandidateAnswer:
    return CandidateAnswer(
        effect=score.name,
        delta_chi2=score.delta_chi2,
        p_value=score.p_value,
        estimate={name: (v, None if math.isnan(sd) else sd) for name, (v, sd) in score.estimate.items()},
        error_after=error_after,
        class_=number,
        detectable=score.detectable,
        surviving_share=score.surviving_share,
        snr_at_reach=None if math.isinf(score.snr_at_reach) else score.snr_at_reach,
    )


def _disagreements(found: Mapping[str, Agreement]) -> dict[str, SizeDisagreement]:
    return {term: SizeDisagreement(by=one.partition, log_p=one.log_p) for term, one in found.items()}
