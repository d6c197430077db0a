"""The answers of compare, diagnose and refine for a campaign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from msgspec import UNSET, UnsetType, structs

from ...criticism.fit_tests import Rules
from ...criticism.ladder import Diagnosis, Ladder, Rung
from ...criticism.problem import Problem, Region
from ...criticism.selection import ForwardSelection
from ...criticism.verdict import TermClass
from ...device.model import DEFAULT_COMPARE_MODEL, Model
from ...errors import MeasurementError
from ...experiment.bad_samples import without_bad_samples
from ...experiment.noise.level import noise_level
from ...experiment.record import Campaign
from ...inference.gate import Gate
from ...inference.general.fit import CampaignFit
from ...inference.general.goodness import campaign_status
from ...threads import usable_cores
from ..answers import (
    BadSamples,
    ComparisonAnswer,
    DiagnosisAnswer,
    Noise,
    RecordErrors,
    RecordsDiffer,
    RefinementAnswer,
    RungAnswer,
)
from ..common import GAUGES, bad_samples_of, diagnosis_answer, refinement_answer
from ..where.regions import (
    FAMILIES,
    FREQUENCY_KINDS,
    by_kind,
    explained_by_kind,
    remaining_shares,
    significant_places,
)
from .hold import hold_hint, hold_look_alikes
from .problem import CampaignProblem
from .records_differ import every_candidate, prepared, selected
from .variation_text import records_differ_answer

if TYPE_CHECKING:
    from ..next_experiment.separating import Proposal

#: What records without a drive leave open.
NO_FORCE = "the force: without a drive, modes, initial states and sizes of effects are in units of the sense signal"


def campaign_answers(
    campaign: Campaign, model: Model = DEFAULT_COMPARE_MODEL, threads: int | None = None
) -> CampaignAnswers:
    """Prepare the answers for a campaign: where repeats differ, the variation between the records; other fits come later.

    Parameters
    ----------
    campaign : with at least one record to fit.
    model : plant and effects to start from.
    threads : records examined, and signatures computed, at the same time; by default one per usable core.

    Raises
    ------
    MeasurementError : no record to fit, or too many bad samples.
    """
    if not campaign.with_role("fit"):
        raise MeasurementError(
            "no record to fit", value=campaign.device_id, next_step='give at least one record role = "fit"'
        )
    threads = threads or usable_cores()
    campaign = without_bad_samples(campaign, threads)
    problem = CampaignProblem(campaign, model, noise_level(campaign), threads)
    return CampaignAnswers(prepared(problem))


@dataclass(frozen=True, eq=False)
class CampaignAnswers:
    """Answers about one campaign; the fits are kept by ``problem``."""

    problem: CampaignProblem

    @property
    def rules(self) -> Rules:
        """Those of a campaign."""
        return Rules()

    def selected(
        self, rules: Rules, restricted: Callable[[CampaignProblem], Problem] = every_candidate
    ) -> tuple[CampaignAnswers, ForwardSelection]:
        """The selection of effects, and the answers on whose problem it was made; arguments as in ``records_differ.selected``."""
        problem, selection = selected(self.problem, rules, restricted)
        return (self if problem is self.problem else CampaignAnswers(problem)), selection

    def fitted(self, terms: Sequence[str] = ()) -> CampaignFit:
        """The fit of the given model with ``terms``, made where it has not been made before."""
        self.problem.fit(tuple(terms))
        return self.problem.campaign_fit(terms)

    def proposals(self, terms: Sequence[str], classes: Sequence[TermClass]) -> tuple[Proposal, ...]:
        """For every class of several effects the record that separates it best; ``terms`` are in the fit."""
        several = [one for one in classes if len(one.members) > 1]
        if not several:
            return ()
        # Few campaigns have a class.
        from ..next_experiment.separating import separating_record

        found = (separating_record(self.problem, terms, one) for one in several)
        return tuple(one for one in found if one is not None)

    @cached_property
    def comparison(self) -> ComparisonAnswer:
        """How well the given model explains the campaign: errors [sigma] by role and record, and where it fails."""
        result = self.problem.fit(())
        if not result.ok:
            return ComparisonAnswer(error={}, relative_error={}, where=(), parameters={}, fit_ok=False, why=result.why)
        fit, known = self.fitted(), self.problem.noise.independent
        where = significant_places(self._first_regions, fit.noise.dof)
        status, reason = campaign_status(fit, self.problem.campaign)
        return ComparisonAnswer(
            error={role: value if known else None for role, value in fit.error.items()},
            relative_error=dict(fit.relative_error),
            misfit={role: value if known else None for role, value in fit.misfit.items()},
            noise=self.noise,
            records_differ=self.records_differ,
            where=where,
            where_by_kind=significant_places(by_kind(self._first_regions), fit.noise.dof),
            where_rest=remaining_shares(where),
            where_families={name: FREQUENCY_KINDS if name == "frequency" else (name,) for name in FAMILIES},
            records={
                r.name: RecordErrors(str(r.role), r.error if known else None, fit.error_v[r.name], r.relative_error)
                for r in fit.records
            },
            parameters=dict(fit.parameters),
            bad_samples=self.bad_samples,
            fit_ok=fit.fit_ok,
            status=status,
            status_reason=UNSET if reason is None else reason,
        )

    def first_diagnosis(self, found: Diagnosis) -> DiagnosisAnswer:
        """A diagnosis without hints and without a separating record, which take long to compute."""
        answer = diagnosis_answer(found)
        plant = self.problem.model.plant
        gauges = GAUGES if plant.kind == "gyro" else () if plant.drives else (NO_FORCE,)
        return structs.replace(
            answer,
            invisible=(*answer.invisible, *gauges),
            noise=self.noise,
            records_differ=self.records_differ,
            bad_samples=self.bad_samples,
        )

    def diagnosis(self, found: Diagnosis, proposals: Sequence[Proposal], drive_files: bool) -> DiagnosisAnswer:
        """What the given model lacks.

        Parameters
        ----------
        found : the result of criticism.
        proposals : from :meth:`proposals`.
        drive_files : whether their drive files are written, so that the answer names them.
        """
        after = found.fit_after
        return structs.replace(
            self.first_diagnosis(found),
            separating_record=separating_text(proposals, drive_files),
            hints=() if after is None or not after.ok else self._hints(after.terms, found.verdict),
            noise_louder=UNSET if after is None or not after.ok else self._louder(after.terms, found.verdict),
        )

    def refinement(self, ladder: Ladder, proposals: Sequence[Proposal], drive_files: bool) -> RefinementAnswer:
        """The ladder; arguments as in :meth:`diagnosis`."""
        answer = refinement_answer(ladder)
        if not ladder.rungs:
            return answer
        first, last = self._first_regions, self.problem.misfit_regions(ladder.terms)
        noise_dof = self.problem.noise.dof
        return structs.replace(
            answer,
            ladder=tuple(self._rung(one, rung) for one, rung in zip(answer.ladder, ladder.rungs)),
            hints=self._hints(ladder.terms, ladder.verdict),
            noise_louder=self._louder(ladder.terms, ladder.verdict),
            separating_record=separating_text(proposals, drive_files),
            regions=significant_places(first, noise_dof, last),
            regions_by_kind=significant_places(by_kind(first), noise_dof, by_kind(last)),
            noise=self.noise,
            records_differ=self.records_differ,
            bad_samples=self.bad_samples,
        )

    @property
    def records_differ(self) -> RecordsDiffer | UnsetType:
        """How the records differ, where that was found."""
        return UNSET if self.problem.variation is None else records_differ_answer(self.problem.variation)

    @property
    def noise(self) -> Noise:
        """sigma [V] of each channel, and where it comes from: "residual" without a silent record and repeats."""
        noise = self.problem.noise
        dependent = {} if self.problem.dependent is None else self.problem.dependent.columns()
        return Noise(
            sigma=tuple(noise.sigma_v.tolist()),
            from_=noise.source if noise.independent else "residual",
            local_fit=True if noise.source == "local" else UNSET,
            coloured=True if noise.spectrum is not None and not noise.spectrum.white else UNSET,
            jitter_s=dependent.get("jitter_s", UNSET),
            gain_noise=dependent.get("gain_noise", UNSET),
        )

    @cached_property
    def bad_samples(self) -> tuple[BadSamples, ...]:
        """Stretches of bad samples of all records."""
        return bad_samples_of(self.problem.campaign.records)

    def _rung(self, answer: RungAnswer, rung: Rung) -> RungAnswer:
        fit = self.fitted(rung.terms)
        kinds = [place.kind for place in self.comparison.where_by_kind or ()]
        return structs.replace(
            answer,
            explained_by_kind=explained_by_kind(self._first_regions, self.problem.misfit_regions(rung.terms), kinds),
            error_v=fit.error_v,
            relative_error_validate=fit.relative_error["validate"],
        )

    @property
    def _noise_known(self) -> bool:
        return self.problem.noise.known

    @cached_property
    def _first_regions(self) -> list[Region]:
        return self.problem.misfit_regions(())

    def _louder(self, terms: Sequence[str], verdict: str) -> float | UnsetType:
        """The error of the fitted records where nothing is missing although the gate refuses it: then it is that of the noise."""
        error = self.fitted(terms).error["fit"]
        if (
            verdict in ("unknown", "fit_failed")
            or not self.problem.noise.independent
            or error is None
            or error <= Gate().error_max
        ):
            return UNSET
        return error

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


def separating_text(found: Sequence[Proposal], written: bool) -> str | None:
    """``separating_record`` of the JSON, with the names of the drive files if they are ``written``; ``None`` without a class."""
    if len(found) == 1:
        return found[0].text(written)
    return "; ".join(f"{' or '.join(one.members)}: {one.text(written)}" for one in found) or None
