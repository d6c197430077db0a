"""What an assembled system answers to drive samples.

    y = linear part (exact at the samples) + read-out of the remainder  r = S(x_l + d) - S_linear(x_l),   then the
    converter

Shapes: N samples, D drives, S senses, n coordinates.  Units: volts, seconds.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .integrate import SUBSTEPS, filtered, trajectory
from .linear import Clock, delay_steps, free_response, interpolated, linear_response, shifted, upper_poles
from .system import System


def force_volts(system: System, drive_v: FloatArray) -> FloatArray:
    """u (N, D): drive samples behind the drive stage."""
    u = drive_v
    for effect, p in system.drives:
        assert effect.drive is not None
        u = effect.drive(u, p, system.context)
    return u


def linear_volts(system: System, drive_v: FloatArray, clock: Clock, start: FloatArray | None = None) -> FloatArray:
    """Linear part (N, S) [V] before the converter; ``start`` (2n,) is the state at the first sample, ``None`` rest."""
    v = interpolated(drive_v, clock)
    u = interpolated(force_volts(system, drive_v), clock) if system.drives else v
    y = linear_response(system.mechanics, system.readout, u, v, clock)
    if start is not None:
        y = y + free_response(system.mechanics, system.readout, y.shape[0], clock) @ start
    return y[:: clock.stride]


def remainder_volts(
    system: System, drive_v: FloatArray, clock: Clock, start: FloatArray | None = None, substeps: int = SUBSTEPS
) -> FloatArray:
    """What forces and pick-off laws add to the linear part, (N, S) [V]; zero where there are none."""
    if not (system.forces or system.senses):
        return np.zeros((drive_v.shape[0], system.sense_motion.shape[0]))
    m = system.mechanics
    u = interpolated(force_volts(system, drive_v), clock)
    forces = [(effect.force, p) for effect, p in system.forces]
    linear, deviation = trajectory(m, forces, system.laws, u, clock.step_s, clock.hold, start, substeps)
    reads = np.concatenate([m.position_sense[0], m.velocity_sense[0]], axis=1)
    r = deviation @ reads.T
    if system.senses:
        n = m.stiffness.shape[1]
        state = linear + deviation
        x, xd, s = state[:, :n] @ system.sense_motion.T, state[:, n:] @ system.sense_motion.T, state @ reads.T
        t = np.arange(state.shape[0], dtype=np.float64) * (clock.step_s / substeps)
        seen = s
        for effect, p in system.senses:
            assert effect.sense is not None
            seen = effect.sense(x, xd, seen, t, p, system.context)
        r = r + (seen - s)
    q, g = upper_poles(system.readout)
    shift, late_s = delay_steps(system.readout.delay_s, clock.step_s)
    y = filtered(q, g, system.readout.static, r, clock.step_s, late_s, substeps)
    return shifted(y, shift)[:: clock.stride]


def volts(system: System, drive_v: FloatArray, clock: Clock, start: FloatArray | None = None) -> FloatArray:
    """The record (N, S) [V] before the converter."""
    y = linear_volts(system, drive_v, clock, start)
    if system.forces or system.senses:
        y = y + remainder_volts(system, drive_v, clock, start)
    return y


def converted(system: System, y: FloatArray) -> FloatArray:
    """The record behind the converter stage."""
    for effect, p in system.adcs:
        assert effect.adc is not None
        y = effect.adc(y, p, system.context)
    return y
