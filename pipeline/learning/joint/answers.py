"""The answers of compare, diagnose and refine for campaigns whose records are not all in the time domain.

Errors in units of the noise are given where the noise of every part was measured on other data than its rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from msgspec import UNSET, UnsetType, structs

from ...criticism.fit_tests import Rules
from ...criticism.ladder import Diagnosis, Ladder
from ...criticism.problem import FitResult
from ...criticism.selection import ForwardSelection
from ...criticism.verdict import TermClass
from ...device.model import DEFAULT_COMPARE_MODEL, Model
from ...experiment.tones import ToneCampaign
from ..answers import ComparisonAnswer, DiagnosisAnswer, JumpRows, Noise, RecordErrors, RecordsDiffer, RefinementAnswer
from ..campaign.answers import separating_text
from ..campaign.variation_text import records_differ_answer
from ..common import GAUGES, RegressionAnswers, diagnosis_answer, misfit, refinement_answer
from ..next_experiment.separating import Proposal
from ..where.regions import FAMILIES, FREQUENCY_KINDS, by_kind, explained_by_kind, remaining_shares, significant_places
from .mixed import joint_problem
from .problem import JointProblem


def joint_answers(campaign: ToneCampaign, model: Model = DEFAULT_COMPARE_MODEL) -> JointAnswers:
    """Prepare the answers for a campaign; where no record has the role "fit", all have.

    Raises
    ------
    MeasurementError : too few rows for the modes or for the noise level.
    """
    return JointAnswers(joint_problem(campaign.with_fit_records(), model))


@dataclass(frozen=True, eq=False)
class JointAnswers(RegressionAnswers[JointProblem]):
    """Answers about one campaign; the fits are kept by ``problem``."""

    @property
    def rules(self) -> Rules:
        """Those of a campaign."""
        return Rules()

    def selected(self, rules: Rules) -> tuple[JointAnswers, ForwardSelection]:
        """The selection of effects, and the answers on whose problem it was made."""
        problem, selection = self.problem.selected(rules)
        return (self if problem is self.problem else JointAnswers(problem)), selection

    def proposals(self, terms: Sequence[str], classes: Sequence[TermClass]) -> tuple[Proposal, ...]:
        """For every class of several effects the record in time that separates it best; ``terms`` are in the fit."""
        found = (self.problem.proposal(terms, one) for one in classes if len(one.members) > 1)
        return tuple(one for one in found if one is not None)

    @property
    def records_differ(self) -> RecordsDiffer | UnsetType:
        """How the records in time differ, where that was found."""
        return UNSET if self.problem.variation is None else records_differ_answer(self.problem.variation)

    @property
    def jumps(self) -> tuple[JumpRows, ...] | UnsetType:
        """Rows of sweeps beside a jump, where there are any."""
        every = [jump for part in self.problem.parts for jump in part.jumps]
        return tuple(JumpRows(j.record, (j.first_hz, j.last_hz), j.rows) for j in every) or UNSET

    @cached_property
    def comparison(self) -> ComparisonAnswer:
        """How well the given model explains the records, and where it fails."""
        fit = self.fitted()
        if not fit.ok:
            return ComparisonAnswer(error={}, relative_error={}, where=(), parameters={}, fit_ok=False, why=fit.why)
        roles = ("fit", "validate")
        error = {role: fit.error_of(role) for role in roles}
        regions = self.problem.misfit_regions(fit)
        where = significant_places(regions, self.problem.noise_dof)
        return ComparisonAnswer(
            error=error,
            relative_error={role: fit.relative_error.get(role) for role in roles},
            misfit={role: misfit(value) for role, value in error.items()},
            noise=self.noise,
            records_differ=self.records_differ,
            jumps=self.jumps,
            where=where,
            where_by_kind=significant_places(by_kind(regions), self.problem.noise_dof),
            where_rest=remaining_shares(where),
            where_families={name: FREQUENCY_KINDS if name == "frequency" else (name,) for name in FAMILIES},
            records=self._records(fit),
            parameters={**fit.parameters, **fit.derived},
            fit_ok=True,
        )

    def diagnosis(
        self, found: Diagnosis, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> DiagnosisAnswer:
        """What the given model lacks; arguments as of ``CampaignAnswers.diagnosis``."""
        answer = diagnosis_answer(found)
        gauges = GAUGES if self.problem.model.plant.kind == "gyro" else ()
        if not found.fit.ok:
            return answer
        return structs.replace(
            answer,
            invisible=(*answer.invisible, *self.problem.unseen, *gauges),
            noise=self.noise,
            records_differ=self.records_differ,
            jumps=self.jumps,
            separating_record=separating_text(proposals, drive_files),
        )

    def refinement(
        self, ladder: Ladder, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> RefinementAnswer:
        """The ladder; arguments as of :meth:`diagnosis`."""
        answer = refinement_answer(ladder)
        if not ladder.rungs:
            return answer
        dof = self.problem.noise_dof
        fits = [self.fitted(rung.terms) for rung in ladder.rungs]
        first, last = (self.problem.misfit_regions(fit) for fit in (fits[0], self.fitted(ladder.terms)))
        kinds = [place.kind for place in self.comparison.where_by_kind or ()]
        return structs.replace(
            answer,
            ladder=tuple(
                structs.replace(
                    rung,
                    explained_by_kind=explained_by_kind(first, self.problem.misfit_regions(fit), kinds),
                    error_v={name: errors.error_v for name, errors in self._records(fit).items()},
                    relative_error_validate=fit.relative_error.get("validate"),
                )
                for rung, fit in zip(answer.ladder, fits)
            ),
            regions=significant_places(first, dof, last),
            regions_by_kind=significant_places(by_kind(first), dof, by_kind(last)),
            noise=self.noise,
            records_differ=self.records_differ,
            jumps=self.jumps,
            separating_record=separating_text(proposals, drive_files),
        )

    @property
    def noise(self) -> Noise:
        """The noise of the first part by channel, from the weakest source of all; that of each part where there are several."""
        parts = [part.noise for part in self.problem.parts]
        weakest = min(parts, key=lambda own: (own.independent, own.known))
        dependent = {} if self.problem.dependent is None else self.problem.dependent.columns()
        return Noise(
            sigma=parts[0].sigma_v,
            from_=weakest.source if weakest.independent else "residual",
            local_fit=True if weakest.source == "local" else UNSET,
            jitter_s=dependent.get("jitter_s", UNSET),
            gain_noise=dependent.get("gain_noise", UNSET),
            parts={part.kind: part.noise.sigma_v for part in self.problem.parts} if len(parts) > 1 else UNSET,
        )

    def _records(self, fit: FitResult) -> dict[str, RecordErrors]:
        """Role and errors of each record."""
        return {
            one.name: RecordErrors(
                one.role,
                one.error if fit.error_given else None,
                float(np.sqrt(one.left)),
                float(np.sqrt(one.left / max(one.power, 1e-300))),
            )
            for one in self.problem.left(fit)
        }
