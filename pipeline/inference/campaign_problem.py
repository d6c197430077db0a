"""The residuals of a campaign and how they move: what a fit asks of the records, one at a time.

    residual = P (y - f(x)) / sigma

P projects out what is free in every record and channel (``nuisance_columns``).  Shapes: N samples, S senses, P free parameters,
L nuisances a channel, n coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..device.model import Model
from ..experiment.antialias import filter_poles
from ..experiment.instrument import Instrument
from ..experiment.linear import clock_of, free_response
from ..experiment.record import Campaign, Record
from ..experiment.response import converted, linear_volts, remainder_volts, volts
from ..experiment.sensitivity import jacobian, tuned_steps
from ..experiment.system import System, assemble, conditions_of


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
    """A record to explain: its nuisance basis, and how many coordinates have a free initial state (0: at rest)."""

    record: Record
    basis: FloatArray
    coordinates: int


class Problem:
    """Residuals and normal equations of a set of records; holds no state but what it was made of."""

    def __init__(self, model: Model, campaign: Campaign, sigma_v: FloatArray) -> None:
        self.model, self.instrument, self.angular_gain = model, campaign.instrument, campaign.angular_gain
        self.sigma_v = sigma_v

    def task(self, record: Record, values: Mapping[str, float]) -> Task:
        coordinates = 0 if record.at_rest else self.model.built.sense_motion().shape[1]
        return Task(record, nuisance_columns(self.model, values, record, self.instrument), coordinates)

    def system(self, values: Mapping[str, float], record: Record) -> System:
        return assemble(self.model, values, self.instrument, conditions_of(record, self.instrument, self.angular_gain))

    def full_start(self, system: System, task: Task, start: FloatArray | None) -> FloatArray | None:
        """Initial state of all coordinates: those that effects append start at rest."""
        if start is None:
            return None
        n, own = system.mechanics.stiffness.shape[1], task.coordinates
        full = np.zeros(2 * n)
        full[:own], full[n : n + own] = start[:own], start[own:]
        return full

    def predict(self, values: Mapping[str, float], task: Task, start: FloatArray | None) -> FloatArray:
        system = self.system(values, task.record)
        clock = clock_of(task.record.sample_rate_hz, self.instrument.hold)
        return converted(system, volts(system, task.record.drive_v, clock, self.full_start(system, task, start)))

    def whiten(self, y: FloatArray, task: Task) -> FloatArray:
        """P y / sigma, y (N, S) or (N, S, k)."""
        flat = y.reshape(y.shape[0], -1)
        rest = (flat - task.basis @ (task.basis.T @ flat)).reshape(y.shape)
        return rest / (self.sigma_v if y.ndim == 2 else self.sigma_v[:, None])

    def residual(self, values: Mapping[str, float], task: Task, start: FloatArray | None) -> FloatArray:
        return self.whiten(task.record.sense_v - self.predict(values, task, start), task)

    def start_columns(
        self, values: Mapping[str, float], task: Task, start: FloatArray | None, exact: bool
    ) -> FloatArray:
        """(N S, 2 n): what the initial state moves, in sigmas; ``exact`` with what nonlinear effects make of it."""
        system = self.system(values, task.record)
        clock = clock_of(task.record.sample_rate_hz, self.instrument.hold)
        m = system.mechanics
        n, own = m.stiffness.shape[1], task.coordinates
        samples = task.record.drive_v.shape[0]
        columns = free_response(m, system.readout, samples * clock.stride, clock)[:: clock.stride]
        chosen = [*range(own), *range(n, n + own)]
        columns = columns[:, :, chosen]
        full = self.full_start(system, task, start)
        if exact and full is not None:
            v = task.record.drive_v
            before = remainder_volts(system, v, clock, full)
            omega = np.sqrt(np.diagonal(m.stiffness[0]))
            seen = np.max(np.abs(m.position_sense[0]) + omega * np.abs(m.velocity_sense[0]), axis=0)
            motion = 1e-4 * float(np.sqrt(np.mean(task.record.sense_v**2))) / seen
            steps = np.concatenate([motion, motion * omega])
            for column, i in enumerate(chosen):
                moved = full.copy()
                moved[i] += steps[i]
                columns[:, :, column] += (remainder_volts(system, v, clock, moved) - before) / steps[i]
        return self.whiten(columns, task).reshape(-1, 2 * own)

    def steps(self, values: Mapping[str, float], task: Task, start: FloatArray | None) -> FloatArray:
        """Steps (P,) of the differences, as ``task`` asks for them."""
        full = self.full_start(self.system(values, task.record), task, start)
        return tuned_steps(self.model, values, task.record, self.instrument, angular_gain=self.angular_gain, start=full)

    def columns(
        self, values: Mapping[str, float], task: Task, start: FloatArray | None, exact: bool, steps: FloatArray
    ) -> FloatArray:
        """(N S, P): what the free parameters move, in sigmas."""
        system = self.system(values, task.record)
        full = self.full_start(system, task, start)
        found = jacobian(
            self.model,
            values,
            task.record,
            self.instrument,
            angular_gain=self.angular_gain,
            start=full,
            exact=exact,
            steps=steps,
        )
        return self.whiten(found, task).reshape(-1, found.shape[-1])

    def strength(self, values: Mapping[str, float], task: Task) -> float:
        """Share of the record that forces and pick-off laws make."""
        system = self.system(values, task.record)
        if not (system.forces or system.senses):
            return 0.0
        clock = clock_of(task.record.sample_rate_hz, self.instrument.hold)
        linear = linear_volts(system, task.record.drive_v, clock)
        rest = volts(system, task.record.drive_v, clock) - linear
        return float(np.linalg.norm(rest)) / max(float(np.linalg.norm(linear)), 1e-300)
