"""Residuals of a campaign and their derivatives.

    residual = P (y - f(x)) / sigma

P projects out the nuisances, which are free in every record and channel (``nuisance_columns``).  Noise that is not white is
made white after that (``whitening``).

Shapes: R records of a drive group, N samples, S senses, P free parameters, L nuisances per channel, n coordinates of the
mechanics.  Records in volts; residuals and columns in sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.antialias import filter_poles
from ...experiment.forward.drive_groups import DriveGroup, drive_group_of, drive_groups_of
from ...experiment.forward.linear import free_response
from ...experiment.forward.response import Starts, converted, nonlinear_response, nonlinear_share, volts
from ...experiment.forward.sensitivity import (
    NonlinearColumns,
    channels_checked,
    group_jacobian,
    is_integrated,
    tuned_steps,
)
from ...experiment.forward.system import System, assemble, conditions_of
from ...experiment.instrument import Instrument
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record
from ...threads import mapped
from .masking import MaskedBasis, masked_basis
from .whitening import Whitening, common_signals, whitening_of


def nuisance_columns(model: Model, values: Mapping[str, float], record: Record, instrument: Instrument) -> FloatArray:
    """Orthonormal basis (N, L) [1] of the nuisances of ``record``: offset, lines, filter transient if not at rest."""
    samples = record.drive_v.shape[0]
    t = np.arange(samples) / record.sample_rate_hz
    columns = [np.ones((samples, 1))]
    complete = model.complete(values)
    system = assemble(model, complete, instrument, conditions_of(record, instrument, None))
    for effect in model.ordered_effects():
        if effect.disturbance is not None:
            p = np.array([complete[effect.full_name(m)] for m in effect.members(model.built.shape)])
            columns.append(effect.disturbance(t, p, system.context))
    if not record.at_rest and instrument.antialias is not None:
        q, _ = filter_poles(instrument.antialias)
        decay = np.exp(np.outer(t, q[q.imag >= 0.0]))
        columns.append(np.concatenate([decay.real, decay.imag], axis=1))
    stacked = np.concatenate(columns, axis=1)
    # A real pole has no sine.
    norms = np.linalg.norm(stacked, axis=0)
    scaled = stacked[:, norms > 0.0] / norms[norms > 0.0]
    gram = scaled.T @ scaled
    if np.max(np.abs(gram - np.eye(gram.shape[0]))) < 1e-12:
        return np.asarray(scaled)
    values_, vectors = np.linalg.eigh(gram)
    keep = values_ > 1e-10 * values_[-1]
    return np.asarray(scaled @ (vectors[:, keep] / np.sqrt(values_[keep])))


def start_step(columns: FloatArray, residual: FloatArray) -> FloatArray:
    """(F^T F)^-1 F^T r (2n,): the step of an initial state, from its columns (N S, 2n) and the residual (N, S) in sigmas."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    unit = columns / scale
    return np.asarray(
        np.linalg.pinv(unit.T @ unit, rcond=1e-12, hermitian=True) @ (unit.T @ residual.reshape(-1)) / scale
    )


@dataclass(frozen=True, eq=False)
class Task:
    """A record in a fit.

    Parameters
    ----------
    record : the record.
    basis : nuisance basis (N, L) [1].
    coordinates : number of coordinates with a free initial state; 0: at rest.
    group : its drive group.
    masked : the basis without bad samples; ``None`` where all samples are good.
    whitening : of noise that is not white.
    """

    record: Record
    basis: FloatArray
    coordinates: int
    group: DriveGroup
    masked: MaskedBasis | None = None
    whitening: Whitening = field(default_factory=Whitening)


@dataclass(frozen=True, eq=False)
class Tasks:
    """The records of a fit; ``groups`` gives the places of the records that share a drive group."""

    each: tuple[Task, ...]
    groups: tuple[tuple[tuple[int, ...], DriveGroup], ...]


class CampaignResiduals:
    """Residuals of a model on records of a campaign and their derivatives; stateless.

    Parameters
    ----------
    model : plant, effects, free parameters.
    campaign : instrument and angular gain.
    noise : sigma (S,) [V], and common signals in the noise of the records.
    threads : how many records are integrated at once.
    """

    def __init__(self, model: Model, campaign: Campaign, noise: NoiseLevel, threads: int = 1) -> None:
        self.threads = threads
        self.model, self.instrument, self.angular_gain = model, campaign.instrument, campaign.angular_gain
        self.noise = noise

    @property
    def sigma_v(self) -> FloatArray:
        """Noise (S,) [V] per sample."""
        return self.noise.sigma_v

    def task(self, record: Record, values: Mapping[str, float]) -> Task:
        """The record with its nuisance basis at complete ``values``.

        Raises
        ------
        MeasurementError : the plant has other numbers of channels.
        """
        channels_checked(self.model, record)
        basis = nuisance_columns(self.model, values, record, self.instrument)
        group = drive_group_of([record], self.instrument, self.angular_gain)
        coordinates = 0 if record.at_rest else self.system(values, group).mechanics.stiffness.shape[1]
        white = whitening_of(self.noise, record)
        task = Task(record, basis, coordinates, group, masked_basis(basis, record.good), white)
        found = self.noise.common_v.get(record.name)
        if found is None:
            return task
        return replace(task, whitening=replace(white, common=common_signals(self.whiten(found, task))))

    def tasks(self, records: Sequence[Record], values: Mapping[str, float]) -> Tasks:
        """The records with their nuisance bases, in drive groups; raises as ``task``."""
        each = tuple(self.task(record, values) for record in records)
        return Tasks(each, drive_groups_of(records, self.instrument, self.angular_gain, self.threads))

    def system(self, values: Mapping[str, float], group: DriveGroup) -> System:
        """The system of the model under the conditions of a drive group."""
        return assemble(self.model, values, self.instrument, group.conditions)

    def whiten(self, y: FloatArray, task: Task) -> FloatArray:
        """P y / sigma (..., N, S) in sigmas, of y (..., N, S) [V]."""
        rest = self.without_nuisances(y, task)
        rest /= self.sigma_v
        return rest if task.whitening.is_white else task.whitening(rest)

    def without_nuisances(self, y: FloatArray, task: Task) -> FloatArray:
        """P y (..., N, S) [V]."""
        own = task.basis.T @ y
        rest = np.empty_like(y)
        # One channel at a time: contiguous samples are several times faster than interleaved channels.
        for s in range(y.shape[-1]):
            if task.masked is None:
                np.subtract(y[..., s], own[..., s] @ task.basis.T, out=rest[..., s])
            else:
                rest[..., s] = task.masked.rest(y[..., s], s)
        return rest

    def predictions(self, values: Mapping[str, float], tasks: Tasks, starts: Starts) -> list[FloatArray]:
        """Prediction (N, S) [V] of each record without nuisances; initial states ``starts``, each (2n,) [V s, V] or ``None``."""
        out: list[FloatArray] = [np.zeros(0)] * len(tasks.each)
        for number, (places, group) in enumerate(tasks.groups):
            system = self.system(values, group)
            found = self._volts(number, values, system, group, [starts[i] for i in places])
            for place, y in zip(places, converted(system, found)):
                out[place] = y
        return out

    def _volts(
        self, number: int, values: Mapping[str, float], system: System, group: DriveGroup, starts: Starts
    ) -> FloatArray:
        """Volts (R, N, S) of the drive group with this number, before the converter."""
        return volts(system, group, starts)

    def _nonlinear_columns(self, number: int) -> NonlinearColumns | None:
        """Columns of the force and sense laws in the drive group with this number, if they are already known."""
        return None

    def residuals_of(self, predicted: Sequence[FloatArray], tasks: Tasks) -> list[FloatArray]:
        """Residuals (N, S) of each record, in sigmas, from its prediction (N, S) [V]."""
        return [self.whiten(task.record.sense_v - y, task) for task, y in zip(tasks.each, predicted)]

    def residuals(self, values: Mapping[str, float], tasks: Tasks, starts: Starts) -> list[FloatArray]:
        """P (y - f) / sigma (N, S) of each record, in sigmas, at complete ``values``."""
        return self.residuals_of(self.predictions(values, tasks, starts), tasks)

    def start_columns(
        self, values: Mapping[str, float], task: Task, start: FloatArray | None, exact: bool
    ) -> FloatArray:
        """Derivatives (N S, 2n) by the initial state, in sigmas per [V s, V]; ``exact`` includes nonlinear effects."""
        group = task.group
        system = self.system(values, group)
        m, clock = system.mechanics, group.clock
        own, n = task.coordinates, m.stiffness.shape[1]
        samples = task.record.drive_v.shape[0]
        columns = np.moveaxis(free_response(m, system.readout, samples * clock.stride, clock)[:: clock.stride], -1, 0)
        # An effect that appends a coordinate may be at its null here or at the start of the fit; its initial state is rest.
        shared = min(own, n)
        padding = np.zeros((own - shared, *columns.shape[1:]))
        columns = np.concatenate([part for half in np.split(columns, 2) for part in (half[:shared], padding)])
        if exact and start is not None:
            before = nonlinear_response(system, group, [start])[0]
            omega = np.sqrt(np.diagonal(m.stiffness[0]))
            position, velocity = np.abs(m.reads[0])[:, :n], np.abs(m.reads[0])[:, n:]
            level, seen = float(np.sqrt(np.mean(task.record.sense_v**2))), np.max(position + omega * velocity, axis=0)
            motion = np.divide(1e-4 * level, seen, out=np.zeros(n), where=seen > 0.0)
            for i, step in enumerate((motion * half)[:shared] for half in (np.ones(n), omega)):
                for k in np.flatnonzero(step):
                    # A coordinate that no sense sees starts at rest.
                    moved = start.copy()
                    moved[i * own + k] += step[k]
                    columns[i * own + k] += (nonlinear_response(system, group, [moved])[0] - before) / step[k]
        return self.whiten(columns, task).reshape(2 * own, -1).T

    def steps(self, values: Mapping[str, float], task: Task, start: FloatArray | None) -> FloatArray:
        """Steps (P,) of the difference quotients, in units of x, tuned to the record of ``task``."""
        gain = self.angular_gain
        return tuned_steps(self.model, values, task.record, self.instrument, angular_gain=gain, start=start)

    def columns(
        self, values: Mapping[str, float], tasks: Tasks, starts: Starts, exact: bool, steps: FloatArray
    ) -> list[FloatArray]:
        """Derivatives (N S, P) of each record with respect to the smooth coordinates, in sigmas per unit of x.

        Parameters
        ----------
        values, tasks, starts : the point, its records and their initial states.
        exact : linear parameters are differentiated through the nonlinear response too.
        steps : of :meth:`steps`.
        """
        out: list[FloatArray] = [np.zeros(0)] * len(tasks.each)
        for number, (places, group) in enumerate(tasks.groups):
            own, known = [starts[i] for i in places], self._nonlinear_columns(number)
            found = group_jacobian(
                self.model, values, group, self.instrument, steps, starts=own, exact=exact, nonlinear=known
            )

            def white(k: int, found: FloatArray = found, places: Sequence[int] = places) -> FloatArray:
                return self.whiten(found[:, k], tasks.each[places[k]]).reshape(found.shape[0], -1).T

            for place, columns in zip(places, mapped(white, range(len(places)), self.threads)):
                out[place] = columns
        return out

    def strength(self, values: Mapping[str, float], task: Task, start: FloatArray | None = None) -> float:
        """Norm of the nonlinear response over that of the linear response [1]; 0 without force and sense laws."""
        return nonlinear_share(self.system(values, task.group), task.group, [start])

    def linear_start(self, values: Mapping[str, float], task: Task) -> FloatArray | None:
        """The initial state (2n,) [V s, V] that explains the record best without nonlinear effects; ``None``: at rest."""
        if not task.coordinates:
            return None
        start = np.zeros(2 * task.coordinates)
        f = self.start_columns(values, task, start, False)
        alone = Tasks((task,), (((0,), task.group),))
        return start + start_step(f, self.residuals(values, alone, [start])[0])

    def relative_size_change(self, before: FloatArray, after: FloatArray) -> float:
        """Largest relative change [1] of a parameter of a force or sense law between two points x (P,)."""
        own = [i for i, name in enumerate(self.model.free) if is_integrated(self.model, name)]
        change, size = np.abs(after - before)[own], np.maximum(np.abs(before), np.abs(after))[own]
        return float(np.max(change / np.maximum(size, 1e-300), initial=0.0))
