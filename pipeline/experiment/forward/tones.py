"""Steady response of an assembled system to single tones.

    (K + i w (C + G) - w^2) q = F u                        motion of a linear device under u(t) = Re(U e^{i w t})
    S = (i w V + D - w^2 A) q + (R + i w C_f) U,   Y = G(i w) e^{-i w tau} S

A device with nonlinear forces or pick-offs is solved by harmonic balance (``harmonic``).

Shapes: N rows, n coordinates, D drives, S senses.  Units: volts (amplitudes), hertz, seconds.
"""

from __future__ import annotations

import numpy as np

from ...arrays import ComplexArray, FloatArray
from .system import System


def linear_motion_of(system: System, frequency_hz: FloatArray, force_v: ComplexArray) -> ComplexArray:
    """q (N, n) [V s] under the force volts U (N, D) [V]."""
    m = system.mechanics
    s = 2.0j * np.pi * frequency_hz[:, None, None]
    n = m.stiffness.shape[1]
    whole = m.stiffness[0] + s * (m.damping[0] + m.gyroscopic[0]) + s**2 * np.eye(n)
    driven = force_v @ m.drive[0].T
    if n == 1:
        return np.asarray(driven / whole[:, :, 0])
    return np.asarray(np.linalg.solve(whole, driven[:, :, None])[:, :, 0])


def acting_drive(system: System, frequency_hz: FloatArray, drive_v: ComplexArray) -> ComplexArray:
    """The drives (N, D) [V] behind their delays and poles."""
    s = np.asarray(2.0j * np.pi * frequency_hz, dtype=np.complex128)
    return np.asarray(drive_v * system.readout.drive_lag(s))


def linear_pickoff(system: System, frequency_hz: FloatArray, q: ComplexArray) -> ComplexArray:
    """S (N, S) [V] of a motion q (N, n) [V s], without feedthrough."""
    m, s = system.mechanics, 2.0j * np.pi * frequency_hz[:, None]
    still, moving, fast = (q @ sense[0].T for sense in (m.position_sense, m.velocity_sense, m.acceleration_sense))
    return np.asarray(still + s * moving + s**2 * fast)


def read_out(system: System, frequency_hz: FloatArray, pickoff_v: ComplexArray, drive_v: ComplexArray) -> ComplexArray:
    """Y (N, S) [V]: pick-off volts S (N, S) and the feedthrough of the drives (N, D), behind filter and delay."""
    readout, s = system.readout, np.asarray(2.0j * np.pi * frequency_hz, dtype=np.complex128)
    drive_v = acting_drive(system, frequency_hz, drive_v)
    volts = pickoff_v + drive_v @ readout.resistive.T + s[:, None] * (drive_v @ readout.capacitive.T)
    filtered = (readout.response(s) @ volts[:, :, None])[:, :, 0]
    return np.asarray(filtered * readout.lag(s))


def linear_tones(system: System, frequency_hz: FloatArray, drive_v: ComplexArray) -> ComplexArray:
    """Y (N, S) [V] of a device without nonlinear effects, under the drives (N, D) [V]."""
    q = linear_motion_of(system, frequency_hz, acting_drive(system, frequency_hz, drive_v))
    return read_out(system, frequency_hz, linear_pickoff(system, frequency_hz, q), drive_v)
