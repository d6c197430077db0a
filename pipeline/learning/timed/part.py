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
from ...criticism.problem import Region, ResidualBlock, Signatures
from ...criticism.regression import Term
from ...device.model import Model
from ...errors import ConfigError, MeasurementError
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit, campaign_fit
from ...inference.general.free_states import free_start, settled
from ...inference.general.gauss_newton import CLOSE, PATIENCE, GaussNewtonResult
from ...inference.general.linear_step import FitPoint
from ...inference.general.residuals import CampaignResiduals, Task, Tasks
from ...inference.general.scales import top_hz
from ...inference.general.starts import excited_band, find_start
from ..campaign.rows import FourierRows, block_of, coordinate_jacobian, spectra_of, strata_of
from ..campaign.signatures import probe_signatures
from ..joint.part import PartNoise, RecordLeft, Values
from ..where.partition import CampaignPartition, campaign_partition, record_partitions
from ..where.regions import misfit_regions, structure_regions

#: Stages that are not candidates here: lines have free amplitudes in every record, and a converter has no slope.
_OTHERS = frozenset({"disturbance", "adc"})
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
    _states: dict[str, FloatArray] = field(default_factory=dict)
    _partition: list[CampaignPartition] = field(default_factory=list)
    _fits: dict[tuple[tuple[str, float], ...], CampaignFit] = field(default_factory=dict)

    kind = "time"

    @property
    def noise(self) -> PartNoise:
        """Of the samples."""
        own = self.level
        return PartNoise(tuple(own.sigma_v.tolist()), own.source, own.dof, own.known, own.independent)

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """The fitted records, then those held out."""
        return (*self.campaign.with_role("fit"), *self.campaign.with_role("validate"))

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
        problem, found = self._residuals(self.model), []
        for record, transform in zip(self.records, self.spectra):
            task = problem.task(record, self.model.complete(values))
            rows = transform(problem.whiten(record.sense_v, task))
            free = (task.basis.shape[1] - 1) * record.sense_v.shape[1] + 2 * task.coordinates
            found.append(block_of(record, self.campaign, rows, free))
        return tuple(found)

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """Those that a record shows without amplitudes of its own."""
        library = self.model.library
        return tuple(name for name in self.model.candidates() if not set(library[name].stages) & _OTHERS)

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
        problem, tasks, starts, complete = self._at(values)
        predicted = problem.predictions(complete, tasks, starts)
        every = zip(predicted, tasks.each, self.spectra)
        return tuple(transform(problem.whiten(y, task)) for y, task, transform in every)

    def slopes(self, values: Values, names: Sequence[str], sizes: Values) -> list[FloatArray]:
        """As in a fit of these records alone; of a parameter that they do not have zero."""
        out = [np.zeros((block.residual.size, len(names))) for block in self.measured]
        own = [name for name in names if name in self.full.by_name]
        if not own:
            return out
        problem, tasks, starts, complete = self._at(values, own)
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
        problem, _, _, _ = self._at(values)
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
        key = tuple(sorted((name, value) for name, value in values.items() if name in self.full.by_name))
        if key not in self._fits:
            self._fits[key] = self._fit_at(values)
        return self._fits[key]

    def _fit_at(self, values: Values) -> CampaignFit:
        problem, tasks, starts, complete = self._at(values)
        count = len(self.records) - self.held
        fitted = Tasks(tasks.each[:count], problem.tasks(self.records[:count], complete).groups)
        predicted = tuple(problem.predictions(complete, fitted, starts[:count]))
        residuals = tuple(problem.residuals_of(predicted, fitted))
        x = problem.model.to_internal(complete)
        chi2 = sum(float(np.vdot(r, r)) for r in residuals)
        at = FitPoint(x, tuple(starts[:count]), predicted, residuals, chi2)
        return campaign_fit(problem, self.campaign, self.level, fitted, GaussNewtonResult(at, np.eye(x.size), (), True))

    def _residuals(self, model: Model) -> CampaignResiduals:
        return CampaignResiduals(model, self.campaign, self.level)

    def _at(
        self, values: Values, names: Sequence[str] = ()
    ) -> tuple[CampaignResiduals, Tasks, list[FloatArray | None], dict[str, float]]:
        """Residuals, records, initial states and parameters of a device with the effects that act or are named.

        With ``names`` only these parameters are free, so that no slope is computed in vain.
        """
        library, absent = self.model.library, set(self.full.effects) - set(self.model.effects)
        shape, model = self.full.built.shape, self.model
        for name in sorted(absent):
            every = {library[name].full_name(m): m.null for m in library[name].members(shape) if not m.grid}
            scanned = any(library[name].full_name(m) in names for m in library[name].members(shape))
            if scanned or any(values.get(full, null) != null for full, null in every.items()):
                model = model.with_effect(name)
        complete = model.complete({name: values[name] for name in model.by_name if name in values})
        if not model.allowed(complete):
            raise ConfigError("a parameter is out of its range", next_step="see gyroscreen effects")
        if names:
            plant = {p.name for p in model.built.parameters}
            kept = set(names) | (plant if plant & set(names) else set())
            others = {name: value for name, value in complete.items() if name not in kept}
            model = replace(model, fixed={**others, **self.model.fixed}, prior={})
        problem = self._residuals(model)
        tasks = problem.tasks(self.records, complete)
        return problem, tasks, [self._state(problem, complete, task) for task in tasks.each], complete

    def _state(self, problem: CampaignResiduals, complete: dict[str, float], task: Task) -> FloatArray | None:
        """The initial state of a record, from that of the values before."""
        if not task.coordinates:
            return None
        known = self._states.get(task.record.name)
        if known is None or known.size != 2 * task.coordinates:
            found = free_start(problem, complete, task)
        else:
            found = settled(problem, complete, task, known, PATIENCE)
        assert found is not None
        self._states[task.record.name] = found
        return found
