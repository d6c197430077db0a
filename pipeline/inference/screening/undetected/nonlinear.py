"""Signatures of drive, force and sense laws along the motion of a device, from their first harmonic (``narrow_band``).

An effect is probed at a size that changes the motion by ``_SHARE``; a law without a first harmonic acts in second order, through
the deviation that its other harmonics cause.

Shapes: S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....device.effect import Effect
from ....device.force_law import Laws
from ....device.gyro import M_D, M_S
from ....device.parameters import Parameter
from .library import SHAPE, BandSignature, only, probed
from .linear import LinearDevice
from .narrow_band import Law, Signals, at_phases, first_harmonic, whole_turn

#: Relative change of the motion by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
#: Every so many points a law is tried to find the size of its probe.
_SPARSE = 16
#: First harmonic of an even law relative to its other harmonics: rounding.
_EVEN = 1e-9
_MOTION_S: FloatArray = np.concatenate([M_S, np.ones((2, 1))], axis=1)
_MOTION_D: FloatArray = np.ascontiguousarray(np.concatenate([M_D.T, np.ones((2, 1))], axis=1))


def _rms(z: FloatArray | ComplexArray) -> float:
    return float(np.linalg.norm(z)) / float(np.sqrt(z.size))


def _laws(device: LinearDevice) -> Laws:
    m, c = device.mechanics, device.context
    return Laws(
        np.ascontiguousarray(m.damping[0]),
        np.ascontiguousarray(m.stiffness[0]),
        np.ascontiguousarray(m.drive[0]),
        _MOTION_D,
        c.bias_v,
        c.operating_bias_v,
        2,
    )


@dataclass(frozen=True, eq=False)
class BandForce:
    """A force in the band: its envelope (n, 3) [V/s] at the value ``probe`` of a parameter, and the order of its law."""

    effect: Effect
    member: Parameter
    envelope: ComplexArray
    probe: float
    order: int


def forces_of(effect: Effect, device: LinearDevice, signals: Signals) -> Iterator[BandForce]:
    law, omega = Law(effect.force, _laws(device), signals), signals.grid.omega
    members = effect.members(SHAPE)
    few = law.sparse()
    points = int(few.signals.loud.sum())
    level = omega**2 * _rms(signals.coordinates[few.signals.loud])
    stiffness = device.mechanics.stiffness[0]
    for i, member in enumerate(members):
        # A cubic law needs one correction of the size, others none.
        size = np.linalg.norm(few.harmonics(only(len(members), i, member.scale), whole_turn()))
        if size == 0.0:
            continue
        probe = member.scale * _SHARE * level * float(np.sqrt(9.0 * points)) / float(size)
        p = only(len(members), i, probe)
        steady, first, double = law.harmonics(p, law.phases(p))
        if _rms(first) > _EVEN * max(_rms(steady), _rms(double)):
            yield BandForce(effect, member, first, probe, 1)
            continue
        d0 = 0.5 * steady @ np.linalg.inv(stiffness).T
        d2 = double @ np.linalg.inv(stiffness - 4.0 * omega**2 * np.eye(3)).T
        _, first, _ = law.harmonics(p, whole_turn(), (d0, d2))
        yield BandForce(effect, member, first, probe, 2)


def drive_forces(effect: Effect, device: LinearDevice, signals: Signals) -> Iterator[BandForce]:
    assert effect.drive is not None
    members = effect.members(SHAPE)
    v = at_phases(signals.drives)
    for i, member in enumerate(members):
        u = effect.drive(v, only(len(members), i, member.scale), device.context)
        change = first_harmonic(u - v, signals.grid.points)
        if _rms(change) > _EVEN * _rms(u - v):
            yield BandForce(effect, member, change @ device.mechanics.drive[0].T, member.scale, 1)


def sense_signatures(effect: Effect, device: LinearDevice, signals: Signals) -> Iterator[BandSignature]:
    assert effect.sense is not None
    members = effect.members(SHAPE)
    grid, m = signals.grid, device.mechanics
    q, qd = at_phases(signals.coordinates), at_phases(signals.velocities)
    x, xd = q @ _MOTION_S.T, qd @ _MOTION_S.T
    s = qd @ m.velocity_sense[0].T + q @ m.position_sense[0].T
    t = np.repeat(grid.time_s, s.shape[0] // grid.points)
    few = slice(None, None, _SPARSE)
    level = _rms(s[few])
    for i, member in enumerate(members):
        p = only(len(members), i, member.scale)
        trial = effect.sense(x[few], xd[few], s[few], t[few], p, device.context) - s[few]
        probe = member.scale * _SHARE * level / _rms(trial)
        change = effect.sense(x, xd, s, t, only(len(members), i, probe), device.context) - s
        first = first_harmonic(change, grid.points)
        # An even law has a first harmonic of second order.
        order = 1 if _rms(first) > 0.01 * _rms(change) else 2
        spectrum = grid.spectra(np.ascontiguousarray(first.T)) * device.antialias
        yield probed(effect, member, spectrum, probe, order)
