"""Prefilter and window of the paper's route.

    x_bp = G_bp(q^-1) x,   G_bp an 8th-order Chebyshev bandpass, the same on drive and sense            (12)

Filtering both sides leaves the identified transfer function as it is and weights its fit with |G_bp|^2.
Shapes: N samples, C channels, S senses.  Units: volts, hertz, seconds.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..arrays import ComplexArray, FloatArray
from ..experiment.forward.recursion import in_lanes, recursive
from .failure import IdentificationError

#: Four pole pairs; the paper names the order, not the ripple.
_POLE_PAIRS = 4
_RIPPLE_DB = 0.5
#: Length of the segments whose power locates the largest signal [s].
_PIECE_S = 0.05


@lru_cache(maxsize=32)
def bandpass_sections(sample_rate_hz: float, low_hz: float, high_hz: float) -> FloatArray:
    """G_bp, eq. (12), as second-order sections (4, 6), read-only; frequencies [Hz].

    Poles of the Chebyshev lowpass, moved to the band and through the bilinear transform z = (2 f_s + s) / (2 f_s - s)
    (Oppenheim and Schafer, Discrete-Time Signal Processing, ch. 7), whose frequencies are warped before.

    Raises
    ------
    IdentificationError : the band does not lie between 0 and f_s / 2.
    """
    if not 0.0 < low_hz < high_hz < sample_rate_hz / 2.0:
        raise IdentificationError(
            "the identification band does not fit the sample rate",
            value=(low_hz, high_hz),
            allowed=f"0 < low < high < {sample_rate_hz / 2.0:g} Hz",
            next_step="choose another band or a record with a higher sample rate",
        )
    ripple = np.sqrt(10.0 ** (0.1 * _RIPPLE_DB) - 1.0)
    mu = np.arcsinh(1.0 / ripple) / _POLE_PAIRS
    angle = np.pi * (np.arange(_POLE_PAIRS) + 0.5) / _POLE_PAIRS
    lowpass = -np.sinh(mu) * np.sin(angle) + 1j * np.cosh(mu) * np.cos(angle)
    rate = 2.0 * sample_rate_hz
    low, high = rate * np.tan(np.pi * np.array([low_hz, high_hz]) / sample_rate_hz)
    half = 0.5 * (high - low) * lowpass
    root = np.sqrt(half**2 - low * high)
    s = np.concatenate([half + root, half - root])
    gain = np.real(np.prod(-lowpass * (high - low) * rate) / np.prod(rate - s)) / np.sqrt(1.0 + ripple**2)
    z = (rate + s) / (rate - s)
    z = z[z.imag > 0.0]
    one = np.ones(_POLE_PAIRS)
    # Each section has a zero at 0 Hz and one at f_s / 2.
    sections = np.stack([one, 0.0 * one, -one, one, -2.0 * z.real, np.abs(z) ** 2], axis=1)
    sections[:, :3] *= gain ** (1.0 / _POLE_PAIRS)
    sections.setflags(write=False)
    return sections


@lru_cache(maxsize=32)
def _partial_fractions(
    sample_rate_hz: float, low_hz: float, high_hz: float
) -> tuple[ComplexArray, ComplexArray, float]:
    """z_k (4,), 2 R_k (4,) and d of G_bp(z) = d + sum_k R_k / (z - z_k) + conj, which is zero at z = 1 and z = -1."""
    sections = bandpass_sections(sample_rate_hz, low_hz, high_hz)
    half = -0.5 * sections[:, 4]
    z = half + 1j * np.sqrt(sections[:, 5] - half**2)
    apart = z[:, None] - z
    np.fill_diagonal(apart, 1.0)
    gain = float(np.prod(sections[:, 0]))
    numerator = gain * (z**2 - 1.0) ** _POLE_PAIRS
    return z, 2.0 * numerator / np.prod(apart, axis=1) / np.prod(z[:, None] - z.conj(), axis=1), gain


def bandpass(signal: FloatArray, sample_rate_hz: float, low_hz: float = 400.0, high_hz: float = 700.0) -> FloatArray:
    """x_bp = G_bp(q^-1) x from rest, causal, eq. (12).

    Parameters
    ----------
    signal : (N, C) [V].
    sample_rate_hz : f_s [Hz].
    low_hz, high_hz : corners of the pass band [Hz].

    Returns
    -------
    (N, C) [V].  A constant offset decays within a few hundredths of a second.

    Raises
    ------
    IdentificationError : the band does not lie between 0 and f_s / 2.
    """
    z, fractions, gain = _partial_fractions(sample_rate_hz, low_hz, high_hz)
    found = []
    for c in range(0, signal.shape[1], 2):
        pair = signal[:, c : c + 2]
        alone = np.eye(pair.shape[1])
        start = np.zeros((z.size, pair.shape[1]), dtype=np.complex128)
        found.append(recursive(in_lanes(pair), z, start, alone[:, None, :] * fractions[:, None], gain * alone))
    return found[0] if len(found) == 1 else np.concatenate(found, axis=1)


def window_slice(sense: FloatArray, sample_rate_hz: float, duration_s: float = 2.0) -> slice:
    """The window of ``duration_s`` seconds centred where the (filtered) sense signals are largest.

    centre = argmax of the signal power over segments of 0.05 s.  The window is shifted so that it lies inside the record,
    and is the whole record if the record is shorter.

    Parameters
    ----------
    sense : (N, S) sense samples after the bandpass, so that offsets do not count as signal [V].
    sample_rate_hz : f_s [Hz].
    duration_s : length of the window [s].
    """
    samples = sense.shape[0]
    length = min(round(duration_s * sample_rate_hz), samples)
    piece = max(1, min(round(_PIECE_S * sample_rate_hz), samples))
    pieces = samples // piece
    in_pieces = sense[: pieces * piece].reshape(pieces, -1)
    power = np.einsum("pn,pn->p", in_pieces, in_pieces)
    centre = int(np.argmax(power)) * piece + piece // 2
    start = min(max(centre - length // 2, 0), samples - length)
    return slice(start, start + length)
