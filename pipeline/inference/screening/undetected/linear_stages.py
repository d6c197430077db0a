"""Signatures of linear mechanics, from the change of poles and residues, and of the read-out.

    mechanics   dy = sum_k dR_k Phi_k + R_k dp_k dPhi_k/dp + conj
    readout     dy = dG(i w) S + d{G(i w)(R + i w C)} v

Shapes: S = 2 senses, W bins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray
from ....device.effect import Context
from ....device.mechanics import Mechanics
from ....device.readout import Readout, plain_readout
from ....experiment.antialias import filter_poles
from ..inband import Band
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


@dataclass(frozen=True, eq=False)
class _ReadoutChange:
    """Change of G (W, S, S), if any, and of the drive that is fed through (S, W) [V] per unit of a parameter."""

    probe: Probe
    through: ComplexArray | None
    fed: ComplexArray


@lru_cache(maxsize=8)
def _readout_changes(band: Band, probes: tuple[Probe, ...], bias_v: float) -> tuple[_ReadoutChange, ...]:
    """What all devices of a band share."""
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

    own, out = of(plain), []
    for probe in probes:
        assert probe.effect.readout is not None
        step = 1e-4 * probe.member.scale
        moved = of(probe.effect.readout(plain, probe.at(step), context))
        through = (moved[0] - own[0]) / step
        out.append(_ReadoutChange(probe, through if through.any() else None, (moved[1] - own[1]) / step))
    return tuple(out)


def readout_signatures(device: LinearDevice, with_mismatch: bool) -> Iterator[BandSignature]:
    """Signatures of the read-out."""
    before = device.sensed / device.antialias
    for change in _readout_changes(device.band, probes_of(with_mismatch, "readout"), device.context.bias_v):
        spectrum = change.fed
        if change.through is not None:
            spectrum = spectrum + np.einsum("wsr,rw->sw", change.through, before)
        yield change.probe.signature(spectrum, 1.0, 1)
