"""What an assembled system answers to drive samples.

    y = linear part (exact at the samples) + read-out of the remainder  r = S(x_l + d) - S_linear(x_l),   then the
    converter

Shapes: R records, N samples, D drives, S senses, n coordinates.  Units: volts, seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from ...arrays import FloatArray
from ...threads import mapped
from .drive_groups import DriveGroup, waveforms_of
from .integrate import SUBSTEPS, Motion, linear_motion, perturbed_motion, trajectory
from .linear import (
    SampleClock,
    delay_steps,
    fed_through,
    free_response,
    interpolated,
    linear_response,
    shifted,
    upper_poles,
)
from .readout_filter import filtered
from .system import System

Starts = Sequence[FloatArray | None]
Out = TypeVar("Out")

#: An interpolated drive steps finely already: two substeps leave 1e-6 of the record where the read-out has a pole.
_INTERPOLATED_SUBSTEPS = 2


def force_volts(system: System, drive_v: FloatArray) -> FloatArray:
    """u (N, D): drive samples behind the drive stage."""
    u = drive_v
    for effect, p in system.drives:
        assert effect.drive is not None
        u = effect.drive(u, p, system.context)
    return u


def full_start(system: System, start: FloatArray) -> FloatArray:
    """Initial state of all coordinates from that of the first of them: those that effects append start at rest."""
    n, own = system.mechanics.stiffness.shape[1], start.size // 2
    full = np.zeros(2 * n)
    full[:own], full[n : n + own] = start[:own], start[own:]
    return full


def linear_volts(system: System, group: DriveGroup, starts: Starts | None = None) -> FloatArray:
    """Linear part (R, N, S) [V] before the converter.

    Parameters
    ----------
    system, play : what is played on what.
    starts : state (2n,) at the first sample of each record; ``None`` is rest.
    """
    clock, readout = group.clock, system.readout
    m = system.mechanics
    if system.drives:
        # Behind the drive stage another level is another waveform.
        waveforms, gains = waveforms_of([force_volts(system, v) for v in group.drives], clock)
        y = linear_response(m, readout, waveforms, gains, clock, feeds=False)[:, :: clock.stride]
        if np.any(readout.resistive) or np.any(readout.capacitive):
            y = y + fed_through(readout, group.waveforms, group.gains, clock)[:, :: clock.stride]
    else:
        y = linear_response(m, readout, group.waveforms, group.gains, clock)[:, :: clock.stride]
    for record, start in enumerate(starts or ()):
        if start is not None:
            free = free_response(m, readout, group.waveforms.shape[1], clock) @ full_start(system, start)
            y[record] += free[:: clock.stride]
    return y


def nonlinear_response(
    system: System, group: DriveGroup, starts: Starts | None = None, substeps: int = SUBSTEPS
) -> FloatArray:
    """What forces and pick-off laws add to the linear part, (R, N, S) [V]; zero where there are none."""
    if not (system.forces or system.senses):
        return np.zeros((len(group.drives), group.drives[0].shape[0], system.sense_motion.shape[0]))
    known = starts or (None,) * len(group.drives)
    fine = _fine(group.clock, substeps)

    def one(record: int) -> FloatArray:
        u = interpolated(force_volts(system, group.drives[record]), group.clock)
        return _remainder(system, u, group.clock, known[record], fine)

    return np.stack(_shared(one, response_sources(group, starts), group.threads))


def linear_motions(system: System, group: DriveGroup, starts: Starts | None, substeps: int) -> list[Motion]:
    """Linear trajectories of the records, those of same_drive_as once; arguments as in ``remainder_volts``."""
    known = starts or (None,) * len(group.drives)
    clock, fine = group.clock, _fine(group.clock, substeps)

    def one(record: int) -> Motion:
        u = interpolated(force_volts(system, group.drives[record]), clock)
        start = known[record]
        begun = None if start is None else full_start(system, start)
        return linear_motion(system.mechanics, u, clock.step_s, clock.hold, begun, fine)

    return _shared(one, response_sources(group, starts), group.threads)


def first_order_response(system: System, group: DriveGroup, motions: Sequence[Motion]) -> FloatArray:
    """As ``remainder_volts``, to first order in forces and pick-off laws, along the linear trajectories ``motions``."""

    def one(record: int) -> FloatArray:
        motion = motions[record]
        reads = _reads(system)
        r = np.zeros((motion.states.shape[0] // 2 + 1, reads.shape[0]))
        if system.forces:
            r += perturbed_motion(motion, [(effect.force, p) for effect, p in system.forces], system.laws, reads)
        if system.senses:
            r += _sense_law_volts(system, motion.state, group.clock.step_s / motion.steps.substeps)
        return _seen(system, r, group.clock, motion.steps.substeps)

    source = [next(k for k, other in enumerate(motions) if other is motion) for motion in motions]
    return np.stack(_shared(one, source, group.threads))


def response_sources(group: DriveGroup, starts: Starts | None) -> list[int]:
    """For each record the one whose answer it shares: its twin, where both start at rest."""
    known = starts or (None,) * len(group.drives)
    return [
        first if start is None and known[first] is None else record
        for record, (first, start) in enumerate(zip(group.same_drive_as, known))
    ]


def _shared(one: Callable[[int], Out], source: Sequence[int], threads: int) -> list[Out]:
    own = [record for record, first in enumerate(source) if first == record]
    found = mapped(one, own, threads)
    return [found[own.index(first)] for first in source]


def _fine(clock: SampleClock, substeps: int) -> int:
    return min(substeps, _INTERPOLATED_SUBSTEPS) if clock.stride > 1 else substeps


def _reads(system: System) -> FloatArray:
    """(S, 2n): pick-off volts from a state."""
    return np.concatenate([system.mechanics.position_sense[0], system.mechanics.velocity_sense[0]], axis=1)


def _remainder(system: System, u: FloatArray, clock: SampleClock, start: FloatArray | None, fine: int) -> FloatArray:
    """(N, S) of a record under ``u`` (N', D)."""
    forces = [(effect.force, p) for effect, p in system.forces]
    begun = None if start is None else full_start(system, start)
    reads = _reads(system)
    march = partial(trajectory, system.mechanics, forces, system.laws, u, clock.step_s, clock.hold, begun, fine)
    if system.senses:
        linear, deviation = march()
        r = deviation @ reads.T + _sense_law_volts(system, linear + deviation, clock.step_s / fine)
    else:
        _, r = march(reads=reads)
    return _seen(system, r, clock, fine)


def _sense_law_volts(system: System, state: FloatArray, step_s: float) -> FloatArray:
    """What pick-off laws add along a ``state`` (M, 2n), (M, S) [V]."""
    n = system.mechanics.stiffness.shape[1]
    x, xd, s = state[:, :n] @ system.sense_motion.T, state[:, n:] @ system.sense_motion.T, state @ _reads(system).T
    t = np.arange(state.shape[0], dtype=np.float64) * step_s
    seen = s
    for effect, p in system.senses:
        assert effect.sense is not None
        seen = effect.sense(x, xd, seen, t, p, system.context)
    return np.asarray(seen - s)


def _seen(system: System, r: FloatArray, clock: SampleClock, fine: int) -> FloatArray:
    """A remainder (M, S) behind the read-out, (N, S)."""
    q, g = upper_poles(system.readout)
    shift, late_s = delay_steps(system.readout.delay_s, clock.step_s)
    y = filtered(q, g, system.readout.static, r, clock.step_s, late_s, fine)
    return shifted(y, shift)[:: clock.stride]


def volts(system: System, group: DriveGroup, starts: Starts | None = None) -> FloatArray:
    """The records (R, N, S) [V] before the converter."""
    y = linear_volts(system, group, starts)
    if system.forces or system.senses:
        y += nonlinear_response(system, group, starts)
    return y


def converted(system: System, y: FloatArray) -> FloatArray:
    """The records behind the converter stage; ``y`` (.., S)."""
    for effect, p in system.adcs:
        assert effect.adc is not None
        y = effect.adc(y, p, system.context)
    return y
