"""Phase correction: velocity modes measured through a known anti-alias filter, eq. (16) and (17).

    beta = argmin over real beta of ||(s R1 + R0)/d(s) - G_aa(s) beta s/d(s)||     for each mode and channel

Two norms.  ``correct_phase`` projects at the resonance, where a lightly damped mode has all its response,

    beta = Re[ conj(G_aa(jw)) (R1 + R0/(jw)) ] / |G_aa(jw)|^2,

``correct_phase_hinf`` minimises the H-infinity norm as printed, by bisection on the convex function of beta.
On the paper's device both give the printed M1..M3 to the last digits.

Shapes: M modes, S senses, D drives.  M_k = beta s-coefficients [1/s], volts per volt.
"""

from __future__ import annotations

import numpy as np

from ..arrays import ComplexArray, FloatArray
from ..experiment.antialias import filter_response
from ..experiment.instrument import AntiAlias
from .modes import ContinuousModes

#: Offsets from the resonance, in half-widths, at which the H-infinity norm is evaluated.
_OFFSETS: FloatArray = np.concatenate([-np.geomspace(100.0, 1e-3, 200), [0.0], np.geomspace(1e-3, 100.0, 200)])
_BISECTIONS = 60


def without_filter(modes: ContinuousModes, antialias: AntiAlias | None) -> ContinuousModes:
    """The same modes before the filter, exactly: R_k / G_aa(p_k)."""
    gain = filter_response(antialias, modes.poles)
    return ContinuousModes(modes.poles, modes.residues / gain[:, None, None])


def _numerators(
    modes: ContinuousModes, antialias: AntiAlias | None, s: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """s R1 + R0 (M, W, S, D) and G_aa(s) s (M, W) at s (M, W)."""
    numerator = s[:, :, None, None] * modes.R1[:, None] + modes.R0[:, None]
    return numerator, filter_response(antialias, s) * s


def correct_phase(modes: ContinuousModes, antialias: AntiAlias | None) -> FloatArray:
    """M_k (M, S, D) [1/s] by real projection on G_aa at each resonance.

    Parameters
    ----------
    modes : as identified, after the filter.
    antialias : the filter, ``None`` for none.
    """
    s = np.asarray(1j * np.abs(modes.poles)[:, None], dtype=np.complex128)
    numerator, filtered = _numerators(modes, antialias, s)
    return np.asarray((numerator[:, 0] / filtered[:, 0, None, None]).real)


def correct_phase_hinf(modes: ContinuousModes, antialias: AntiAlias | None) -> FloatArray:
    """M_k (M, S, D) [1/s] in the H-infinity norm, eq. (16).

    f(beta) = max_w |N(jw) - beta F(jw)|^2 / |d(jw)|^2 is convex in beta; its slope is that of the term that
    attains the maximum, and bisection follows its sign.
    """
    omega = np.abs(modes.poles)
    s = np.asarray(1j * (omega[:, None] - modes.poles.real[:, None] * _OFFSETS), dtype=np.complex128)
    numerator, filtered = _numerators(modes, antialias, s)
    quadratic = np.abs((s - modes.poles[:, None]) * (s - np.conj(modes.poles)[:, None]))
    target = numerator / quadratic[:, :, None, None]
    atom = (filtered / quadratic)[:, :, None, None]
    ratio = target / atom
    low, high = -np.abs(ratio).max(axis=1), np.abs(ratio).max(axis=1)
    for _ in range(_BISECTIONS):
        beta = (low + high) / 2.0
        remainder = target - beta[:, None] * atom
        worst = np.argmax(np.abs(remainder), axis=1)[:, None]
        slope = -np.take_along_axis(np.conj(atom) * remainder, worst, axis=1).real[:, 0]
        low, high = np.where(slope < 0.0, beta, low), np.where(slope < 0.0, high, beta)
    return np.asarray((low + high) / 2.0)
