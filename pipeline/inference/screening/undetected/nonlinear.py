"""Forces of drive laws and changes by sense laws along the motion of a device, from their first harmonic (``narrow_band``).

Shapes: S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, RealArray
from ....device.effect import Context
from ....device.gyro import M_S
from ..inband import Band
from ..kept import kept_if_short
from .library import SHAPE, Acting, Changed, Probe, members_of, probes_of
from .linear import LinearDevice, frequency_axis, hold_response
from .narrow_band import WHOLE_TURN, Grid, Phases, Signals, at_phases, harmonics

#: Relative change of the volts by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
#: Every so many points a law is tried to find the size of its probe.
_SPARSE = 16
#: First harmonic of an even law relative to its other harmonics: rounding.
_EVEN = 1e-9
#: Phases of a linear law, and typical motion [V s] and velocity [V] of the points at which the kind of a law is found.
_LINEAR, _MOTION, _VELOCITY = Phases(2, 0.5), 1e-4, 0.3
#: What a sense law takes: motion and velocity of the electrodes, volts (M n, S) [V s, V, V], and times (M n,) [s].
SensedMotion = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
_MOTION_S: FloatArray = np.concatenate([M_S, np.ones((2, 1))], axis=1)


def _rms(z: RealArray | AnyComplexArray) -> float:
    return math.sqrt(np.vdot(z, z).real / z.size)


@lru_cache(maxsize=64)
def _returns(probe: Probe) -> bool:
    """Whether a drive law has a part at the frequency of the drive: even laws have none."""
    assert probe.effect.drive is not None
    v = np.linspace(0.1, 1.0, 10)[:, None] * np.ones((1, SHAPE.drives))
    p = np.array([member.scale for member in members_of(probe.effect)])
    plus, minus = (probe.effect.drive(sign * v, p, Context(5.0, 5.0, {})) - sign * v for sign in (1.0, -1.0))
    return float(np.linalg.norm(plus - minus)) > _EVEN * float(np.linalg.norm(plus))


def drive_force(
    device: LinearDevice, grid: Grid, probe: Probe, sizes: Mapping[str, float]
) -> tuple[float, AnyComplexArray] | None:
    """Value of the parameter of a drive law and its force (3, n) [V/s], if it acts; ``sizes``: of clipping."""
    clips = probe.effect.clips("drive")
    if (probe.effect.name not in sizes) if clips else not _returns(probe):
        return None
    value = sizes.get(probe.effect.name, probe.member.scale)
    change = _drive_change(device.band, grid, probe, value, device.context.bias_v)
    return value, device.mechanics.drive[0].astype(np.complex64) @ change


@kept_if_short(16)
def _drive_change(band: Band, grid: Grid, probe: Probe, value: float, bias_v: float) -> AnyComplexArray:
    """Change of the envelopes of the drive (D, n) [V] by a drive law at a value, which all devices of a band share.

    From all samples: a chirp that clips from the first sample on has an edge there, of which its envelopes at the points of the
    grid show too little: they left 57 % of the change of the record.
    """
    assert probe.effect.drive is not None
    v = band.drive_v
    change = probe.effect.drive(v, probe.at(value), Context(bias_v, bias_v, {})) - v
    spectrum = band.transform(change) * (hold_response(band) / grid.bin_scale)
    return np.asarray(grid.envelopes(spectrum), dtype=np.complex64)


def _change_at_points(probe: Probe, factor: float) -> tuple[SensedMotion, FloatArray]:
    """Fixed points of a motion times a factor, and the change of the volts (8, S) [V] there by a sense law."""
    assert probe.effect.sense is not None
    random = np.random.default_rng(1)
    x, xd, s = (factor * scale * random.standard_normal((8, SHAPE.senses)) for scale in (_MOTION, _VELOCITY, _VELOCITY))
    t = random.random(8)
    return (x, xd, s, t), probe.effect.sense(x, xd, s, t, probe.at(probe.member.scale), Context(5.0, 5.0, {})) - s


@lru_cache(maxsize=64)
def _is_linear(probe: Probe) -> bool:
    """Whether the change of the volts by a sense law is linear in the motion, at fixed points."""
    once, twice = (_change_at_points(probe, factor)[1] for factor in (1.0, 2.0))
    return float(np.linalg.norm(twice - 2.0 * once)) <= _EVEN * float(np.linalg.norm(once))


@lru_cache(maxsize=64)
def drift_of(probe: Probe) -> float:
    """c [1/s] of a sense law that changes the volts by p c t s with its parameter p; 0.0 for other laws."""
    (*_, s, t), change = _change_at_points(probe, 1.0)
    p, grown = probe.member.scale, t[:, None] * s
    rate = float(np.vdot(grown, change) / np.vdot(grown, grown))
    return rate / p if np.linalg.norm(change - rate * grown) <= _EVEN * np.linalg.norm(change) else 0.0


def sense_changes(device: LinearDevice, signals: Signals, with_mismatch: bool) -> Changed:
    """What the sense laws change but for drifts of the gain.  Two phases give the first harmonic of a linear law."""
    probes = [probe for probe in probes_of(with_mismatch, "sense") if not drift_of(probe)]
    m, grid = device.mechanics, signals.grid
    sensed = m.velocity_sense[0] @ signals.velocities + m.position_sense[0] @ signals.coordinates
    envelopes = np.concatenate([_MOTION_S @ signals.coordinates, _MOTION_S @ signals.velocities, sensed])
    motions: dict[Phases, SensedMotion] = {}
    changes = np.empty((len(probes), SHAPE.senses, grid.points), dtype=np.complex64)
    found = []
    for probe, change in zip(probes, changes):
        phases = _LINEAR if _is_linear(probe) else WHOLE_TURN
        if phases not in motions:
            values = at_phases(envelopes, phases)
            # Laws take points by channels (M n, S); their columns are contiguous.
            motions[phases] = values[:2].T, values[2:4].T, values[4:].T, _times(device.band, grid, phases)
        value, order, change[:] = _sense_change(probe, motions[phases], phases, device.context)
        found.append(Acting(probe, value, order))
    spectra = grid.spectra(changes)
    spectra *= _unit_gain(device.band, grid)
    return Changed(found, spectra)


def _sense_change(
    probe: Probe, motion: SensedMotion, phases: Phases, context: Context
) -> tuple[float, int, ComplexArray]:
    """Value of the parameter of a sense law, order of the change in it, and its first harmonic (S, n) [V]."""
    sense, value, linear = probe.effect.sense, probe.member.scale, phases == _LINEAR
    assert sense is not None
    x, xd, s, t = motion
    if not linear:
        few = slice(None, None, _SPARSE)
        trial = sense(x[few], xd[few], s[few], t[few], probe.at(value), context) - s[few]
        value *= _SHARE * _rms(s[few]) / _rms(trial)
    change = (sense(x, xd, s, t, probe.at(value), context) - s).T
    (first,) = harmonics(change, phases, 1)
    # An even law has a first harmonic of second order.
    return value, 1 if linear or _rms(first) > 0.01 * _rms(change) else 2, first


@kept_if_short(4)
def _times(band: Band, grid: Grid, phases: Phases) -> FloatArray:
    """Times (M n,) [s] of the points of a grid at each of the phases."""
    return np.tile(grid.time_s, phases.count)


@kept_if_short(4)
def _unit_gain(band: Band, grid: Grid) -> AnyComplexArray:
    """What turns the transforms of envelopes into volts behind the filter (W,), which all devices of a band share."""
    return np.asarray(grid.bin_scale * frequency_axis(band)[1], dtype=np.complex64)
