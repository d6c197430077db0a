"""The learning loop for campaigns and modal records, with calls as short as the commands.

compare(campaign, model)     how well the model explains the measurement, and where it fails
diagnose(campaign, model)    which effect the model lacks, or that no known effect explains the misfit
refine(campaign, model)      the ladder: effects are added and refitted until no further one is significant

Results are frozen.  They print as the commands do, show their tables in a notebook, and give the JSON of the commands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from msgspec import structs
from threadpoolctl import threadpool_limits

from pipeline.criticism.ladder import Diagnosis, Ladder, as_diagnosis, as_ladder
from pipeline.criticism.problem import FitResult
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.inference.general.fit import CampaignFit
from pipeline.learning.answers import ComparisonAnswer, DiagnosisAnswer, Noise, RefinementAnswer, to_builtins
from pipeline.learning.campaign.answers import CampaignAnswers
from pipeline.learning.campaign.problem import CampaignProblem
from pipeline.learning.common import classes_of
from reports.words.terminal import lines_of

from ..device.measured import Measured
from . import tables
from .of_kind import answers_of

if TYPE_CHECKING:
    import pandas as pd

    from pipeline.learning.joint.problem import JointProblem
    from pipeline.learning.modal.problem import ModalProblem
    from pipeline.learning.next_experiment.separating import Proposal
    from reports.limits import Limits

    from .of_kind import Answers

__all__ = ["ComparisonResult", "DiagnosisResult", "RefinementResult", "compare", "diagnose", "refine"]


@threadpool_limits.wrap(limits=1)
def compare(campaign: Measured, model: Model = DEFAULT_COMPARE_MODEL, limits: Limits | None = None) -> ComparisonResult:
    """Fit ``model`` to the fit records and judge it on all records.

    Raises
    ------
    MeasurementError : a campaign without a record to fit; a modal record whose modes are not those of the plant.
    """
    answers = answers_of(campaign, model)
    answers.problem.fit(())
    return ComparisonResult(answers, limits=limits)


@threadpool_limits.wrap(limits=1)
def diagnose(campaign: Measured, model: Model = DEFAULT_COMPARE_MODEL, limits: Limits | None = None) -> DiagnosisResult:
    """Find what ``model`` lacks; raises as :func:`compare`."""
    answers = answers_of(campaign, model)
    answers, selection = answers.selected(answers.rules)
    return DiagnosisResult(answers, as_diagnosis(answers.problem, selection, answers.rules), limits=limits)


@threadpool_limits.wrap(limits=1)
def refine(campaign: Measured, model: Model = DEFAULT_COMPARE_MODEL, limits: Limits | None = None) -> RefinementResult:
    """Add effects to ``model`` until no further one is significant; raises as :func:`compare`."""
    answers = answers_of(campaign, model)
    answers, selection = answers.selected(answers.rules)
    return RefinementResult(answers, as_ladder(answers.problem, selection, answers.rules), limits=limits)


@dataclass(frozen=True, eq=False, repr=False)
class Result(ABC):
    """The result of a command; ``answers`` keeps the fits, and ``limits`` judge the device if given."""

    answers: Answers
    limits: Limits | None = field(default=None, kw_only=True)

    @property
    def problem(self) -> CampaignProblem | ModalProblem | JointProblem:
        """The measurement as a problem of criticism, with its fits."""
        return self.answers.problem

    @property
    @abstractmethod
    def answer(self) -> ComparisonAnswer | DiagnosisAnswer | RefinementAnswer:
        """The result as data."""

    @abstractmethod
    def shown(self) -> tuple[pd.DataFrame, ...]:
        """Tables below the text in a notebook."""

    def _judged(self) -> dict[str, str]:
        """The verdict on the device by the given model; empty without limits and for a plant that is no gyro."""
        if self.limits is None or not isinstance(self.answers, CampaignAnswers) or not self.answers.problem.fit(()).ok:
            return {}
        from .device_verdict import verdict_of

        found = verdict_of(self.answers.fitted(), self.answers.problem.campaign, self.limits)
        if found is None:
            return {}
        return {"device_verdict": found.verdict, "device_verdict_reason": found.reason or found.failed_limits}

    def to_dict(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        return to_builtins(self.answer)

    def __str__(self) -> str:
        return "\n".join(lines_of(self.answer))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return tables.html(lines_of(self.answer), self.shown())


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonResult(Result):
    """How well a model explains a measurement, and where it fails."""

    @property
    def answer(self) -> ComparisonAnswer:
        """The result as data."""
        return structs.replace(self.answers.comparison, **self._judged())

    @property
    def fit(self) -> CampaignFit | FitResult:
        """The fit: predictions, residuals, covariance."""
        return self.answers.fitted()

    @property
    def noise(self) -> Noise | None:
        """sigma [V] by channel and where it comes from; ``None`` where the fit failed."""
        return self.answer.noise or None

    @property
    def where(self) -> pd.DataFrame:
        """One row per region where the model fails; shares add up to one within a family."""
        return tables.where_table(self.answer.where)

    @property
    def records(self) -> pd.DataFrame:
        """One row per record: role and errors (in sigmas, in volts, relative)."""
        return tables.records_table(self.answer.records or {})

    @property
    def parameters(self) -> pd.DataFrame:
        """One row per parameter: value, sd, unit."""
        return tables.parameters_table(self.answer.parameters, self.problem.model)

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """Where the model fails, records, parameters."""
        return self.where, self.records, self.parameters


@dataclass(frozen=True, eq=False, repr=False)
class SelectionResult(Result):
    """The result of a search for missing effects; with ``drive_files`` the answer names the drive files of ``separating``."""

    drive_files: bool = field(default=False, kw_only=True)

    @property
    @abstractmethod
    def _found(self) -> Diagnosis | Ladder: ...

    @property
    def verdict(self) -> str:
        """ "adequate", "effect", "class", "unknown" or "fit_failed"."""
        return self._found.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Named or added effects."""
        return self._found.terms

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Effects that these data cannot distinguish."""
        return classes_of(self._found.classes)

    @cached_property
    def separating(self) -> tuple[Proposal, ...]:
        """For every class the record that separates it best."""
        return self.answers.proposals(self.effects, self._found.classes)

    def with_drive_files(self, folder: Path) -> Self:
        """The same result, after the drive files of ``separating`` were written to ``folder``.

        Raises
        ------
        UsageError : the folder cannot be written.
        """
        named = replace(self, drive_files=True)
        for proposal in named.separating:
            proposal.write(folder)
        return named


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult(SelectionResult):
    """What a model lacks."""

    diagnosis: Diagnosis

    @property
    def _found(self) -> Diagnosis:
        return self.diagnosis

    @cached_property
    def answer(self) -> DiagnosisAnswer:
        """The result as data."""
        found = self.answers.diagnosis(self.diagnosis, self.separating, self.drive_files)
        return structs.replace(found, **self._judged())

    @property
    def candidates(self) -> pd.DataFrame:
        """One row per absent effect, the most significant first."""
        return tables.candidates_table(self.answer.candidates)

    @property
    def sizes(self) -> pd.DataFrame:
        """One row per parameter of each absent effect: value, sd, unit."""
        return tables.sizes_table(self.answer.candidates, self.problem.model)

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """The candidates."""
        return (self.candidates,)


@dataclass(frozen=True, eq=False, repr=False)
class RefinementResult(SelectionResult):
    """The ladder, with theta, split and the verdict on every rung."""

    ladder: Ladder

    @property
    def _found(self) -> Ladder:
        return self.ladder

    @property
    def before(self) -> CampaignFit | FitResult:
        """The fit of the given model."""
        return self.answers.fitted()

    @property
    def after(self) -> CampaignFit | FitResult:
        """The fit of the last model."""
        return self.answers.fitted(self.effects)

    @cached_property
    def answer(self) -> RefinementAnswer:
        """The result as data."""
        found = self.answers.refinement(self.ladder, self.separating, self.drive_files)
        if not isinstance(self.answers, CampaignAnswers):
            return found
        from .device_verdict import with_verdicts

        return with_verdicts(found, self.answers, self.limits)

    @cached_property
    def first_diagnosis(self) -> DiagnosisAnswer:
        """What the given model lacks, without a separating record."""
        return self.answers.first_diagnosis(as_diagnosis(self.problem, self.ladder.selection, self.answers.rules))

    @property
    def candidates(self) -> pd.DataFrame:
        """One row per effect that the given model lacks, the most significant first."""
        return tables.candidates_table(self.first_diagnosis.candidates)

    @property
    def table(self) -> pd.DataFrame:
        """One row per rung: errors, theta [deg], split [Hz], verdict."""
        return tables.ladder_table(self.answer.ladder)

    @property
    def parameters(self) -> pd.DataFrame:
        """One row per parameter of the last model: value, sd, unit."""
        return tables.parameters_table(self.answer.parameters or {}, self.problem.model, self.effects)

    @property
    def where(self) -> pd.DataFrame:
        """Where the given model fails, and how much of that the last one explains."""
        return tables.where_table(self.answer.regions)

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """The ladder, and where the given model fails."""
        return self.table, self.where
