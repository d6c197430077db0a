"""What an assembled system answers to drive samples.

    y = linear part (exact at the samples) + read-out of the remainder  r = S(x_l + d) - S_linear(x_l),   then the
    converter

Shapes: R records, N samples, D drives, S senses, n coordinates.  Units: volts, seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..arrays import FloatArray
from ..threads import mapped
from .integrate import SUBSTEPS, trajectory
from .linear import Clock, delay_steps, fed_through, free_response, interpolated, linear_response, shifted, upper_poles
from .play import Play, waveforms_of
from .readout_filter import filtered
from .system import System

Starts = Sequence[FloatArray | None]

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


def linear_volts(system: System, play: Play, starts: Starts | None = None) -> FloatArray:
    """Linear part (R, N, S) [V] before the converter.

    Parameters
    ----------
    system, play : what is played on what.
    starts : state (2n,) at the first sample of each record; ``None`` is rest.
    """
    clock, readout = play.clock, system.readout
    m = system.mechanics
    if system.drives:
        # Behind the drive stage another level is another waveform.
        waveforms, gains = waveforms_of([force_volts(system, v) for v in play.drives], clock)
        y = linear_response(m, readout, waveforms, gains, clock, feeds=False)[:, :: clock.stride]
        if np.any(readout.resistive) or np.any(readout.capacitive):
            y = y + fed_through(readout, play.waveforms, play.gains, clock)[:, :: clock.stride]
    else:
        y = linear_response(m, readout, play.waveforms, play.gains, clock)[:, :: clock.stride]
    for record, start in enumerate(starts or ()):
        if start is not None:
            free = free_response(m, readout, play.waveforms.shape[1], clock) @ full_start(system, start)
            y[record] += free[:: clock.stride]
    return y


def remainder_volts(system: System, play: Play, starts: Starts | None = None, substeps: int = SUBSTEPS) -> FloatArray:
    """What forces and pick-off laws add to the linear part, (R, N, S) [V]; zero where there are none."""
    out = np.zeros((len(play.drives), play.drives[0].shape[0], system.sense_motion.shape[0]))
    if not (system.forces or system.senses):
        return out
    known = starts or (None,) * len(play.drives)
    source = [
        first if start is None and known[first] is None else record
        for record, (first, start) in enumerate(zip(play.twins, known))
    ]
    own = [record for record, first in enumerate(source) if first == record]

    def one(record: int) -> FloatArray:
        return _remainder(system, play.drives[record], play.clock, known[record], substeps)

    found = mapped(one, own, play.threads)
    for record, first in enumerate(source):
        out[record] = found[own.index(first)]
    return out


def _remainder(
    system: System, drive_v: FloatArray, clock: Clock, start: FloatArray | None, substeps: int
) -> FloatArray:
    m = system.mechanics
    u = interpolated(force_volts(system, drive_v), clock)
    forces = [(effect.force, p) for effect, p in system.forces]
    begun = None if start is None else full_start(system, start)
    fine = min(substeps, _INTERPOLATED_SUBSTEPS) if clock.stride > 1 else substeps
    reads = np.concatenate([m.position_sense[0], m.velocity_sense[0]], axis=1)
    march = partial(trajectory, m, forces, system.laws, u, clock.step_s, clock.hold, begun, fine)
    if system.senses:
        linear, deviation = march()
        n = m.stiffness.shape[1]
        state = linear + deviation
        x, xd, s = state[:, :n] @ system.sense_motion.T, state[:, n:] @ system.sense_motion.T, state @ reads.T
        t = np.arange(state.shape[0], dtype=np.float64) * (clock.step_s / fine)
        seen = s
        for effect, p in system.senses:
            assert effect.sense is not None
            seen = effect.sense(x, xd, seen, t, p, system.context)
        r = deviation @ reads.T + (seen - s)
    else:
        _, r = march(reads=reads)
    q, g = upper_poles(system.readout)
    shift, late_s = delay_steps(system.readout.delay_s, clock.step_s)
    y = filtered(q, g, system.readout.static, r, clock.step_s, late_s, fine)
    return shifted(y, shift)[:: clock.stride]


def volts(system: System, play: Play, starts: Starts | None = None) -> FloatArray:
    """The records (R, N, S) [V] before the converter."""
    y = linear_volts(system, play, starts)
    if system.forces or system.senses:
        y += remainder_volts(system, play, starts)
    return y


def converted(system: System, y: FloatArray) -> FloatArray:
    """The records behind the converter stage; ``y`` (.., S)."""
    for effect, p in system.adcs:
        assert effect.adc is not None
        y = effect.adc(y, p, system.context)
    return y
