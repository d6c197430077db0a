"""The answers of compare, diagnose and refine for sweeps and frequency responses.

Without a declared noise and without repeated passes, errors in units of the noise are not given; see ``experiment.noise.tones``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from msgspec import structs

from ...criticism.fit_tests import Rules
from ...criticism.ladder import Diagnosis, Ladder
from ...criticism.problem import FitResult
from ...device.model import DEFAULT_COMPARE_MODEL, Model
from ...errors import MeasurementError
from ...experiment.noise.tones import tone_noise
from ...experiment.tones import ToneCampaign
from ..answers import ComparisonAnswer, DiagnosisAnswer, Noise, RecordErrors, RefinementAnswer
from ..common import RegressionAnswers, diagnosis_answer, misfit, refinement_answer
from ..modal.terms import GAUGES
from ..next_experiment.separating import Proposal
from ..where.regions import FAMILIES, FREQUENCY_KINDS, by_kind, explained_by_kind, remaining_shares, significant_places
from .problem import ToneProblem


def tone_answers(campaign: ToneCampaign, model: Model = DEFAULT_COMPARE_MODEL) -> ToneAnswers:
    """Prepare the answers for a campaign of sweeps and frequency responses; where no record has the role "fit", all have.

    Raises
    ------
    MeasurementError : too few rows for the modes or for the noise level; time records beside the sweeps.
    """
    if campaign.timed is not None:
        raise MeasurementError(
            "records in time and in frequency cannot be fitted together yet",
            value=campaign.device_id,
            allowed="a campaign of sweeps and frequency responses, or one of time records",
            next_step="divide campaign.toml in two",
        )
    if not campaign.with_role("fit"):
        campaign = replace(campaign, records=tuple(replace(r, role="fit") for r in campaign.records))
    return ToneAnswers(ToneProblem(campaign, model, tone_noise(campaign.records)))


@dataclass(frozen=True, eq=False)
class ToneAnswers(RegressionAnswers[ToneProblem]):
    """Answers about one campaign; the fits are kept by ``problem``."""

    @property
    def rules(self) -> Rules:
        """Those of a campaign."""
        return Rules()

    @cached_property
    def comparison(self) -> ComparisonAnswer:
        """How well the given model explains the records, and where it fails."""
        fit = self.fitted()
        if not fit.ok:
            return ComparisonAnswer(error={}, relative_error={}, where=(), parameters={}, fit_ok=False, why=fit.why)
        roles = ("fit", "validate")
        error = {role: fit.error_of(role) for role in roles}
        regions = self.problem.rows.misfit_regions(fit)
        where = significant_places(regions, self.problem.noise.dof)
        return ComparisonAnswer(
            error=error,
            relative_error={role: fit.relative_error.get(role) for role in roles},
            misfit={role: misfit(value) for role, value in error.items()},
            noise=self.noise,
            where=where,
            where_by_kind=significant_places(by_kind(regions), self.problem.noise.dof),
            where_rest=remaining_shares(where),
            where_families={name: FREQUENCY_KINDS if name == "frequency" else (name,) for name in FAMILIES},
            records=self._records(fit),
            parameters={**fit.parameters, **fit.derived},
            fit_ok=True,
        )

    def diagnosis(
        self, found: Diagnosis, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> DiagnosisAnswer:
        """What the given model lacks; ``proposals`` are none."""
        answer = diagnosis_answer(found)
        gauges = GAUGES if self.problem.model.plant.kind == "gyro" else ()
        if not found.fit.ok:
            return answer
        return structs.replace(answer, invisible=(*answer.invisible, *self.problem.unseen, *gauges), noise=self.noise)

    def refinement(
        self, ladder: Ladder, proposals: Sequence[Proposal] = (), drive_files: bool = False
    ) -> RefinementAnswer:
        """The ladder; ``proposals`` are none."""
        answer = refinement_answer(ladder)
        if not ladder.rungs:
            return answer
        rows, dof = self.problem.rows, self.problem.noise.dof
        fits = [self.fitted(rung.terms) for rung in ladder.rungs]
        first, last = (rows.misfit_regions(fit) for fit in (fits[0], self.fitted(ladder.terms)))
        kinds = [place.kind for place in self.comparison.where_by_kind or ()]
        return structs.replace(
            answer,
            ladder=tuple(
                structs.replace(
                    rung,
                    explained_by_kind=explained_by_kind(first, rows.misfit_regions(fit), kinds),
                    error_v={name: errors.error_v for name, errors in self._records(fit).items()},
                    relative_error_validate=fit.relative_error.get("validate"),
                )
                for rung, fit in zip(answer.ladder, fits)
            ),
            regions=significant_places(first, dof, last),
            regions_by_kind=significant_places(by_kind(first), dof, by_kind(last)),
            noise=self.noise,
        )

    @property
    def noise(self) -> Noise:
        """sd [V] of X and of Y by channel, rms over all rows, and where it comes from."""
        noise = self.problem.noise
        from_ = noise.source if noise.independent else "residual"
        plain = Noise(sigma=tuple(noise.sigma_v.tolist()), from_=from_)
        return structs.replace(plain, local_fit=True) if noise.source == "local" else plain

    def _records(self, fit: FitResult) -> dict[str, RecordErrors]:
        """Role and errors of each record."""
        found = {}
        predicted = self.problem.predicted(fit)
        for record, y, sd in zip(self.problem.campaign.records, predicted, self.problem.noise.sd_v):
            left = record.sense_v - y
            whitened = float(np.sqrt(np.mean(np.abs(left / sd) ** 2) / 2.0))
            size = float(np.sqrt(np.mean(np.abs(record.sense_v) ** 2)))
            rms = float(np.sqrt(np.mean(np.abs(left) ** 2)))
            given = whitened if fit.error_given else None
            found[record.name] = RecordErrors(str(record.role), given, rms, rms / max(size, 1e-300))
        return found
