"""Signatures of linear mechanics, from the change of poles and residues, and of the read-out.

    mechanics   dy = sum_k dR_k Phi_k + R_k dp_k dPhi_k/dp + conj
    readout     dy = dG(i w) S + d{G(i w)(R + i w C)} v + sum_d dL_d(i w) S_d - d delta t dS/dt + d gamma t S

with the lag L_d of drive d and its part S_d of the volts, the offset delta of the clock, and the drift gamma of the gain.

Shapes: S = 2 senses, W bins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray, FloatArray, RealArray
from ....device.effect import Context
from ....device.mechanics import Mechanics
from ....device.readout import Readout, plain_readout
from ....experiment.antialias import filter_poles
from ..inband import Band
from ..kept import kept_if_short
from .library import SHAPE, Acting, Changed, Probe, probes_of, write_real
from .linear import BandMotion, LinearDevice, Moved, frequency_axis
from .loops import read_out
from .narrow_band import Grid
from .nonlinear import drift_of


@lru_cache(maxsize=4)
def mechanics_moves(with_mismatch: bool) -> tuple[tuple[Probe, float], ...]:
    """Effects of linear mechanics that add no coordinate, and the step of a parameter."""
    found = probes_of(with_mismatch, "mechanics")
    grids = {probe.effect.name for probe in found if probe.scanned}
    return tuple((probe, 1e-4 * probe.member.scale) for probe in found if probe.effect.name not in grids)


def moved_mechanics(with_mismatch: bool, mechanics: Mechanics, context: Context) -> list[tuple[Mechanics, Mechanics]]:
    """The mechanics a step ahead and a step behind in each of :func:`mechanics_moves`."""
    out = []
    for probe, step in mechanics_moves(with_mismatch):
        effect = probe.effect.mechanics
        assert effect is not None
        ahead, behind = (effect(mechanics, probe.at(sign * step), context) for sign in (1.0, -1.0))
        out.append((ahead, behind))
    return out


def mechanics_coefficients(device: LinearDevice, moved: Moved, with_mismatch: bool) -> tuple[list[Probe], FloatArray]:
    """Parameters of linear mechanics, and their signatures as coefficients (k, S, J) of the features."""
    moves = mechanics_moves(with_mismatch)
    double = 2.0 * np.array([step for _, step in moves])
    poles, residues = moved.poles / double[:, None], moved.residues / double[:, None, None, None]
    return [probe for probe, _ in moves], device.coefficients(
        residues, device.pickoff_residues * poles[:, :, None, None]
    )


@dataclass(frozen=True, eq=False)
class _ReadoutChanges:
    """What all devices of a band share.

    Parameters
    ----------
    fed, fed_rows : parameters that feed the drive through, and their signatures (k, S, 2 W) per unit.
    through, filters : parameters that change the filter, and their change of G (k, S, S, 2 W) per unit, in single precision.
    lagged, lags : parameters that change the lag of a drive, and their change of it (k, D, 2 W) per unit, in single precision.
    clocks : parameters that change the clock, each with the offset per unit.
    """

    fed: tuple[Probe, ...]
    fed_rows: FloatArray
    through: tuple[Probe, ...]
    filters: RealArray
    lagged: tuple[Probe, ...]
    lags: RealArray
    clocks: tuple[tuple[Probe, float], ...]


@kept_if_short(8)
def _readout_changes(band: Band, with_mismatch: bool, bias_v: float) -> _ReadoutChanges:
    s, _, drive = frequency_axis(band)
    poles, residues = (
        (np.zeros(0, dtype=np.complex128),) * 2 if band.antialias is None else filter_poles(band.antialias)
    )
    plain = plain_readout(poles, residues, SHAPE.senses, SHAPE.drives)
    context = Context(bias_v, bias_v, {})

    def of(readout: Readout) -> tuple[ComplexArray, ComplexArray]:
        through = readout.response(s) * readout.lag(s)[:, :, None]
        fed = readout.resistive + s[:, None, None] * readout.capacitive
        return through, np.asarray(np.einsum("wsr,wrd,dw->sw", through, fed, drive))

    own = of(plain)
    fed: list[tuple[Probe, ComplexArray]] = []
    through: list[tuple[Probe, ComplexArray]] = []
    lags: list[tuple[Probe, ComplexArray]] = []
    clocks: list[tuple[Probe, float]] = []
    for probe in probes_of(with_mismatch, "readout"):
        assert probe.effect.readout is not None
        step = 1e-4 * probe.member.scale
        readout = probe.effect.readout(plain, probe.at(step), context)
        moved = of(readout)
        change = (moved[0] - own[0]) / step
        if readout.clock_offset:
            clocks.append((probe, readout.clock_offset / step))
        elif (lag := readout.drive_lag(s) - 1.0).any():
            lags.append((probe, lag.T / step))
        elif change.any():
            through.append((probe, np.moveaxis(change, 0, 2) / frequency_axis(band)[1]))
        else:
            fed.append((probe, (moved[1] - own[1]) / step))
    fed_rows = np.empty((len(fed), SHAPE.senses, 2 * s.size))
    for row, (_, spectrum) in zip(fed_rows, fed):
        write_real(spectrum, row)
    return _ReadoutChanges(
        tuple(probe for probe, _ in fed),
        fed_rows,
        tuple(probe for probe, _ in through),
        _single([change for _, change in through], (SHAPE.senses, SHAPE.senses, s.size)),
        tuple(probe for probe, _ in lags),
        _single([lag for _, lag in lags], (SHAPE.drives, s.size)),
        tuple(clocks),
    )


def _single(changes: Sequence[ComplexArray], shape: tuple[int, ...]) -> RealArray:
    """Changes (k, .., 2 W) of complex ones of a shape (.., W) in single precision."""
    out = np.empty((len(changes), *shape[:-1], 2 * shape[-1]), dtype=np.float32)
    for own, change in zip(out, changes):
        write_real(change, own)
    return out


def readout_signatures(device: LinearDevice, motion: BandMotion, with_mismatch: bool, out: FloatArray) -> list[Acting]:
    """Changes of what is fed through, the filter, or the lag of a drive, written to the first rows of ``out`` (.., S, 2 W)."""
    changes = _readout_changes(device.band, with_mismatch, device.context.bias_v)
    first = len(changes.fed)
    out[:first] = changes.fed_rows
    read_out(changes.filters, changes.lags, motion.sensed, motion.of_drives, out[first:])
    return [Acting(probe, 1.0, 1) for probe in (*changes.fed, *changes.through, *changes.lagged)]


def time_changes(
    devices: Sequence[LinearDevice], motions: Sequence[BandMotion], grid: Grid, with_mismatch: bool
) -> list[Changed]:
    """What offsets of the clock and drifts of the gain change, of devices in the same band.

    Envelopes at the points of the grid are too few for t S, which jumps at the end of the record: they left 1.2 % of the change.
    """
    band, bias_v = devices[0].band, devices[0].context.bias_v
    clocks = _readout_changes(band, with_mismatch, bias_v).clocks
    gains = [(probe, drift_of(probe)) for probe in probes_of(with_mismatch, "sense") if drift_of(probe)]
    bins, omega = band.bins.size, devices[0].s.imag
    # -dS/dt, then S.
    signals = np.empty((len(devices), 2, SHAPE.senses, bins), dtype=np.complex64)
    for (slope, plain), motion in zip(signals, motions):
        real, imaginary = motion.sensed[:, :bins], motion.sensed[:, bins:]
        slope.real, slope.imag = omega * imaginary, -omega * real
        plain.real, plain.imag = real, imaginary
    grown = grid.over_time(signals)
    rates = np.array([rate for _, rate in (*clocks, *gains)], dtype=np.float32)
    which = [0] * len(clocks) + [1] * len(gains)
    acting = [Acting(probe, 1.0, 1) for probe, _ in (*clocks, *gains)]
    return [Changed(acting, rates[:, None, None] * own[which]) for own in grown]
