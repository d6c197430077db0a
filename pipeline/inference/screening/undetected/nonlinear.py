"""Signatures of drive, force and sense laws along the motion of a device, from their first harmonic (``narrow_band``).

An effect is probed at a size that changes the motion by ``_SHARE``; a law without a first harmonic acts in second order, through
the deviation that its other harmonics cause.

Shapes: S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....device.effect import Context, Effect
from ....device.force_law import Laws
from ....device.gyro import M_D, M_S
from ....device.parameters import Parameter
from .library import SHAPE, BandSignature, members_of, only, probed
from .linear import LinearDevice
from .narrow_band import PHASES, ProbedLaw, Signals, at_phases, first_harmonic, force_harmonics, whole_turn
from .parity import kind_of

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
    """A force in the band: its envelope (3, n) [V/s] at the value ``probe`` of a parameter, and the order of its law."""

    effect: Effect
    member: Parameter
    envelope: ComplexArray
    probe: float
    order: int


def forces_of(effects: Sequence[Effect], device: LinearDevice, signals: Signals) -> Iterator[BandForce]:
    """The force of each parameter of the effects, along the motion of a device."""
    every = [
        (effect, i, member, kind_of(effect, i)) for effect in effects for i, member in enumerate(members_of(effect))
    ]
    for linear, used in ((True, signals), (False, signals.loud)):
        own = [(effect, i, member, kind) for effect, i, member, kind in every if kind.linear == linear]
        laws = [
            ProbedLaw(effect.force, only(len(members_of(effect)), i, member.scale), kind.phases)
            for effect, i, member, kind in own
        ]
        found = force_harmonics(laws, _laws(device), used)
        for (effect, _, member, kind), (_, first, _) in zip(own, found):
            if kind.order == 1:
                yield BandForce(effect, member, used.whole([first])[0], member.scale, 1)
        even = [
            (effect, member, law, f) for (effect, _, member, kind), law, f in zip(own, laws, found) if kind.order == 2
        ]
        yield from _second_order(even, device, used)


def _second_order(
    laws: Sequence[tuple[Effect, Parameter, ProbedLaw, ComplexArray]], device: LinearDevice, signals: Signals
) -> Iterator[BandForce]:
    """The forces of laws through the motion that their harmonics f_0, f_1, f_2 (3, n', 3) cause."""
    omega, stiffness = signals.grid.omega, device.mechanics.stiffness[0]
    static, fast = np.linalg.inv(stiffness).T, np.linalg.inv(stiffness - 4.0 * omega**2 * np.eye(3)).T
    level = _SHARE * omega**2 * _rms(signals.coordinates)
    moved: list[tuple[Effect, Parameter, float]] = []
    again: list[ProbedLaw] = []
    for effect, member, law, (steady, _, double) in laws:
        size = max(_rms(steady), _rms(double))
        if size > 0.0:
            # To first order in the parameter, the deviation is proportional to it.
            share = level / size
            deviation = 0.5 * share * steady.real @ static, share * double @ fast
            again.append(ProbedLaw(law.force, share * law.p, whole_turn(), *deviation))
            moved.append((effect, member, share * member.scale))
    for (effect, member, probe), (_, first, _) in zip(moved, force_harmonics(again, _laws(device), signals)):
        yield BandForce(effect, member, signals.whole([first])[0], probe, 2)


@lru_cache(maxsize=64)
def _returns(effect: Effect) -> bool:
    """Whether a drive law has a part at the frequency of the drive: even laws have none."""
    assert effect.drive is not None
    v = np.linspace(0.1, 1.0, 10)[:, None] * np.ones((1, SHAPE.drives))
    p = np.array([member.scale for member in members_of(effect)])
    plus, minus = (effect.drive(sign * v, p, Context(5.0, 5.0, {})) - sign * v for sign in (1.0, -1.0))
    return float(np.linalg.norm(plus - minus)) > _EVEN * float(np.linalg.norm(plus))


def drive_forces(effect: Effect, device: LinearDevice, signals: Signals) -> Iterator[BandForce]:
    """The force of each parameter of a drive law."""
    assert effect.drive is not None
    members = members_of(effect) if _returns(effect) else ()
    v = at_phases(signals.drives)
    for i, member in enumerate(members):
        change = first_harmonic(effect.drive(v, only(len(members), i, member.scale), device.context) - v)
        yield BandForce(effect, member, signals.whole([change @ device.mechanics.drive[0].T])[0], member.scale, 1)


def sense_signatures(effects: Sequence[Effect], device: LinearDevice, signals: Signals) -> Iterator[BandSignature]:
    """Signatures of sense laws, in the order of their effects and parameters."""
    m = device.mechanics
    q, qd = at_phases(signals.coordinates), at_phases(signals.velocities)
    x, xd = q @ _MOTION_S.T, qd @ _MOTION_S.T
    s = qd @ m.velocity_sense[0].T + q @ m.position_sense[0].T
    t = np.tile(signals.time_s, PHASES)
    few = slice(None, None, _SPARSE)
    level = _rms(s[few])
    found: list[tuple[Effect, Parameter, float, int]] = []
    changes: list[ComplexArray] = []
    for effect in effects:
        members = members_of(effect)
        for i, member in enumerate(members):
            assert effect.sense is not None
            p = only(len(members), i, member.scale)
            trial = effect.sense(x[few], xd[few], s[few], t[few], p, device.context) - s[few]
            probe = member.scale * _SHARE * level / _rms(trial)
            change = effect.sense(x, xd, s, t, only(len(members), i, probe), device.context) - s
            first = first_harmonic(change)
            # An even law has a first harmonic of second order.
            found.append((effect, member, probe, 1 if _rms(first) > 0.01 * _rms(change) else 2))
            changes.append(first)
    if changes:
        spectra = signals.grid.spectra(signals.whole(changes)) * device.antialias
        for (effect, member, probe, order), spectrum in zip(found, spectra):
            yield probed(effect, member, spectrum, probe, order)
