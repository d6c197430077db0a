"""A campaign of several domains, one of which is time, as a ``Problem`` of criticism.

Records in time bring what the other domains do not have: disturbances, whose amplitudes are free in every record and channel, and
differences from each other, for which they are corrected (``campaign.records_differ``).  Both act on their own rows alone.  A
disturbance is projected out of the rows, so that a fit with it has rows of its own.

Shapes: block b (n_b, m_b).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ...arrays import FloatArray
from ...criticism.fit_tests import Rules
from ...criticism.problem import FitResult, Signatures
from ...criticism.selection import ForwardSelection
from ...criticism.verdict import TermClass
from ...device.model import Model
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign
from ...experiment.tones import ToneCampaign
from ...inference.general.fit import CampaignFit
from ...inference.general.variation import RecordVariation
from ...inference.screening.dependent_noise import DependentNoise
from ..campaign.curved import corrected_beside, curved_terms, spread_starts, trigger_offset
from ..campaign.records_differ import prepared, selected
from ..next_experiment.separating import Proposal, separating_record
from ..timed.part import TimePart
from .part import Part
from .parts import parts_of
from .problem import JointProblem
from .rows import JointRows


def joint_problem(campaign: ToneCampaign, model: Model) -> JointProblem:
    """The problem of a campaign whose records are not all in the time domain; where those in time differ, corrected for that.

    Raises
    ------
    ConfigError, MeasurementError : as of ``parts_of``.
    """
    first, *others = parts_of(campaign, model)
    if isinstance(first, TimePart):
        return prepared(MixedProblem(first, tuple(others), first.campaign))
    return JointProblem((first, *others))


class MixedProblem(JointProblem):
    """The problem of a campaign with records in the time domain.

    Parameters
    ----------
    time : the part of these records.
    others : the other parts.
    measured : the records in time as they were measured.
    variation : for which those of ``time`` were corrected, if they differ.
    dependent : noise that depends on the signal and is contained in the noise of ``time``, if any.
    curved_starts : full name -> start value of parameters of curved terms, beside which the records were corrected.
    """

    #: Records that are integrated in parallel.
    threads = 1

    def __init__(
        self,
        time: TimePart,
        others: tuple[Part, ...],
        measured: Campaign,
        variation: RecordVariation | None = None,
        dependent: DependentNoise | None = None,
        curved_starts: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__((time, *others))
        self.time, self.others, self.measured = time, others, measured
        self.variation, self.dependent, self.curved_starts = variation, dependent, dict(curved_starts or {})
        self._rows: dict[frozenset[str], JointRows] = {}

    @property
    def campaign(self) -> Campaign:
        """The records in time, corrected where they differ."""
        return self.time.campaign

    @property
    def noise(self) -> NoiseLevel:
        """Of the records in time."""
        return self.time.level

    def with_records(
        self,
        campaign: Campaign,
        noise: NoiseLevel,
        corrected: tuple[Campaign, RecordVariation] | None = None,
        dependent: DependentNoise | None = None,
        curved_starts: Mapping[str, float] | None = None,
    ) -> MixedProblem:
        """The problem with other records in time; ``corrected`` are the measured ones and their variation."""
        time = TimePart(self.time.model, self.time.full, campaign, noise)
        measured, variation = (campaign, None) if corrected is None else corrected
        return MixedProblem(time, self.others, measured, variation, dependent, curved_starts)

    def selected(self, rules: Rules) -> tuple[MixedProblem, ForwardSelection]:
        """The selection of effects, repeated with the variation of the records in time where they differ."""
        return selected(self, rules)

    def proposal(self, terms: Sequence[str], found: TermClass) -> Proposal | None:
        """The record in time that would separate the members of a class beside ``terms``; none where no record is driven."""
        driven = any(np.any(record.drive_v) for record in self.time.beside.fitted)
        return separating_record(self, terms, found) if driven else None

    @cached_property
    def curved(self) -> frozenset[str]:
        """As of ``curved.curved_terms``."""
        return curved_terms(self.model, self.variation)

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that do not change these records."""
        return tuple(name for name in super().unseen if name not in self.time.disturbances)

    def rows_of(self, terms: Sequence[str], start: FitResult | None = None) -> JointRows:
        """The rows without the disturbances among ``terms``, in the shape that the residuals of the first such fit support."""
        own = frozenset(terms) & frozenset(self.time.disturbances)
        if own not in self._rows:
            values, time = self._at_null if start is None else self.values(start), self.time
            for name in sorted(own):
                time = time.with_disturbance(name, values)
            self._rows[own] = replace(self.rows, parts=(time, *self.rows.parts[1:])) if own else self.rows
        return self._rows[own]

    def time_of(self, terms: Sequence[str]) -> TimePart:
        """The records in time beside the disturbances among ``terms``."""
        part = self.rows_of(terms).parts[0]
        assert isinstance(part, TimePart)
        return part

    def campaign_fit(self, terms: Sequence[str]) -> CampaignFit:
        """The records in time beside the fit with these terms, which ``fit`` made before."""
        fit = self._fits[frozenset(terms)]
        return self.time_of(terms).fit_at(self.values(fit))

    def fitted_names(self, fit: FitResult) -> tuple[str, ...]:
        """All parameters but the shapes of disturbances."""
        own = (term for term in fit.terms if term in self.time.disturbances)
        shapes = {name for term in own for name in self.model.parameters_of(term)}
        return tuple(name for name in fit.parameters if name not in shapes)

    def signatures(self, fit: FitResult) -> Signatures:
        """Those of all parts, and disturbances of the records in time."""
        local = self.time_of(fit.terms).disturbance_candidates(self.values(fit))
        beside = corrected_beside(self.model, self.curved, self.curved_starts)
        return replace(super().signatures(fit), local=local, curved=self.curved, beside=beside)

    def _best(self, terms: tuple[str, ...], start: FitResult | None) -> FitResult:
        """The fit; a curved term begins beside its null, where chi2 has no slope, and at the null if that ends higher."""
        if start is None:
            return super()._best(terms, start)
        begins = {**spread_starts(self.model, terms, self.curved, self.variation), **self.curved_starts}
        missing = {name: (value, 0.0) for name, value in begins.items() if name not in start.parameters}
        best = super()._best(terms, replace(start, parameters={**start.parameters, **missing}))
        if not missing or best.chi2 <= start.chi2:
            return best
        again = super()._best(terms, start)
        return again if again.ok and again.chi2 < best.chi2 else best

    def _completed(self, fit: FitResult) -> FitResult:
        """The fit with the shapes of its disturbances, and columns of what nothing determines, which tests project out."""
        found, own = super()._completed(fit), [term for term in fit.terms if term in self.time.disturbances]
        if not found.jacobian:
            return found
        time = self.time_of(fit.terms)
        shapes = {
            name: (time.model.fixed[name], 0.0) for term in own for name in sorted(time.model.parameters_of(term))
        }
        none: dict[str, tuple[()]] = dict.fromkeys(own, ())
        return replace(
            found,
            parameters={**found.parameters, **shapes},
            columns={**found.columns, **none},
            shifts={**found.shifts, **none},
            jacobian=self._with_offset(found, time),
        )

    def _with_offset(self, fit: FitResult, time: TimePart) -> tuple[FloatArray, ...]:
        """The Jacobian with the column of a start shift common to all records in time, where their starts differ."""
        beside = time.fit_at(self.values(fit))
        problem, records = time.beside.residuals(beside.model), time.beside.fitted
        offset = trigger_offset(problem, beside, records, self.variation)
        if not offset:
            return fit.jacobian
        pairs = zip(offset, time.spectra, records)
        own = [transform.columns(column, record.sense_v.shape[1]) for column, transform, record in pairs]
        others = [np.zeros((block.shape[0], 1)) for block in fit.jacobian[len(own) :]]
        return tuple(np.concatenate(both, axis=1) for both in zip(fit.jacobian, (*own, *others)))
