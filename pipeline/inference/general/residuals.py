"""The residuals of a campaign and how they move: what a fit asks of its records.

    residual = P (y - f(x)) / sigma

P projects out what is free in every record and channel (``nuisance_columns``).  Shapes: N samples, S senses, P free parameters,
L nuisances a channel, n coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.antialias import filter_poles
from ...experiment.forward.drive_groups import DriveGroup, drive_group_of, drive_groups_of
from ...experiment.forward.linear import free_response
from ...experiment.forward.response import Starts, converted, linear_volts, nonlinear_response, volts
from ...experiment.forward.sensitivity import (
    NonlinearColumns,
    channels_checked,
    group_jacobian,
    is_integrated,
    tuned_steps,
)
from ...experiment.forward.system import System, assemble, conditions_of
from ...experiment.instrument import Instrument
from ...experiment.record import Campaign, Record
from ...threads import mapped


def nuisance_columns(model: Model, values: Mapping[str, float], record: Record, instrument: Instrument) -> FloatArray:
    """Orthonormal basis (N, L) of what is free in every channel of ``record``: offset, lines, the filter transient."""
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
    scaled = stacked / np.linalg.norm(stacked, axis=0)
    gram = scaled.T @ scaled
    if np.max(np.abs(gram - np.eye(gram.shape[0]))) < 1e-12:
        return np.asarray(scaled)
    values_, vectors = np.linalg.eigh(gram)
    keep = values_ > 1e-10 * values_[-1]
    return np.asarray(scaled @ (vectors[:, keep] / np.sqrt(values_[keep])))


@dataclass(frozen=True, eq=False)
class Task:
    """A record to explain: its nuisance basis, how many coordinates have a free initial state (0: at rest), its play."""

    record: Record
    basis: FloatArray
    coordinates: int
    group: DriveGroup


@dataclass(frozen=True, eq=False)
class Tasks:
    """Records to explain together: those that one system answers at once share a play."""

    each: tuple[Task, ...]
    groups: tuple[tuple[tuple[int, ...], DriveGroup], ...]


class CampaignResiduals:
    """Residuals and normal equations of a set of records, ``threads`` of which are integrated at once.

    Holds no state but what it was made of.
    """

    def __init__(self, model: Model, campaign: Campaign, sigma_v: FloatArray, threads: int = 1) -> None:
        self.threads = threads
        self.model, self.instrument, self.angular_gain = model, campaign.instrument, campaign.angular_gain
        self.sigma_v = sigma_v

    def task(self, record: Record, values: Mapping[str, float]) -> Task:
        """One record to explain.

        Raises
        ------
        MeasurementError : its numbers of channels are not the plant's.
        """
        channels_checked(self.model, record)
        coordinates = 0 if record.at_rest else self.model.built.sense_motion().shape[1]
        basis = nuisance_columns(self.model, values, record, self.instrument)
        return Task(record, basis, coordinates, drive_group_of([record], self.instrument, self.angular_gain))

    def tasks(self, records: Sequence[Record], values: Mapping[str, float]) -> Tasks:
        """Records to explain together; raises as ``task``."""
        each = tuple(self.task(record, values) for record in records)
        return Tasks(each, drive_groups_of(records, self.instrument, self.angular_gain, self.threads))

    def system(self, values: Mapping[str, float], group: DriveGroup) -> System:
        return assemble(self.model, values, self.instrument, group.conditions)

    def whiten(self, y: FloatArray, task: Task) -> FloatArray:
        """P y / sigma, y (.., N, S)."""
        own = task.basis.T @ y
        rest = np.empty_like(y)
        # Channel by channel: long runs of samples are several times as fast as short ones of channels.
        for s, sigma in enumerate(self.sigma_v):
            np.subtract(y[..., s], own[..., s] @ task.basis.T, out=rest[..., s])
            rest[..., s] /= sigma
        return rest

    def predictions(self, values: Mapping[str, float], tasks: Tasks, starts: Starts) -> list[FloatArray]:
        """Volts (N, S) of each record, without nuisances."""
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
        """Volts (R, N, S) of the play with this number, before the converter."""
        return volts(system, group, starts)

    def _nonlinear_columns(self, number: int) -> NonlinearColumns | None:
        """Columns of forces and pick-off laws in the play with this number, where they are known."""
        return None

    def rests(self, predicted: Sequence[FloatArray], tasks: Tasks) -> list[FloatArray]:
        """What predictions leave of each record (N, S), in sigmas."""
        return [self.whiten(task.record.sense_v - y, task) for task, y in zip(tasks.each, predicted)]

    def residuals(self, values: Mapping[str, float], tasks: Tasks, starts: Starts) -> list[FloatArray]:
        """(N, S) of each record, in sigmas."""
        return self.rests(self.predictions(values, tasks, starts), tasks)

    def start_columns(
        self, values: Mapping[str, float], task: Task, start: FloatArray | None, exact: bool
    ) -> FloatArray:
        """(N S, 2 n): what the initial state moves, in sigmas; ``exact`` with what nonlinear effects make of it."""
        group = task.group
        system = self.system(values, group)
        m, clock = system.mechanics, group.clock
        n, own = m.stiffness.shape[1], task.coordinates
        samples = task.record.drive_v.shape[0]
        columns = free_response(m, system.readout, samples * clock.stride, clock)[:: clock.stride]
        columns = np.moveaxis(columns[:, :, [*range(own), *range(n, n + own)]], -1, 0).copy()
        if exact and start is not None:
            before = nonlinear_response(system, group, [start])[0]
            omega = np.sqrt(np.diagonal(m.stiffness[0]))
            seen = np.max(np.abs(m.position_sense[0]) + omega * np.abs(m.velocity_sense[0]), axis=0)
            motion = (1e-4 * float(np.sqrt(np.mean(task.record.sense_v**2))) / seen)[:own]
            for i, step in enumerate(np.concatenate([motion, motion * omega[:own]])):
                moved = start.copy()
                moved[i] += step
                columns[i] += (nonlinear_response(system, group, [moved])[0] - before) / step
        return self.whiten(columns, task).reshape(2 * own, -1).T

    def steps(self, values: Mapping[str, float], task: Task, start: FloatArray | None) -> FloatArray:
        """Steps (P,) of the differences, as ``task`` asks for them."""
        gain = self.angular_gain
        return tuned_steps(self.model, values, task.record, self.instrument, angular_gain=gain, start=start)

    def columns(
        self, values: Mapping[str, float], tasks: Tasks, starts: Starts, exact: bool, steps: FloatArray
    ) -> list[FloatArray]:
        """(N S, P) of each record: what the free parameters move, in sigmas."""
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

    def strength(self, values: Mapping[str, float], task: Task) -> float:
        """Share of the record that forces and pick-off laws make."""
        system = self.system(values, task.group)
        if not (system.forces or system.senses):
            return 0.0
        linear, rest = linear_volts(system, task.group), nonlinear_response(system, task.group, substeps=1)
        return float(np.linalg.norm(rest)) / max(float(np.linalg.norm(linear)), 1e-300)

    def resized(self, before: FloatArray, after: FloatArray) -> float:
        """By what share of themselves parameters of forces and pick-off laws differ at most between two x (P,)."""
        own = [i for i, name in enumerate(self.model.free) if is_integrated(self.model, name)]
        change, size = np.abs(after - before)[own], np.maximum(np.abs(before), np.abs(after))[own]
        return float(np.max(change / np.maximum(size, 1e-300), initial=0.0))
