"""Forces of drive laws and signatures of sense laws along the motion of a device, from their first harmonic (``narrow_band``).

Shapes: S = 2 senses, W bins, n points of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, RealArray
from ....device.effect import Context
from ....device.gyro import M_S
from ..inband import Band
from ..kept import kept_if_short
from .library import SHAPE, BandSignature, Probe, members_of, probes_of, write_real
from .linear import LinearDevice, shared_signals
from .narrow_band import WHOLE_TURN, Grid, Phases, Signals, at_phases, harmonics

#: Relative change of the volts by a probe: second order is then 1e-8 of it, far above rounding and far below the signal.
_SHARE = 1e-4
#: Every so many points a law is tried to find the size of its probe.
_SPARSE = 16
#: Phases of half a turn of a drive that clips, an odd law: its 15th harmonic is folded into the first.
_CLIP_PHASES = Phases(8, 0.5)
#: First harmonic of an even law relative to its other harmonics: rounding.
_EVEN = 1e-9
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
