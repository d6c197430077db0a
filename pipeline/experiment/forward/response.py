"""Response of an assembled system to the drive samples of a drive group.

    y = linear response (exact at the samples) + read-out of r,   r = S(x_l + d) - S_linear(x_l),   then the ADC stage

The second term is the nonlinear response: x_l is the linear motion, d the deviation from it that force effects cause, and S
the pick-off with the sense effects.

Shapes: R records, N samples, N' steps of the clock, M grid points of the integrator, D drives, S senses, n coordinates.
Units: volts, seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from ...arrays import FloatArray
from ...device.force_law import Points, force_along
from ...device.readout import Readout
from ...threads import mapped
from .drive_groups import DriveGroup, waveforms_of
from .integrate import SUBSTEPS, Motion, between_samples, linear_motion, trajectory
from .linear import (
    SampleClock,
    delay_steps,
    direct_gain,
    fed_through,
    free_response,
    interpolated,
    linear_response,
    shifted,
    upper_poles,
)
from .paths import by_channel, clocked, lagged_drive, of_drive, superposed
from .readout_filter import filtered
from .system import System

Starts = Sequence[FloatArray | None]
Out = TypeVar("Out")

#: Substeps per step of an interpolated drive, whose steps are already fine: the error is 1e-6 of the record.
_INTERPOLATED_SUBSTEPS = 2


def force_volts(system: System, drive_v: FloatArray) -> FloatArray:
    """u (N, D) [V]: drive samples (N, D) [V] after the drive stage."""
    u = drive_v
    for effect, p in system.drives:
        assert effect.drive is not None
        u = effect.drive(u, p, system.context)
    return u


def full_start(system: System, start: FloatArray) -> FloatArray:
    """State (2n,) [V s, V] from that of other coordinates: those that an effect appends start at rest, or are at their null."""
    n, given = system.mechanics.stiffness.shape[1], start.size // 2
    own, full = min(n, given), np.zeros(2 * n)
    full[:own], full[n : n + own] = start[:own], start[given : given + own]
    return full


def linear_volts(system: System, group: DriveGroup, starts: Starts | None = None) -> FloatArray:
    """Linear response (R, N, S) [V] before the ADC stage.

    Parameters
    ----------
    system : the assembled system.
    group : the records.
    starts : state (2n,) of each record at its first sample; ``None`` is rest.
    """
    y = superposed(system.readout, lambda readout, drive: _forced_volts(system, readout, group, drive))
    if any(start is not None for start in starts or ()):
        y += by_channel(system.readout, lambda readout: _free_volts(system, readout, group, starts or ()))
    return clocked(y, system.readout, system.context.elapsed_s, 1.0 / group.sample_rate_hz)


def _forced_volts(system: System, readout: Readout, group: DriveGroup, drive: int | None) -> FloatArray:
    """Response (R, N, S) [V] to the drives, or to one ``drive`` of them, from rest."""
    clock, m = group.clock, system.mechanics
    if not system.drives:
        return linear_response(m, readout, group.waveforms, of_drive(group.gains, drive), clock)[:, :: clock.stride]
    # The drive stage may be nonlinear, so a record of another level has another waveform.
    waveforms, gains = waveforms_of([force_volts(system, v) for v in group.drives], clock)
    y = linear_response(m, readout, waveforms, of_drive(gains, drive), clock, feeds=False)[:, :: clock.stride]
    if np.any(readout.resistive) or np.any(readout.capacitive):
        y = y + fed_through(readout, group.waveforms, of_drive(group.gains, drive), clock)[:, :: clock.stride]
    return y


def _free_volts(system: System, readout: Readout, group: DriveGroup, starts: Starts) -> FloatArray:
    """Response (R, N, S) [V] to the states at the first samples."""
    clock, m = group.clock, system.mechanics
    y = np.zeros((len(starts), group.drives[0].shape[0], readout.static.shape[0]))
    for record, start in enumerate(starts):
        if start is not None:
            free = free_response(m, readout, group.waveforms.shape[1], clock) @ full_start(system, start)
            y[record] = free[:: clock.stride]
            # What follows the drive at once is late too; the drive before the first sample is taken as the first one.
            late = max(-(-delay_steps(readout.delay_s, clock.step_s)[0] // clock.stride), 0)
            y[record, :late] += group.drives[record][0] @ direct_gain(m, readout).T
    return y


def nonlinear_response(
    system: System, group: DriveGroup, starts: Starts | None = None, substeps: int = SUBSTEPS
) -> FloatArray:
    """What force and sense effects add to the linear response, (R, N, S) [V]; zero where there are none.

    ``substeps`` of the integrator per sample; other arguments as in ``linear_volts``, errors as in ``integrate.trajectory``.
    """
    return np.asarray(nonlinear_responses(system, group, starts, substeps, (0.0,))[0])


def nonlinear_responses(
    system: System, group: DriveGroup, starts: Starts | None, substeps: int, delays_s: Sequence[float]
) -> FloatArray:
    """``nonlinear_response`` with each of some additional delays [s] of the read-out, (delays, R, N, S) [V].

    The motion is the same with all of them and is integrated once.
    """
    if not (system.forces or system.senses):
        samples, senses = group.drives[0].shape[0], system.sense_motion.shape[0]
        return np.zeros((len(delays_s), len(group.drives), samples, senses))
    system = system.integrated
    start_states = starts or (None,) * len(group.drives)
    steps = _substeps(group.clock, substeps)

    def one(record: int) -> FloatArray:
        u = force_drive(system, group, record)
        r = _nonlinear_pickoff(system, u, group.clock, start_states[record], steps)
        return np.stack([after_readout(delayed(system, d), r, group.clock, steps) for d in delays_s])

    return np.stack(for_distinct_records(one, response_sources(group, starts), group.threads), axis=1)


def force_drive(system: System, group: DriveGroup, record: int) -> FloatArray:
    """u (N', D) [V] of a record at the steps of the clock, as forces see it."""
    clock, v = group.clock, force_volts(system, group.drives[record])
    return lagged_drive(interpolated(v, clock), system.readout, clock.step_s)


def delayed(system: System, delay_s: float) -> System:
    """The system with a longer delay [s] in its read-out."""
    return replace(system, readout=replace(system.readout, delay_s=system.readout.delay_s + delay_s))


def linear_motions(system: System, group: DriveGroup, starts: Starts | None, substeps: int) -> list[Motion]:
    """Linear trajectories of the records, shared by records with the same drive; arguments as in ``nonlinear_response``."""
    start_states = starts or (None,) * len(group.drives)
    clock, steps = group.clock, _substeps(group.clock, substeps)

    def one(record: int) -> Motion:
        u = force_drive(system, group, record)
        start = start_states[record]
        state = None if start is None else full_start(system, start)
        return linear_motion(system.mechanics, u, clock.step_s, clock.hold, state, steps)

    return for_distinct_records(one, response_sources(group, starts), group.threads)


def response_sources(group: DriveGroup, starts: Starts | None) -> list[int]:
    """For each record the index of the record whose response it shares: the same drive, and both start at rest."""
    start_states = starts or (None,) * len(group.drives)
    return [
        first if start is None and start_states[first] is None else record
        for record, (first, start) in enumerate(zip(group.same_drive_as, start_states))
    ]


def for_distinct_records(one: Callable[[int], Out], source: Sequence[int], threads: int) -> list[Out]:
    distinct = [record for record, first in enumerate(source) if first == record]
    found = mapped(one, distinct, threads)
    return [found[distinct.index(first)] for first in source]


def _substeps(clock: SampleClock, substeps: int) -> int:
    return min(substeps, _INTERPOLATED_SUBSTEPS) if clock.stride > 1 else substeps


def pickoff_rows(system: System) -> FloatArray:
    """(S, 2n): pick-off volts from a state, without drive, forces and sense effects."""
    return system.mechanics.reads[0]


def _nonlinear_pickoff(
    system: System, u: FloatArray, clock: SampleClock, start: FloatArray | None, substeps: int
) -> FloatArray:
    """Nonlinear pick-off volts (M, S) of one record to ``u`` (N', D), before the read-out."""
    forces = [(effect.force, p) for effect, p in system.forces]
    state = None if start is None else full_start(system, start)
    reads = pickoff_rows(system)
    solve = partial(trajectory, system.mechanics, forces, system.laws, u, clock.step_s, clock.hold, state, substeps)
    if not system.senses and not system.mechanics.senses_acceleration:
        return solve(reads=reads)[1]
    linear, deviation = solve()
    r = deviation @ reads.T
    if system.mechanics.senses_acceleration:
        v = between_samples(u, substeps, clock.hold != "zoh")
        r += force_volts_along(system, linear + deviation, v, clock.step_s / substeps)
    if system.senses:
        r += sense_effect_volts(system, linear + deviation, u, clock, substeps)
    return r


def force_volts_along(system: System, state: FloatArray, u: FloatArray, step_s: float) -> FloatArray:
    """A a (M, S) [V]: the forces a along states (M, 2n) under drives u (M, D) [V], as pick-offs of acceleration see them."""
    n = system.mechanics.stiffness.shape[1]
    points = Points(np.arange(state.shape[0], dtype=np.float64) * step_s, state[:, :n].T, state[:, n:].T, u.T)
    forces = np.zeros((n, state.shape[0]))
    for effect, p in system.forces:
        assert effect.force is not None
        forces += force_along(effect.force, points, p, system.laws)
    return np.asarray(forces.T @ system.mechanics.acceleration_sense[0].T)


def sense_effect_volts(
    system: System, state: FloatArray, drive: FloatArray, clock: SampleClock, substeps: int
) -> FloatArray:
    """What sense effects add to the pick-off volts along states (M, 2n) under ``drive`` (N', D) [V], (M, S) [V]."""
    n, step_s = system.mechanics.stiffness.shape[1], clock.step_s / substeps
    x, xd, s = (
        state[:, :n] @ system.sense_motion.T,
        state[:, n:] @ system.sense_motion.T,
        state @ pickoff_rows(system).T,
    )
    if system.mechanics.senses_acceleration:
        u = between_samples(drive, substeps, clock.hold != "zoh")
        s = s + u @ system.mechanics.direct[0].T + force_volts_along(system, state, u, step_s)
    t = system.context.elapsed_s + np.arange(state.shape[0], dtype=np.float64) * step_s
    sensed = s
    for effect, p in system.senses:
        assert effect.sense is not None
        sensed = effect.sense(x, xd, sensed, t, p, system.context)
    return np.asarray(sensed - s)


def after_readout(system: System, r: FloatArray, clock: SampleClock, substeps: int) -> FloatArray:
    """Pick-off volts r (M, S) after the read-out, (N, S) [V]."""

    def one(readout: Readout) -> FloatArray:
        q, g = upper_poles(readout)
        shift, late_s = delay_steps(readout.delay_s, clock.step_s)
        y = filtered(q, g, readout.static, r, clock.step_s, late_s, substeps)
        return shifted(y, shift)[:: clock.stride]

    y = by_channel(system.readout, one)
    return clocked(y, system.readout, system.context.elapsed_s, clock.step_s * clock.stride)


def volts(system: System, group: DriveGroup, starts: Starts | None = None) -> FloatArray:
    """The records (R, N, S) [V] before the ADC stage; arguments as in ``linear_volts``, errors as in ``nonlinear_response``."""
    y = linear_volts(system, group, starts)
    if system.forces or system.senses:
        y += nonlinear_response(system, group, starts)
    return y


def nonlinear_share(system: System, group: DriveGroup, starts: Starts | None = None) -> float:
    """Norm of the nonlinear response over that of the linear response [1]; 0 without force and sense laws."""
    if not (system.forces or system.senses):
        return 0.0
    linear, nonlinear = linear_volts(system, group, starts), nonlinear_response(system, group, starts, substeps=1)
    return float(np.linalg.norm(nonlinear)) / max(float(np.linalg.norm(linear)), 1e-300)


def converted(system: System, y: FloatArray) -> FloatArray:
    """``y`` (.., S) [V] after the effects of the ADC stage."""
    for effect, p in system.adcs:
        assert effect.adc is not None
        y = effect.adc(y, p, system.context)
    return y
