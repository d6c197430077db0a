"""Signatures of the effects of the library in the band of a device, by stage of the signal path, without simulation.

| stage              | change of the record in the band |
|---|---|
| drive, force       | response to the first harmonic of the force (``narrow_band``) |
| mechanics          | change of poles and residues |
| sense              | first harmonic of the change of the pick-off volts, through the filter |
| readout            | change of G(i w) S + G(i w)(R + i w C) v |
| adc                | transform of the change of the model's volts |

An effect is probed at a size that changes the motion by ``_SHARE``; a law without a first harmonic acts in second order, through
its own deviation.  The strength is the factor of the probe's signature: a / a_probe, or its square in second order.

Shapes: S = 2 senses, W bins, n points, N samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....device.effect import Context, Effect
from ....device.force_law import Laws
from ....device.gyro import M_D, M_S
from ....device.mechanics import Mechanics, modes_of
from ....device.model import Model
from ....device.parameters import Parameter, Shape
from ....device.readout import Readout, plain_readout
from ....experiment.antialias import filter_poles
from ..inband import Band
from ..mismatch import NIGHTLY_MODEL
from .linear import LinearDevice, hold_response, in_order
from .narrow_band import Law, Signals, at_phases, first_harmonic, grid_of, whole_turn

#: Relative change of the motion by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
#: Every so many points a law is tried to find the size of its probe.
_SPARSE = 16
#: First harmonic of an even law relative to its other harmonics: rounding.
_EVEN = 1e-9
_MOTION_S: FloatArray = np.concatenate([M_S, np.ones((2, 1))], axis=1)
_MOTION_D: FloatArray = np.ascontiguousarray(np.concatenate([M_D.T, np.ones((2, 1))], axis=1))


@dataclass(frozen=True, eq=False)
class BandSignature:
    """Change of the spectrum (S, W) [V] of a record at unit strength, and the range (low, high) of the strength."""

    effect: str
    spectrum: ComplexArray
    low: float
    high: float


@lru_cache(maxsize=4)
def scored_effects(with_mismatch: bool) -> tuple[Effect, ...]:
    """The effects of the library that a fit lacks: neither in its model nor inside an effect of its model."""
    model = NIGHTLY_MODEL if with_mismatch else Model(effects=NIGHTLY_MODEL.effects[:-1])
    found = (model.effect(name) for name in model.candidates())
    own = set(model.effects)
    return tuple(e for e in found if not any(other.always and set(other.effects) <= own for other in e.look_alikes))


def _range(member: Parameter, probe: float, order: int) -> tuple[float, float]:
    low, high = member.low / probe, member.high / probe
    return (min(low, 0.0), high) if order == 1 else (0.0, max(abs(low), abs(high)) ** 2)


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


def _one(size: int, i: int, value: float) -> FloatArray:
    p = np.zeros(size)
    p[i] = value
    return p


@dataclass(frozen=True, eq=False)
class _Force:
    """A force in the band: its envelope (n, 3) [V/s] at unit strength, and the range of the strength."""

    effect: str
    envelope: ComplexArray
    low: float
    high: float


def _force_of(effect: Effect, device: LinearDevice, signals: Signals, shape: Shape) -> Iterator[_Force]:
    law, omega = Law(effect.force, _laws(device), signals), signals.grid.omega
    members = effect.members(shape)
    few = law.sparse()
    points = int(few.signals.loud.sum())
    level = omega**2 * _rms(signals.coordinates[few.signals.loud])
    stiffness = device.mechanics.stiffness[0]
    for i, member in enumerate(members):
        # A cubic law needs one correction of the size, others none.
        size = np.linalg.norm(few.harmonics(_one(len(members), i, member.scale), whole_turn()))
        if size == 0.0:
            continue
        probe = member.scale * _SHARE * level * float(np.sqrt(9.0 * points)) / float(size)
        p = _one(len(members), i, probe)
        steady, first, double = law.harmonics(p, law.phases(p))
        if _rms(first) > _EVEN * max(_rms(steady), _rms(double)):
            yield _Force(effect.name, first, *_range(member, probe, 1))
            continue
        d0 = 0.5 * steady @ np.linalg.inv(stiffness).T
        d2 = double @ np.linalg.inv(stiffness - 4.0 * omega**2 * np.eye(3)).T
        _, first, _ = law.harmonics(p, whole_turn(), (d0, d2))
        yield _Force(effect.name, first, *_range(member, probe, 2))


def _drive_of(effect: Effect, device: LinearDevice, signals: Signals, shape: Shape) -> Iterator[_Force]:
    assert effect.drive is not None
    members = effect.members(shape)
    v = at_phases(signals.drives)
    for i, member in enumerate(members):
        u = effect.drive(v, _one(len(members), i, member.scale), device.context)
        change = first_harmonic(u - v, signals.grid.points)
        if _rms(change) > _EVEN * _rms(u - v):
            yield _Force(effect.name, change @ device.mechanics.drive[0].T, *_range(member, member.scale, 1))


def _sense_of(effect: Effect, device: LinearDevice, signals: Signals, shape: Shape) -> Iterator[BandSignature]:
    assert effect.sense is not None
    members = effect.members(shape)
    grid, m = signals.grid, device.mechanics
    q, qd = at_phases(signals.coordinates), at_phases(signals.velocities)
    x, xd = q @ _MOTION_S.T, qd @ _MOTION_S.T
    s = qd @ m.velocity_sense[0].T + q @ m.position_sense[0].T
    t = np.repeat(grid.time_s, s.shape[0] // grid.points)
    few = slice(None, None, _SPARSE)
    level = _rms(s[few])
    for i, member in enumerate(members):
        p = _one(len(members), i, member.scale)
        trial = effect.sense(x[few], xd[few], s[few], t[few], p, device.context) - s[few]
        probe = member.scale * _SHARE * level / _rms(trial)
        change = effect.sense(x, xd, s, t, _one(len(members), i, probe), device.context) - s
        first = first_harmonic(change, grid.points)
        # An even law has a first harmonic of second order.
        order = 1 if _rms(first) > 0.01 * _rms(change) else 2
        spectrum = grid.spectra(np.ascontiguousarray(first.T)) * device.antialias
        yield BandSignature(effect.name, spectrum, *_range(member, probe, order))


def _mechanics_of(device: LinearDevice, effects: Sequence[Effect], shape: Shape) -> Iterator[BandSignature]:
    """Signatures of all effects of linear mechanics that add no coordinate, from one decomposition."""
    found: list[tuple[str, Parameter, float, Mechanics]] = []
    for effect in effects:
        members = effect.members(shape)
        if effect.mechanics is None or any(member.grid for member in members):
            continue
        for i, member in enumerate(members):
            for step in (1e-4 * member.scale, -1e-4 * member.scale):
                moved = effect.mechanics(device.mechanics, _one(len(members), i, step), device.context)
                found.append((effect.name, member, step, moved))
    if not found:
        return
    names = [field.name for field in fields(Mechanics)]
    together = Mechanics(*(np.concatenate([getattr(m, name) for *_, m in found]) for name in names))
    modes = modes_of(together)
    own = device.pickoff_residues()
    for i in range(0, len(found), 2):
        name, member, step, _ = found[i]
        ahead, behind = in_order(modes, device.poles, i), in_order(modes, device.poles, i + 1)
        poles, residues = (ahead[0] - behind[0]) / (2.0 * step), (ahead[1] - behind[1]) / (2.0 * step)
        yield BandSignature(name, device.read(residues, own * poles[:, None, None]), *_range(member, 1.0, 1))


@dataclass(frozen=True, eq=False)
class _ReadoutChange:
    """Change of G (W, S, S) and of the drive that is fed through (S, W) [V] per unit of a parameter: the same for all devices."""

    effect: str
    member: Parameter
    through: ComplexArray
    fed: ComplexArray


@lru_cache(maxsize=8)
def _readout_changes(
    band: Band, effects: tuple[Effect, ...], shape: Shape, bias_v: float
) -> tuple[_ReadoutChange, ...]:
    s = np.asarray(2j * np.pi * band.frequency_hz, dtype=np.complex128)
    poles, residues = (
        (np.zeros(0, dtype=np.complex128),) * 2 if band.antialias is None else filter_poles(band.antialias)
    )
    plain = plain_readout(poles, residues, shape.senses, shape.drives)
    drive = band.now * hold_response(band)
    context = Context(bias_v, bias_v, {})

    def of(readout: Readout) -> tuple[ComplexArray, ComplexArray]:
        through = readout.response(s) * np.exp(-s * readout.delay_s)[:, None, None]
        fed = readout.resistive + s[:, None, None] * readout.capacitive
        return through, np.asarray(np.einsum("wsr,wrd,dw->sw", through, fed, drive))

    own, out = of(plain), []
    for effect in effects:
        members = effect.members(shape)
        for i, member in enumerate(members if effect.readout is not None else ()):
            assert effect.readout is not None
            step = 1e-4 * member.scale
            moved = of(effect.readout(plain, _one(len(members), i, step), context))
            out.append(_ReadoutChange(effect.name, member, (moved[0] - own[0]) / step, (moved[1] - own[1]) / step))
    return tuple(out)


def _readout_of(device: LinearDevice, effects: tuple[Effect, ...], shape: Shape) -> Iterator[BandSignature]:
    before = device.sensed() / device.antialias
    for change in _readout_changes(device.band, effects, shape, device.context.bias_v):
        spectrum = change.fed
        if change.through.any():
            spectrum = spectrum + np.einsum("wsr,rw->sw", change.through, before)
        yield BandSignature(change.effect, spectrum, *_range(change.member, 1.0, 1))


def _adc_of(
    effect: Effect, device: LinearDevice, model_v: FloatArray, sigma_v: FloatArray, shape: Shape
) -> Iterator[BandSignature]:
    """One probe, at which the samples change by about ``_CLIPPED`` sigmas in all: less is invisible, more is loud."""
    assert effect.adc is not None
    adc, members = effect.adc, effect.members(shape)
    if len(members) != 1:
        return
    member = members[0]
    size = np.max(np.abs(model_v), axis=1)
    loud = np.flatnonzero(size > _LOUD * float(size.max()))
    volts = model_v[loud]

    def change(value: float) -> FloatArray:
        return adc(volts, np.array([value]), device.context) - volts

    low, high = 1e-6 * member.scale, member.high
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        moved = change(middle)
        found = float(np.linalg.norm(moved / sigma_v))
        low, high = (low, middle) if found > _CLIPPED else (middle, high)
        if 0.5 * _CLIPPED < found < 2.0 * _CLIPPED:
            break
    whole = np.zeros_like(model_v)
    whole[loud] = moved
    yield BandSignature(effect.name, device.band.transform(whole), 0.0, np.inf)


#: Samples within 10 % of the peak hold all that a clip changes while it is weak.
_LOUD = 0.9
#: Sigmas.
_CLIPPED = 30.0


def signatures(
    device: LinearDevice, model_v: FloatArray, sigma_v: FloatArray, with_mismatch: bool
) -> tuple[BandSignature, ...]:
    """All signatures of the effects that a fit lacks.

    Parameters
    ----------
    device : at the maximum of the likelihood, in the band of a record.
    model_v : its volts (N, S) [V].
    sigma_v : noise (S,) [V].
    with_mismatch : whether the fit has electrode mismatches.
    """
    shape, effects = NIGHTLY_MODEL.built.shape, scored_effects(with_mismatch)
    grid = grid_of(device.band)
    signals = device.signals(grid)
    found: list[BandSignature] = []
    forces: list[_Force] = []
    for effect in effects:
        if effect.drive is not None:
            forces += _drive_of(effect, device, signals, shape)
        if effect.force is not None:
            forces += _force_of(effect, device, signals, shape)
        if effect.sense is not None:
            found += _sense_of(effect, device, signals, shape)
        if effect.adc is not None:
            found += _adc_of(effect, device, model_v, sigma_v, shape)
    found += _mechanics_of(device, effects, shape)
    found += _readout_of(device, effects, shape)
    if forces:
        volts = device.forced(np.stack([f.envelope for f in forces]), grid)
        found += [BandSignature(f.effect, y, f.low, f.high) for f, y in zip(forces, volts)]
    return tuple(sorted(found, key=lambda one: one.effect))
