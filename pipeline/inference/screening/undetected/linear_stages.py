"""Signatures of linear mechanics, from the change of poles and residues, and of the read-out.

    mechanics   dy = sum_k dR_k Phi_k + R_k dp_k dPhi_k/dp + conj
    readout     dy = dG(i w) S + d{G(i w)(R + i w C)} v

Shapes: S = 2 senses, W bins.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray
from ....device.effect import Context
from ....device.mechanics import Mechanics
from ....device.readout import Readout, plain_readout
from ....experiment.antialias import filter_poles
from ..inband import Band
from ..kept import kept_if_short
from .library import SHAPE, BandSignature, Probe, probes_of
from .linear import LinearDevice, Moved, frequency_axis


@lru_cache(maxsize=4)
def mechanics_moves(with_mismatch: bool) -> tuple[tuple[Probe, float], ...]:
    """Effects of linear mechanics that add no coordinate, and the step of a parameter: ahead and behind, one after the other."""
    found = probes_of(with_mismatch, "mechanics")
    grids = {probe.effect.name for probe in found if probe.member.grid}
    return tuple(
        (probe, sign * 1e-4 * probe.member.scale)
        for probe in found
        if probe.effect.name not in grids
        for sign in (1.0, -1.0)
    )


def moved_mechanics(with_mismatch: bool, mechanics: Mechanics, context: Context) -> list[Mechanics]:
    """The mechanics with each of :func:`mechanics_moves`."""
    out = []
    for probe, step in mechanics_moves(with_mismatch):
        assert probe.effect.mechanics is not None
        out.append(probe.effect.mechanics(mechanics, probe.at(step), context))
    return out


def mechanics_signatures(device: LinearDevice, moved: Moved, with_mismatch: bool) -> Iterator[BandSignature]:
    """Signatures of linear mechanics, from the poles and residues with each of :func:`mechanics_moves`."""
    moves = mechanics_moves(with_mismatch)[::2]
    if not moves:
        return
    double = 2.0 * np.array([step for _, step in moves])
    poles = (moved.poles[::2] - moved.poles[1::2]) / double[:, None]
    residues = (moved.residues[::2] - moved.residues[1::2]) / double[:, None, None, None]
    spectra = device.read(residues, device.pickoff_residues * poles[:, :, None, None])
    for (probe, _), spectrum in zip(moves, spectra):
        yield probe.signature(spectrum, 1.0, 1)


@kept_if_short(8)
def _readout_changes(
    band: Band, with_mismatch: bool, bias_v: float
) -> tuple[tuple[BandSignature, ...], tuple[Probe, ...], ComplexArray]:
    """What all devices of a band share.

    The signatures of drive that is fed through; then the parameters that change the filter, and their change of G (k, S, S, W)
    per unit.
    """
    s, _, drive = frequency_axis(band)
    poles, residues = (
        (np.zeros(0, dtype=np.complex128),) * 2 if band.antialias is None else filter_poles(band.antialias)
    )
    plain = plain_readout(poles, residues, SHAPE.senses, SHAPE.drives)
    context = Context(bias_v, bias_v, {})

    def of(readout: Readout) -> tuple[ComplexArray, ComplexArray]:
        through = readout.response(s) * np.exp(-s * readout.delay_s)[:, None, None]
        fed = readout.resistive + s[:, None, None] * readout.capacitive
        return through, np.asarray(np.einsum("wsr,wrd,dw->sw", through, fed, drive))

    own = of(plain)
    fed: list[BandSignature] = []
    through: list[tuple[Probe, ComplexArray]] = []
    for probe in probes_of(with_mismatch, "readout"):
        assert probe.effect.readout is not None
        step = 1e-4 * probe.member.scale
        moved = of(probe.effect.readout(plain, probe.at(step), context))
        change = (moved[0] - own[0]) / step
        if change.any():
            through.append((probe, np.moveaxis(change, 0, 2) / frequency_axis(band)[1]))
        else:
            fed.append(probe.signature((moved[1] - own[1]) / step, 1.0, 1))
    stacked = np.stack([change for _, change in through]) if through else np.zeros((0, 2, 2, s.size), np.complex128)
    return tuple(fed), tuple(probe for probe, _ in through), stacked


def readout_signatures(device: LinearDevice, with_mismatch: bool) -> Iterator[BandSignature]:
    """Signatures of the read-out; a parameter changes either the filter or what is fed through."""
    fed, probes, through = _readout_changes(device.band, with_mismatch, device.context.bias_v)
    yield from fed
    spectra = through[:, :, 0] * device.sensed[0] + through[:, :, 1] * device.sensed[1]
    for probe, spectrum in zip(probes, spectra):
        yield probe.signature(spectrum, 1.0, 1)
