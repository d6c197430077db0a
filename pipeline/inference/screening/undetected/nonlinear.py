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

from ....arrays import ComplexArray, FloatArray, IntArray
from ....device.effect import Context
from ....device.force_law import Laws, Points, force_along
from ....device.gyro import M_D, M_S
from .library import SHAPE, BandSignature, Probe, members_of, probes_of
from .linear import LinearDevice
from .narrow_band import Signals, at_phases, harmonics, whole_turn
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
    """A force in the band: its envelope (3, n') [V/s] at ``points`` (n',) of a grid, at a value of a parameter; its order."""

    probe: Probe
    points: IntArray
    envelope: ComplexArray
    value: float
    order: int


def forces_of(device: LinearDevice, signals: Signals, with_mismatch: bool) -> Iterator[BandForce]:
    """The force of each parameter of the force laws, along the motion of a device."""
    laws, loud = _laws(device), signals.loud
    motions: dict[tuple[bool, int], Points] = {}
    even: list[_EvenLaw] = []
    for probe in probes_of(with_mismatch, "force"):
        kind, p = kind_of(probe), probe.at(probe.member.scale)
        used, key = signals if kind.linear else loud, (kind.linear, kind.phases.size)
        if key not in motions:
            motions[key] = used.at(kind.phases)
        f = _along(probe, motions[key], p, laws)
        if kind.order == 1:
            yield BandForce(probe, used.kept, harmonics(f, kind.phases, 1)[0], probe.member.scale, 1)
        else:
            steady, double = harmonics(f, kind.phases, 0, 2)
            even.append(_EvenLaw(probe, p, steady.real, double))
    if even:
        phases = whole_turn()
        motion = motions.get((False, phases.size)) or loud.at(phases)
        yield from _second_order(even, device, loud, motion, laws)


def _along(probe: Probe, motion: Points, p: FloatArray, laws: Laws) -> FloatArray:
    assert probe.effect.force is not None
    return force_along(probe.effect.force, motion, p, laws)


@dataclass(frozen=True, eq=False)
class _EvenLaw:
    """A law without a first harmonic at parameters p (k,): its harmonics f_0 (3, n'), real, and f_2 (3, n') [V/s]."""

    probe: Probe
    p: FloatArray
    steady: FloatArray
    double: ComplexArray


def _second_order(
    even: Sequence[_EvenLaw], device: LinearDevice, signals: Signals, motion: Points, laws: Laws
) -> Iterator[BandForce]:
    """The forces of laws through what their own harmonics add to the ``motion`` at :func:`whole_turn`."""
    omega, stiffness = signals.grid.omega, device.mechanics.stiffness[0]
    static, fast = np.linalg.inv(np.stack([stiffness, stiffness - 4.0 * omega**2 * np.eye(3)]))
    level = _SHARE * omega**2 * _rms(signals.coordinates)
    phases = whole_turn()
    for law in even:
        size = max(_rms(law.steady), _rms(law.double))
        if size == 0.0:
            continue
        # To first order in the parameter, the deviation is proportional to it.
        share = level / size
        double = share * (fast @ law.double)
        added = at_phases(np.concatenate([double, 2j * omega * double]), 2.0 * phases)
        added[:3] += np.tile(0.5 * share * (static @ law.steady), phases.size)
        moved = motion.plus(added[:3], added[3:])
        (f,) = harmonics(_along(law.probe, moved, share * law.p, laws), phases, 1)
        yield BandForce(law.probe, signals.kept, f, share * law.probe.member.scale, 2)


@lru_cache(maxsize=64)
def _returns(probe: Probe) -> bool:
    """Whether a drive law has a part at the frequency of the drive: even laws have none."""
    assert probe.effect.drive is not None
    v = np.linspace(0.1, 1.0, 10)[:, None] * np.ones((1, SHAPE.drives))
    p = np.array([member.scale for member in members_of(probe.effect)])
    plus, minus = (probe.effect.drive(sign * v, p, Context(5.0, 5.0, {})) - sign * v for sign in (1.0, -1.0))
    return float(np.linalg.norm(plus - minus)) > _EVEN * float(np.linalg.norm(plus))


def drive_forces(device: LinearDevice, signals: Signals, with_mismatch: bool) -> Iterator[BandForce]:
    """The force of each parameter of the drive laws."""
    for probe in probes_of(with_mismatch, "drive"):
        if not _returns(probe):
            continue
        assert probe.effect.drive is not None
        v = at_phases(signals.drives, phases := whole_turn()).T
        (change,) = harmonics((probe.effect.drive(v, probe.at(probe.member.scale), device.context) - v).T, phases, 1)
        yield BandForce(probe, signals.kept, device.mechanics.drive[0] @ change, probe.member.scale, 1)


def sense_signatures(device: LinearDevice, signals: Signals, with_mismatch: bool) -> Iterator[BandSignature]:
    """Signatures of the sense laws."""
    m, phases = device.mechanics, whole_turn()
    motion = signals.at(phases)
    q, qd, t = motion.q, motion.qd, motion.t
    # Laws take points by channels (M n', S); their columns are contiguous.
    x, xd, s = (_MOTION_S @ q).T, (_MOTION_S @ qd).T, (m.velocity_sense[0] @ qd + m.position_sense[0] @ q).T
    few = slice(None, None, _SPARSE)
    level = _rms(s[few])
    found: list[tuple[Probe, float, int]] = []
    changes: list[ComplexArray] = []
    for probe in probes_of(with_mismatch, "sense"):
        sense, scale = probe.effect.sense, probe.member.scale
        assert sense is not None
        trial = sense(x[few], xd[few], s[few], t[few], probe.at(scale), device.context) - s[few]
        value = scale * _SHARE * level / _rms(trial)
        change = (sense(x, xd, s, t, probe.at(value), device.context) - s).T
        (first,) = harmonics(change, phases, 1)
        # An even law has a first harmonic of second order.
        found.append((probe, value, 1 if _rms(first) > 0.01 * _rms(change) else 2))
        changes.append(first)
    if changes:
        spectra = signals.grid.spectra(np.stack(changes)) * device.antialias
        for (probe, value, order), spectrum in zip(found, spectra):
            yield probe.signature(spectrum, value, order)
