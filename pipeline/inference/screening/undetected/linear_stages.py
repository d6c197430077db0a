"""Signatures of linear mechanics, from the change of poles and residues, and of the read-out.

    mechanics   dy = sum_k dR_k Phi_k + R_k dp_k dPhi_k/dp + conj
    readout     dy = dG(i w) S + d{G(i w)(R + i w C)} v

Shapes: S = 2 senses, W bins.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray
from ....device.effect import Context, Effect
from ....device.mechanics import Mechanics, modes_of
from ....device.parameters import Parameter
from ....device.readout import Readout, plain_readout
from ....experiment.antialias import filter_poles
from ..inband import Band
from .library import SHAPE, BandSignature, members_of, only, probed
from .linear import LinearDevice, frequency_axis, in_order


def mechanics_signatures(device: LinearDevice, effects: Sequence[Effect]) -> Iterator[BandSignature]:
    """Signatures of all effects of linear mechanics that add no coordinate, from one decomposition."""
    found: list[tuple[Effect, Parameter, float, Mechanics]] = []
    for effect in effects:
        members = members_of(effect)
        if effect.mechanics is None or any(member.grid for member in members):
            continue
        for i, member in enumerate(members):
            for step in (1e-4 * member.scale, -1e-4 * member.scale):
                moved = effect.mechanics(device.mechanics, only(len(members), i, step), device.context)
                found.append((effect, member, step, moved))
    if not found:
        return
    names = [field.name for field in fields(Mechanics)]
    together = Mechanics(*(np.concatenate([getattr(m, name) for *_, m in found]) for name in names))
    modes = modes_of(together)
    own = device.pickoff_residues()
    for i in range(0, len(found), 2):
        effect, member, step, _ = found[i]
        ahead, behind = in_order(modes, device.poles, i), in_order(modes, device.poles, i + 1)
        poles, residues = (ahead[0] - behind[0]) / (2.0 * step), (ahead[1] - behind[1]) / (2.0 * step)
        yield probed(effect, member, device.read(residues, own * poles[:, None, None]), 1.0, 1)


@dataclass(frozen=True, eq=False)
class _ReadoutChange:
    """Change of G (W, S, S) and of the drive that is fed through (S, W) [V] per unit of a parameter: the same for all devices."""

    effect: Effect
    member: Parameter
    through: ComplexArray
    fed: ComplexArray


@lru_cache(maxsize=8)
def _readout_changes(band: Band, effects: tuple[Effect, ...], bias_v: float) -> tuple[_ReadoutChange, ...]:
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
    for effect in effects:
        members = members_of(effect)
        for i, member in enumerate(members if effect.readout is not None else ()):
            assert effect.readout is not None
            step = 1e-4 * member.scale
            moved = of(effect.readout(plain, only(len(members), i, step), context))
            out.append(_ReadoutChange(effect, member, (moved[0] - own[0]) / step, (moved[1] - own[1]) / step))
    return tuple(out)


def readout_signatures(device: LinearDevice, effects: tuple[Effect, ...]) -> Iterator[BandSignature]:
    before = device.sensed() / device.antialias
    for change in _readout_changes(device.band, effects, device.context.bias_v):
        spectrum = change.fed
        if change.through.any():
            spectrum = spectrum + np.einsum("wsr,rw->sw", change.through, before)
        yield probed(change.effect, change.member, spectrum, 1.0, 1)
