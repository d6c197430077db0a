"""What the page of a campaign computes: the answers of compare, diagnose and refine, and the ladder of chosen effects.

The data and all fits are kept here, once for the process.  Only the thread of ``explore.worker`` may call the methods, because
fits fill the caches of the problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pipeline.criticism.fit_tests import RefitTest
from pipeline.criticism.ladder import Ladder, as_diagnosis, as_ladder
from pipeline.criticism.problem import FitResult
from pipeline.criticism.rung import FitCache
from pipeline.criticism.selection import ForwardSelection, forward_selection
from pipeline.device.model import Model
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.record import Campaign
from pipeline.inference.general.fit import CampaignFit
from pipeline.learning.answers import ComparisonAnswer, DiagnosisAnswer, RefinementAnswer
from pipeline.learning.campaign.answers import CampaignAnswers
from pipeline.learning.campaign.problem import CampaignProblem
from pipeline.learning.joint.mixed import MixedProblem
from pipeline.learning.joint.next_record import Repeat, RepeatedRecord, repeated_record, repeats
from pipeline.learning.joint.problem import JointProblem
from pipeline.learning.next_experiment.experiments import Experiment
from pipeline.learning.next_experiment.predicted import NextRecord, next_experiments, next_record

from ...device.measured import Measured
from ...learning import ComparisonResult, compare
from ...learning.device_verdict import with_verdicts
from ...learning.views import decays_of, records_of, tones_of
from .chosen import chosen_selection
from .curves import View

if TYPE_CHECKING:
    from ...learning.of_kind import Answers

#: A record that may come next, and what two fits say of it.
Next = Experiment | Repeat
Told = NextRecord | RepeatedRecord


@dataclass(frozen=True, eq=False)
class ChosenModel:
    """The given model with chosen effects.

    Parameters
    ----------
    terms : the chosen effects in their order.
    refinement : their ladder, with the verdict on each rung.
    judged : for each chosen effect the test by which ``refine`` accepts or refuses it.
    views : records in time, sweeps, responses and decays beside this model; empty for a modal record.
    """

    terms: tuple[str, ...]
    refinement: RefinementAnswer
    judged: tuple[RefitTest, ...]
    views: tuple[View, ...]


class CampaignBench:
    """One measurement and one model to start from; see the module.

    Parameters
    ----------
    measured : campaign, modal record, or campaign of sweeps and decays.
    model : the model to start from.
    """

    def __init__(self, measured: Measured, model: Model) -> None:
        self._measured = measured
        self._model = model
        self._chosen: dict[tuple[str, ...], ChosenModel] = {}
        self._diagnosed: dict[tuple[str, ...], DiagnosisAnswer] = {}

    @cached_property
    def comparison(self) -> ComparisonAnswer:
        """The answer of ``gyroscreen compare``."""
        return self._compared.answer

    @cached_property
    def first(self) -> tuple[View, ...]:
        """Records in time, sweeps, responses and decays beside the given model; nothing where its fit failed."""
        found = self._compared
        if not found.problem.fit(()).ok:
            return ()
        return _views(found.problem, found.fit)

    def diagnosis(self, terms: tuple[str, ...] = ()) -> DiagnosisAnswer:
        """What ``gyroscreen diagnose`` says of the given model with ``terms``: candidates with their scores, and the verdict."""
        if terms not in self._diagnosed:
            answers, rules = self._answers, self._answers.rules
            selection = forward_selection(answers.problem, terms, rules) if terms else self._selected[1]
            self._diagnosed[terms] = answers.first_diagnosis(as_diagnosis(answers.problem, selection, rules))
        return self._diagnosed[terms]

    def chosen(self, terms: tuple[str, ...]) -> ChosenModel:
        """The given model with ``terms``, one rung for each.

        Raises
        ------
        NegativeError : a fit fails.
        """
        if terms not in self._chosen:
            answers = self._answers
            found = chosen_selection(self._cache, terms, answers.rules)
            ladder = as_ladder(answers.problem, found.selection, answers.rules)
            self._chosen[terms] = ChosenModel(
                terms,
                _refinement(answers, ladder),
                found.judged,
                _views(answers.problem, answers.fitted(terms)),
            )
        return self._chosen[terms]

    @property
    def predicts(self) -> bool:
        """Whether the next record can be predicted: not from poles and residues, which are no record."""
        return not isinstance(self._measured, ModalRecord)

    def experiments(self, terms: tuple[str, ...], effect: str) -> tuple[Next, ...]:
        """Experiments that may come next: drives, and the measured sweeps, responses and decays once more."""
        problem = self._answers.problem
        found: list[Next] = []
        if isinstance(problem, CampaignProblem | MixedProblem) and _driven(problem.campaign):
            found += next_experiments(problem, terms, effect)
        if isinstance(problem, JointProblem):
            found += repeats(problem)
        return tuple(found)

    def next_record(self, terms: tuple[str, ...], effect: str, experiment: Next) -> Told:
        """What the given model with ``terms``, without and with ``effect``, says of one of ``experiments``.

        Raises
        ------
        NegativeError, UsageError, ConfigError : as of ``next_record`` and ``repeated_record``.
        """
        problem = self._answers.problem
        if isinstance(experiment, Repeat):
            assert isinstance(problem, JointProblem)
            return repeated_record(problem, terms, effect, experiment)
        assert isinstance(problem, CampaignProblem | MixedProblem)
        return next_record(problem, terms, effect, experiment)

    @cached_property
    def _compared(self) -> ComparisonResult:
        return compare(self._measured, self._model)

    @cached_property
    def _selected(self) -> tuple[Answers, ForwardSelection]:
        """The selection of diagnose and refine, and the answers on whose problem it was made."""
        answers = self._compared.answers
        return answers.selected(answers.rules)

    @property
    def _answers(self) -> Answers:
        return self._selected[0]

    @cached_property
    def _cache(self) -> FitCache:
        answers, selection = self._selected
        return FitCache(answers.problem, selection.fits)


def _driven(campaign: Campaign) -> bool:
    """Whether a fitted record has a drive; without one nothing is known of what a drive would do."""
    return any(np.any(record.drive_v) for record in campaign.with_role("fit"))


def _views(problem: object, fit: CampaignFit | FitResult) -> tuple[View, ...]:
    """All that can be drawn of a measurement beside a fit."""
    return (*records_of(problem, fit), *tones_of(problem, fit), *decays_of(problem, fit))


def _refinement(answers: Answers, ladder: Ladder) -> RefinementAnswer:
    """The answer of refine for a ladder, without the search for a separating record."""
    found = answers.refinement(ladder, (), False)
    return with_verdicts(found, answers, None) if isinstance(answers, CampaignAnswers) else found
