"""Butterworth anti-alias filters as sums of poles.

    G(s) = sum_j r_j / (s - q_j),   G(0) = 1
    G(s) / s = sum_j r_j / q_j / (s - q_j) + 1 / s                          where the filter integrates

q_j and r_j [rad/s] include the conjugates.  Source: Oppenheim and Schafer, Discrete-Time Signal Processing, app. B.
Shapes: B devices, P poles (one of each conjugate pair), S senses, D drives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..arrays import ComplexArray
from ..device.mechanics import Modes
from .instrument import AntiAlias


@dataclass(frozen=True, eq=False)
class Bank:
    """Modes and filter together: H(s) G(s) = sum_k R_k / (s - p_k) + conj, with k over the poles of plant and filter.

    poles (B, P) [rad/s], Im >= 0; residues (B, P, S, D) [1/s].  The residue of a real pole is halved, because conj is added.
    """

    poles: ComplexArray
    residues: ComplexArray


@cache
def filter_poles(antialias: AntiAlias) -> tuple[ComplexArray, ComplexArray]:
    """Poles q_j and residues r_j of the filter, both (order,) [rad/s], read-only; one more, at zero, where it integrates."""
    order = antialias.order
    corner = 2.0 * math.pi * antialias.corner_hz
    q = corner * np.exp(1j * math.pi * (2.0 * np.arange(1, order + 1) + order - 1) / (2.0 * order))
    difference = q[:, None] - q[None, :]
    np.fill_diagonal(difference, 1.0)
    r = corner**order / np.prod(difference, axis=1)
    if antialias.integrates:
        q, r = np.append(q, 0.0), np.append(r / q, 1.0)
    q.flags.writeable = r.flags.writeable = False
    return q, r


def filter_response(antialias: AntiAlias | None, s: ComplexArray) -> ComplexArray:
    """G(s) at complex frequencies ``s`` [rad/s] of any shape; 1 without a filter."""
    if antialias is None:
        return np.ones_like(s, dtype=np.complex128)
    q, _ = filter_poles(antialias)
    gain = (2.0 * math.pi * antialias.corner_hz) ** antialias.order
    return np.asarray(gain / np.prod(s[..., None] - q, axis=-1))


def behind_filter(modes: Modes, antialias: AntiAlias | None) -> Bank:
    """Partial fractions of H(s) G(s): residues R_k G(p_k) at the poles of the plant and r_j H(q_j) at those of the filter."""
    if antialias is None:
        assert not np.any(modes.direct), "a bank of poles has no part that follows the drive at once"
        return Bank(modes.poles, modes.residues)
    q, r = _upper_poles(antialias)
    batch, own = modes.residues.shape[:2]
    poles = np.empty((batch, own + q.size), dtype=np.complex128)
    residues = np.empty((batch, own + q.size, *modes.residues.shape[2:]), dtype=np.complex128)
    poles[:, :own], poles[:, own:] = modes.poles, q
    gain = filter_response(antialias, modes.poles)
    np.multiply(modes.residues, gain[:, :, None, None], out=residues[:, :own])
    np.multiply(modes.response(q).transpose(0, 3, 1, 2), r[:, None, None], out=residues[:, own:])
    return Bank(poles, residues)


@cache
def _upper_poles(antialias: AntiAlias) -> tuple[ComplexArray, ComplexArray]:
    """Poles and residues of the filter, one of each conjugate pair; half the residue of a real pole."""
    q, r = filter_poles(antialias)
    upper = q.imag >= -1e-9 * np.abs(q)
    weight = np.where(np.abs(q.imag) <= 1e-9 * np.abs(q), 0.5, 1.0)
    return q[upper], (r * weight)[upper]
