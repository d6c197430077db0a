"""Signatures of drive, force and sense laws along the motion of a device, from their first harmonic (``narrow_band``).

An effect is probed at a size that changes the motion by ``_SHARE``; a law without a first harmonic acts in second order, through
the deviation that its other harmonics cause.

Shapes: S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, RealArray
from ....device.effect import Context
from ....device.force_law import Laws, Points, force_along, in_single, single_force_along
from ....device.gyro import M_D, M_S
from ..inband import Band
from ..kept import kept_if_short
from .library import SHAPE, BandSignature, Probe, members_of, probes_of, write_real
from .linear import LinearDevice, shared_signals
from .narrow_band import WHOLE_TURN, Grid, Phases, Signals, at_phases, harmonics, motion_at_phases, write_first_harmonic
from .parity import LawKind, kind_of

#: Relative change of the motion by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
#: Every so many points a law is tried to find the size of its probe.
_SPARSE = 16
#: Phases of half a turn of a drive that clips, an odd law: its 15th harmonic is folded into the first.
_CLIP_PHASES = Phases(8, 0.5)
#: First harmonic of an even law relative to its other harmonics: rounding.
_EVEN = 1e-9
_MOTION_S: FloatArray = np.concatenate([M_S, np.ones((2, 1))], axis=1)
_MOTION_D: FloatArray = np.ascontiguousarray(np.concatenate([M_D.T, np.ones((2, 1))], axis=1))


def _rms(z: RealArray | AnyComplexArray) -> float:
    return math.sqrt(np.vdot(z, z).real / z.size)


@dataclass(frozen=True, eq=False)
class _LawsOf:
    """Linear mechanics of a device as force laws see them, in both precisions."""

    double: Laws
    single: Laws

    @classmethod
    def of(cls, device: LinearDevice) -> _LawsOf:
        m, c = device.mechanics, device.context
        damping, stiffness, drive = (np.ascontiguousarray(each[0]) for each in (m.damping, m.stiffness, m.drive))
        double = Laws(damping, stiffness, drive, _MOTION_D, c.bias_v, c.operating_bias_v, 2)
        return cls(double, in_single(double))


@dataclass(frozen=True, eq=False)
class BandForces:
    """Parameters whose forces in the band are known, each at its value; ``order`` is that of the force in the parameter."""

    probes: Sequence[Probe]
    values: Sequence[float]
    order: int


@lru_cache(maxsize=4)
def _kinds(with_mismatch: bool) -> tuple[tuple[LawKind, tuple[Probe, ...]], ...]:
    """The parameters of the force laws, those that are taken at the same phases together."""
    found: dict[tuple[bool, int, int, bool], tuple[LawKind, list[Probe]]] = {}
    for probe in probes_of(with_mismatch, "force"):
        kind = kind_of(probe)
        if kind.still:
            # What the drive alone makes at other harmonics does not mix with the motion.
            continue
        found.setdefault((kind.fades, kind.phases.count, kind.order, kind.single), (kind, []))[1].append(probe)
    return tuple((kind, tuple(probes)) for kind, probes in found.values())


def forces_of(
    device: LinearDevice, signals: Signals, with_mismatch: bool, out: AnyComplexArray
) -> Iterator[BandForces]:
    """The force of each parameter of the force laws, along the motion of a device.

    The envelopes [V/s] are written to the first of ``out`` (.., 3, n), which is zero before.
    """
    written = 0
    laws, loud = _LawsOf.of(device), signals.loud
    motions: dict[tuple[bool, int, bool], Points] = {}
    even: list[_EvenLaws] = []
    for kind, probes in _kinds(with_mismatch):
        used, key = loud if kind.fades else signals, (kind.fades, kind.phases.count, kind.single)
        if key not in motions:
            motions[key] = used.at(kind.phases, kind.single)
        values = [probe.member.scale for probe in probes]
        f = _along(probes, [motions[key]] * len(probes), values, laws)
        if kind.order == 1:
            write_first_harmonic(f, kind.phases, used.kept, out[written : written + len(probes)])
            written += len(probes)
            yield BandForces(probes, values, 1)
        else:
            steady, double = harmonics(f, kind.phases, 0, 2)
            even.append(_EvenLaws(probes, np.asarray(steady.real, np.float64), np.asarray(double, np.complex128)))
    if even:
        motion = motions.get((True, WHOLE_TURN.count, False)) or loud.at(WHOLE_TURN, False)
        yield _second_order(_EvenLaws.together(even), device, loud, motion, laws, out[written:])


def _along(probes: Sequence[Probe], motions: Sequence[Points], values: Sequence[float], laws: _LawsOf) -> RealArray:
    """Force (k, 3, M n') [V/s] of each of k parameters, at its value, along a motion of its own, in the motion's precision."""
    out = np.empty((len(probes), *motions[0].q.shape), dtype=motions[0].q.dtype)
    single = out.dtype == np.float32
    for own, probe, motion, value in zip(out, probes, motions, values):
        force, p = probe.effect.force, probe.at(value)
        assert force is not None
        if single:
            single_force_along(force, motion, p, laws.single, own)
        else:
            own[:] = force_along(force, motion, p, laws.double)
    return out


@dataclass(frozen=True, eq=False)
class _EvenLaws:
    """k laws without a first harmonic: their harmonics f_0 (k, 3, n'), real, and f_2 (k, 3, n') [V/s]."""

    probes: tuple[Probe, ...]
    steady: FloatArray
    double: ComplexArray

    @classmethod
    def together(cls, parts: Sequence[_EvenLaws]) -> _EvenLaws:
        """All laws of the parts, those without a force left out."""
        probes = tuple(probe for part in parts for probe in part.probes)
        steady, double = (np.concatenate(each) for each in zip(*((part.steady, part.double) for part in parts)))
        acting = np.flatnonzero(steady.any(axis=(1, 2)) | double.any(axis=(1, 2)))
        if acting.size < len(probes):
            return cls(tuple(probes[i] for i in acting), steady[acting], double[acting])
        return cls(probes, steady, double)


def _second_order(
    even: _EvenLaws, device: LinearDevice, signals: Signals, motion: Points, laws: _LawsOf, out: AnyComplexArray
) -> BandForces:
    """The forces of laws through what their own harmonics add to the ``motion`` at :data:`WHOLE_TURN`, written to ``out``."""
    omega, stiffness = signals.grid.omega, device.mechanics.stiffness[0]
    static, fast = np.linalg.inv(np.stack([stiffness, stiffness - 4.0 * omega**2 * np.eye(3)]))
    size = np.maximum(_rms_of_each(even.steady), _rms_of_each(even.double))
    # To first order in the parameter, the deviation is proportional to it.
    share = _SHARE * omega**2 * _rms(signals.coordinates) / size
    by_law = share[:, None, None]
    q, qd = motion_at_phases((fast * by_law) @ even.double, 2.0 * omega, WHOLE_TURN.doubled)
    by_phase = q.reshape(*even.steady.shape[:2], WHOLE_TURN.count, -1)
    by_phase += ((static * (0.5 * by_law)) @ even.steady)[:, :, None]
    q += motion.q
    qd += motion.qd
    values = [own * probe.member.scale for own, probe in zip(share.tolist(), even.probes)]
    moved = [Points(motion.t, *each, motion.u) for each in zip(q, qd)]
    f = _along(even.probes, moved, values, laws)
    write_first_harmonic(f, WHOLE_TURN, signals.kept, out[: len(even.probes)])
    return BandForces(even.probes, values, 2)


def _rms_of_each(z: FloatArray | ComplexArray) -> FloatArray:
    """Rms (k,) of arrays (k, ..)."""
    flat = np.ascontiguousarray(z).reshape(z.shape[0], -1).view(np.float64)
    return np.array([math.sqrt(np.vdot(own, own)) for own in flat]) / math.sqrt(z.size // z.shape[0])


@lru_cache(maxsize=64)
def _returns(probe: Probe) -> bool:
    """Whether a drive law has a part at the frequency of the drive: even laws have none."""
    assert probe.effect.drive is not None
    v = np.linspace(0.1, 1.0, 10)[:, None] * np.ones((1, SHAPE.drives))
    p = np.array([member.scale for member in members_of(probe.effect)])
    plus, minus = (probe.effect.drive(sign * v, p, Context(5.0, 5.0, {})) - sign * v for sign in (1.0, -1.0))
    return float(np.linalg.norm(plus - minus)) > _EVEN * float(np.linalg.norm(plus))


def drive_forces(
    device: LinearDevice, signals: Signals, sizes: Mapping[str, float], with_mismatch: bool, out: AnyComplexArray
) -> Iterator[BandForces]:
    """The force of each parameter of the drive laws, written to the first of ``out`` (.., 3, n); ``sizes``: of clipping."""
    envelopes = iter(out)
    grid, bias_v = signals.grid, device.context.bias_v
    for probe in probes_of(with_mismatch, "drive"):
        clips = probe.effect.clips("drive")
        if (probe.effect.name not in sizes) if clips else not _returns(probe):
            continue
        value = sizes.get(probe.effect.name, probe.member.scale)
        next(envelopes)[:] = device.mechanics.drive[0] @ _drive_change(grid.band, grid, probe, value, bias_v)
        yield BandForces((probe,), (value,), 1)


@kept_if_short(16)
def _drive_change(band: Band, grid: Grid, probe: Probe, value: float, bias_v: float) -> AnyComplexArray:
    """Change of the envelopes of the drive (D, n) [V] by a drive law at a value, which all devices of a band share."""
    assert probe.effect.drive is not None
    phases = _CLIP_PHASES if probe.effect.clips("drive") else WHOLE_TURN
    v = at_phases(shared_signals(band, grid)[1], phases).T
    change = probe.effect.drive(v, probe.at(value), Context(bias_v, bias_v, {})) - v
    return np.asarray(harmonics(change.T, phases, 1)[0], dtype=np.complex64)


def sense_signatures(
    device: LinearDevice, signals: Signals, with_mismatch: bool, out: FloatArray
) -> Iterator[BandSignature]:
    """Signatures of the sense laws, written to the first rows of ``out`` (.., S, 2 W)."""
    m, q, qd = device.mechanics, signals.coordinates, signals.velocities
    sensed = m.velocity_sense[0] @ qd + m.position_sense[0] @ q
    values = at_phases(np.concatenate([_MOTION_S @ q, _MOTION_S @ qd, sensed]), WHOLE_TURN)
    # Laws take points by channels (M n', S); their columns are contiguous.
    x, xd, s = values[:2].T, values[2:4].T, values[4:].T
    t = np.tile(signals.grid.time_s, WHOLE_TURN.count)
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
        (first,) = harmonics(change, WHOLE_TURN, 1)
        # An even law has a first harmonic of second order.
        found.append((probe, value, 1 if _rms(first) > 0.01 * _rms(change) else 2))
        changes.append(first)
    if changes:
        spectra = signals.grid.spectra(np.stack(changes).astype(np.complex64))
        spectra *= signals.grid.bin_scale * device.antialias
        write_real(spectra, out[: len(found)])
        for (probe, value, order), row in zip(found, out):
            yield probe.signature(row, value, order)
