"""Records in the time domain as a part of a campaign: the whitened Fourier coefficients of their samples.

    d block / d p = (1 - F (F^T F)^-1 F^T) J        F: columns of the initial state of a record that does not start at rest

Initial states are free: they are fitted to each record, at every parameter, and projected out of the columns.

Shapes: N samples, S senses, F bins; blocks (2 F, S) as in ``campaign.rows``; n coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import LocalCandidate, Region, ResidualBlock, Signatures
from ...criticism.regression import Term
from ...device.model import Model
from ...errors import MeasurementError
from ...experiment.forward.clip_levels import clip_levels
from ...experiment.jumps import Jump
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit
from ...inference.general.free_disturbances import best_shape
from ...inference.general.gauss_newton import CLOSE
from ...inference.general.scales import top_hz
from ...inference.general.starts import excited_band, find_start
from ..campaign.probes import probe_signatures
from ..campaign.rows import FourierRows, block_of, coordinate_jacobian, spectra_of, strata_of
from ..campaign.signatures import disturbance_candidate
from ..joint.part import PartNoise, RecordLeft, Values
from ..where.partition import CampaignPartition, campaign_partition, record_partitions
from ..where.regions import misfit_regions, structure_regions
from .records import TimedRecords

#: Points of the grid of an additional mode.
_POINTS = 12


@dataclass(frozen=True, eq=False)
class TimePart:
    """The records of a campaign in the time domain.

    Parameters
    ----------
    model : the given one, at the scale of the campaign.
    full : with every term.
    campaign : its records, without bad samples.
    level : noise level.
    """

    model: Model
    full: Model
    campaign: Campaign
    level: NoiseLevel
    _partition: list[CampaignPartition] = field(default_factory=list)

    kind = "time"

    @property
    def noise(self) -> PartNoise:
        """Of the samples."""
        own = self.level
        return PartNoise(tuple(own.sigma_v.tolist()), own.source, own.dof, own.known, own.independent)

    @cached_property
    def beside(self) -> TimedRecords:
        """The records beside a device."""
        return TimedRecords(self.model, self.full, self.campaign, self.level)

    @property
    def records(self) -> tuple[Record, ...]:
        """The fitted records, then those held out."""
        return self.beside.each

    @property
    def jumps(self) -> tuple[Jump, ...]:
        """None: these are no sweeps."""
        return ()

    @property
    def held(self) -> int:
        """Records held out."""
        return len(self.campaign.with_role("validate"))

    @cached_property
    def spectra(self) -> tuple[FourierRows, ...]:
        """The transform of each record."""
        top = top_hz(self.records[: len(self.records) - self.held] or self.records)
        return tuple(spectra_of(record, top) for record in self.records)

    @cached_property
    def strata(self) -> tuple[IntArray, ...]:
        """By channel and octave."""
        count = len(self.records) - self.held
        return tuple(strata_of(s, r.sense_v.shape[1]) for r, s in zip(self.records[:count], self.spectra))

    @cached_property
    def measured(self) -> tuple[ResidualBlock, ...]:
        """The records."""
        values = {**{name: p.null for name, p in self.model.by_name.items()}, **self.plant_start()}
        problem, found = self.beside.residuals(self.model), []
        for record, transform in zip(self.records, self.spectra):
            task = problem.task(record, self.model.complete(values))
            rows = transform(problem.whiten(record.sense_v, task))
            free = (task.basis.shape[1] - 1) * record.sense_v.shape[1] + 2 * task.coordinates
            found.append(block_of(record, self.campaign, rows, free))
        return tuple(found)

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """All that have no amplitudes in every record."""
        return tuple(name for name in self.model.candidates() if name not in self.disturbances)

    @cached_property
    def disturbances(self) -> tuple[str, ...]:
        """Absent effects with free amplitudes in every record and channel."""
        return tuple(name for name in self.model.candidates() if self.model.library[name].disturbance is not None)

    @cached_property
    def levels(self) -> dict[str, tuple[float, ...]]:
        """Shares of the largest sample."""
        shape, found = self.model.built.shape, dict[str, tuple[float, ...]]()
        for name in self.effects:
            effect = self.model.library[name]
            levels = clip_levels(effect, shape, self.beside.fitted)
            found |= {effect.full_name(m): levels[m.name] for m in effect.members(shape) if m.name in levels}
        return found

    @property
    def refused(self) -> tuple[str, ...]:
        """None."""
        return ()

    @property
    def ranged(self) -> tuple[str, ...]:
        """All."""
        return tuple(self.full.by_name)

    @property
    def own_terms(self) -> tuple[Term, ...]:
        """None."""
        return ()

    @cached_property
    def _plant(self) -> dict[str, float]:
        fitted = self.campaign.with_role("fit") or self.records
        return find_start(self.model, fitted, self.campaign.instrument, self.level.sigma_v)

    @property
    def shows_gains(self) -> int:
        """2 where a record is driven, else 0."""
        return 2 if any(np.any(record.drive_v) for record in self.campaign.with_role("fit")) else 0

    def plant_start(self) -> dict[str, float]:
        """From the spectra of the records."""
        return dict(self._plant)

    def own_start(self, values: Values) -> dict[str, float]:
        """None: initial states are fitted at every parameter."""
        return {}

    def fixed(self) -> dict[str, float]:
        """None."""
        return {}

    def sizes(self, names: Sequence[str], values: Values) -> dict[str, float]:
        """The scale of each parameter at the scale of the records; steps are chosen anew where slopes are computed."""
        shape = self.full.built.shape
        found: dict[str, float] = {}
        for name in names:
            effect = self.full.library[name]
            if name in self.effects:
                found |= {effect.full_name(m): m.scale for m in effect.members(shape) if not m.grid}
        return found

    def even_parameters(self, sizes: Values, values: Values) -> frozenset[str]:
        """None: harmonics show every sign."""
        return frozenset()

    def with_full(self, full: Model) -> TimePart:
        """The part for the model with every term."""
        return replace(self, full=full)

    def with_even(self, even: frozenset[str]) -> TimePart:
        """The same: no parameter of these records is even."""
        return self

    def mode_grid(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Within the band in which the records move."""
        try:
            low, high = excited_band(self.campaign.with_role("fit") or self.records)
        except MeasurementError:
            return (), ()
        step = (high - low) / _POINTS
        return tuple(np.linspace(low, high, _POINTS).tolist()), (step / (low + high),)

    def predict(self, values: Values) -> tuple[FloatArray, ...]:
        """The records of a device, each from the initial state that explains it best."""
        problem, tasks, starts, complete = self.beside.at(values)
        predicted = problem.predictions(complete, tasks, starts)
        every = zip(predicted, tasks.each, self.spectra)
        return tuple(transform(problem.whiten(y, task)) for y, task, transform in every)

    def slopes(self, values: Values, names: Sequence[str], sizes: Values) -> list[FloatArray]:
        """As in a fit of these records alone; of a parameter that they do not have zero."""
        out = [np.zeros((block.residual.size, len(names))) for block in self.measured]
        own = [name for name in names if name in self.full.by_name]
        if not own:
            return out
        problem, tasks, starts, complete = self.beside.at(values, own)
        model = problem.model
        first = next((task for task in tasks.each if np.any(task.record.drive_v)), tasks.each[0])
        start = starts[tasks.each.index(first)]
        steps = problem.steps(complete, first, start)
        exact = bool(problem.system(complete, first.group).forces) and problem.strength(complete, first, start) > CLOSE
        turn = coordinate_jacobian(model, complete)[:, [model.free.index(name) for name in own]]
        places = [names.index(name) for name in own]
        for k, columns in enumerate(problem.columns(complete, tasks, starts, exact, steps)):
            senses = self.records[k].sense_v.shape[1]
            rows = self.spectra[k].columns(columns, senses) @ turn
            state = starts[k]
            if state is not None:
                free = self.spectra[k].columns(problem.start_columns(complete, tasks.each[k], state, exact), senses)
                basis, size, _ = np.linalg.svd(
                    free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False
                )
                basis = basis[:, size > 1e-9 * size[0]]
                rows = rows - basis @ (basis.T @ rows)
            out[k][:, places] = rows
        return out

    def probes(self, values: Values) -> Signatures:
        """Shapes of the predicted records."""
        problem, _, _, _ = self.beside.at(values)
        count = len(self.records) - self.held
        return probe_signatures(problem, self.fit_at(values), self.records[:count], self.spectra)

    def regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """Resonances, harmonics, bands and windows of each record."""
        fit = self.fit_at(values)
        return structure_regions(fit, self.partition(fit).records) if fit.of_role("fit") else []

    def misfit_regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """By frequency, time, level, response, direction, channel and record."""
        fit = self.fit_at(values)
        conditions = {block.name: block.labels for block in self.measured}
        return misfit_regions(fit, self.partition(fit), conditions) if fit.of_role("fit") else []

    def partition(self, fit: CampaignFit) -> CampaignPartition:
        """The partition of the residual, from the first ``fit`` that asks; it is the same for all models."""
        if not self._partition:
            self._partition.append(campaign_partition(fit, record_partitions(self.campaign, fit)))
        return self._partition[0]

    def left(self, values: Values) -> list[RecordLeft]:
        """Of every driven record."""
        power = {record.name: float(np.mean(record.sense_v**2)) for record in self.records}
        return [
            RecordLeft(r.name, str(r.role), r.error, float(np.mean(r.rms_v**2)), power[r.name], r.residual.size)
            for r in self.fit_at(values).records
        ]

    def fit_at(self, values: Values) -> CampaignFit:
        """The records beside a device with ``values``, in the form of a fit; parameters have no sd of a fit."""
        return self.beside.fit_at(values)

    def disturbance_candidates(self, values: Values) -> tuple[LocalCandidate, ...]:
        """Absent disturbances, their amplitudes free in every record and channel, beside a device with ``values``."""
        fit = self.fit_at(values)
        found = (disturbance_candidate(fit, self.beside.fitted, name) for name in self.disturbances)
        return tuple(one for one in found if one is not None)

    def with_disturbance(self, name: str, values: Values) -> TimePart:
        """The part whose model has the disturbance ``name``, in the shape that the residuals at ``values`` support best."""
        fit, effect = self.fit_at(values), self.model.effect(name)
        residuals = [record.residual for record in fit.of_role("fit")]
        rates = [record.sample_rate_hz for record in self.beside.fitted]
        fixed = best_shape(effect, self.model.built.shape, residuals, rates)
        model, full = (
            replace(larger, fixed={**larger.fixed, **fixed})
            for larger in (self.model.with_effect(name), self.full.with_effect(name))
        )
        return TimePart(model, full, self.campaign, self.level)
