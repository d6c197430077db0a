"""The answers of compare, diagnose and refine for a campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from msgspec import structs

from ...criticism.fit_tests import Rules
from ...criticism.ladder import Diagnosis, Ladder, Rung
from ...criticism.problem import Region
from ...criticism.verdict import TermClass
from ...inference.general.fit import CampaignFit
from ..answers import ComparisonAnswer, DiagnosisAnswer, Noise, RecordErrors, RefinementAnswer, RungAnswer
from ..common import diagnosis_answer, refinement_answer
from ..modal.terms import GAUGES
from ..next_experiment.separating import Proposal, separating_record
from ..where.partition import CampaignPartition, campaign_partition
from ..where.regions import (
    FAMILIES,
    FREQUENCY_KINDS,
    by_kind,
    explained_by_kind,
    misfit_regions,
    remaining_shares,
    significant_places,
)
from .hold import hold_hint, hold_look_alikes
from .problem import CampaignProblem


@dataclass(frozen=True, eq=False)
class CampaignAnswers:
    """Answers about one campaign; the fits are kept by ``problem``."""

    problem: CampaignProblem

    @property
    def rules(self) -> Rules:
        """Where the noise level is unknown, held-out records test every effect: a diagnosis may name as many as a ladder."""
        rules = Rules()
        return rules if self._noise_known else replace(rules, max_named=rules.rungs)

    def fitted(self, terms: Sequence[str] = ()) -> CampaignFit:
        """The fit of the given model with ``terms``."""
        self.problem.fit(tuple(terms))
        return self.problem.campaign_fit(terms)

    def proposals(self, terms: Sequence[str], classes: Sequence[TermClass]) -> tuple[Proposal, ...]:
        """For every class the record that separates it best."""
        found = (separating_record(self.problem, terms, one) for one in classes if len(one.members) > 1)
        return tuple(one for one in found if one is not None)

    @cached_property
    def comparison(self) -> ComparisonAnswer:
        """How well the given model explains the campaign."""
        result = self.problem.fit(())
        if not result.ok:
            return ComparisonAnswer(error={}, relative_error={}, where=(), parameters={}, fit_ok=False, why=result.why)
        fit, known = self.fitted(), self._noise_known
        where = significant_places(self._first_regions, fit.noise.dof)
        return ComparisonAnswer(
            error={role: value if known else None for role, value in fit.error.items()},
            relative_error=dict(fit.relative_error),
            misfit={role: value if known else None for role, value in fit.misfit.items()},
            noise=self.noise,
            where=where,
            where_by_kind=significant_places(by_kind(self._first_regions), fit.noise.dof),
            where_rest=remaining_shares(where),
            where_families={name: FREQUENCY_KINDS if name == "frequency" else (name,) for name in FAMILIES},
            records={
                r.name: RecordErrors(str(r.role), r.error if known else None, fit.error_v[r.name], r.relative_error)
                for r in fit.records
            },
            parameters=dict(fit.parameters),
            fit_ok=fit.fit_ok,
        )

    def first_diagnosis(self, found: Diagnosis) -> DiagnosisAnswer:
        """A diagnosis without hints and without a separating record, which take long to compute."""
        answer = diagnosis_answer(found)
        gauges = GAUGES if self.problem.model.plant.kind == "gyro" else ()
        return structs.replace(answer, invisible=(*answer.invisible, *gauges))

    def diagnosis(self, found: Diagnosis, separating: str | None) -> DiagnosisAnswer:
        """What the given model lacks; ``separating`` is the text about the separating record."""
        after = found.fit_after
        return structs.replace(
            self.first_diagnosis(found),
            separating_record=separating,
            hints=() if after is None or not after.ok else self._hints(after.terms, found.verdict),
        )

    def refinement(self, ladder: Ladder, separating: str | None) -> RefinementAnswer:
        """The ladder; ``separating`` is the text about the separating record."""
        answer = refinement_answer(ladder, self.problem)
        if not ladder.rungs:
            return answer
        first, last = self._first_regions, self._regions(self.fitted(ladder.terms))
        noise_dof = self.problem.noise.dof
        return structs.replace(
            answer,
            ladder=tuple(self._rung(one, rung) for one, rung in zip(answer.ladder, ladder.rungs)),
            hints=self._hints(ladder.terms, ladder.verdict),
            separating_record=separating,
            regions=significant_places(first, noise_dof, last),
            regions_by_kind=significant_places(by_kind(first), noise_dof, by_kind(last)),
            noise=self.noise,
        )

    @property
    def noise(self) -> Noise:
        """sigma [V] of each channel, and where it comes from."""
        noise = self.problem.noise
        return Noise(sigma=tuple(noise.sigma_v.tolist()), from_=noise.source if self._noise_known else "residual")

    def _rung(self, answer: RungAnswer, rung: Rung) -> RungAnswer:
        fit = self.fitted(rung.terms)
        kinds = [place.kind for place in self.comparison.where_by_kind or ()]
        return structs.replace(
            answer,
            explained_by_kind=explained_by_kind(self._first_regions, self._regions(fit), kinds),
            error_v=fit.error_v,
            relative_error_validate=fit.relative_error["validate"],
        )

    @property
    def _noise_known(self) -> bool:
        return self.problem.noise.source != "local"

    @cached_property
    def _partition(self) -> CampaignPartition:
        """The partition of the residual follows from the first fit and is the same for all models."""
        return campaign_partition(self.fitted(), self.problem.partitions)

    @cached_property
    def _first_regions(self) -> list[Region]:
        return self._regions(self.fitted())

    def _regions(self, fit: CampaignFit) -> list[Region]:
        return misfit_regions(fit, self._partition, {block.name: block.labels for block in self.problem.fit(()).blocks})

    def _hints(self, terms: Sequence[str], verdict: str) -> tuple[str, ...]:
        """Whether another DAC hold would explain the records better; not asked where the model reaches a known noise level."""
        fit, left = self.fitted(terms), verdict in ("unknown", "fit_failed")
        if not hold_look_alikes(fit, self.problem.model.effects):
            if not left or (self._noise_known and self.problem.model.plant.kind == "gyro"):
                return ()
        elif not left and self._noise_known:
            return ()
        found = hold_hint(fit, self.problem.campaign, self.problem.model.effects)
        return () if found is None else (str(found),)
