"""Frequency and damping of a short piece of a free decay, from the data alone: no model of the device is used.

    y = c + sum_k Re[(a_k + b_k t) e^{p_k t}] + Re[h_2 e^{2 p_1 t} + h_3 e^{3 p_1 t}]        linear in c, a, b, h

Gauss-Newton on the poles: p_k <- p_k + b_k / a_k until b vanishes.  The covariance of b, from the residual, is that of p:

    f = |p| / 2 pi,   zeta = -Re p / |p|,   amplitude = rms over the piece of |a| e^{Re p t}, as of a sine (times sqrt 2)

A frequency that moves with the amplitude has its mean over the piece, weighted with the square of the motion.

Shapes: N samples, K modes.  Amplitudes in the unit of the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray

#: Iterations on the poles; from a start within half a cycle they need 3 to 5.
_ITERATIONS = 12
#: Largest relative change of a pole, per cycle, that counts as settled.
_SETTLED = 1e-9


@dataclass(frozen=True)
class Oscillation:
    """A mode in a piece: frequency f [Hz], damping ratio zeta [1], amplitude [unit of the samples], and their sds.

    ``found`` tells whether the piece determines them.
    """

    f_hz: float
    f_sd_hz: float
    zeta: float
    zeta_sd: float
    amplitude: float
    amplitude_sd: float
    found: bool


def strongest_channel(sense_v: FloatArray) -> FloatArray:
    """The channel (N,) of (N, S) that moves most, without its mean."""
    y = sense_v[:, int(np.argmax(np.var(sense_v, axis=0)))]
    return np.asarray(y - y.mean())


def line_hz(sense_v: FloatArray, sample_rate_hz: float) -> float:
    """The strongest line [Hz] of the channel of (N, S) that moves most; 0 where nothing moves."""
    y = strongest_channel(sense_v)
    power = np.abs(np.fft.rfft(y * np.hanning(y.size))) ** 2
    power[:3] = 0.0
    k = int(np.argmax(power))
    if power[k] <= 0.0 or k + 1 >= power.size:
        return 0.0
    # Parabola through the logarithms: the window spreads a line over four bins.
    left, mid, right = np.log(np.maximum(power[k - 1 : k + 2], 1e-300))
    bend = left - 2.0 * mid + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float((k + np.clip(shift, -0.5, 0.5)) * sample_rate_hz / y.size)


def backbone(sense_v: FloatArray, sample_rate_hz: float, modes_hz: Sequence[float] = ()) -> tuple[Oscillation, ...]:
    """The modes of a piece (N, S), in the channel that moves most, the strongest first.

    ``modes_hz`` : about where they are; the one nearest to the strongest line starts there.
    """
    line = line_hz(sense_v, sample_rate_hz)
    if line <= 0.0:
        return ()
    others = sorted(modes_hz, key=lambda f: abs(f - line))[1:]
    return oscillations(strongest_channel(sense_v), sample_rate_hz, [line, *others])


def oscillations(y: FloatArray, sample_rate_hz: float, start_hz: Sequence[float]) -> tuple[Oscillation, ...]:
    """The modes of a piece y (N,), each from a start value of its frequency [Hz]; the first one has harmonics."""
    samples = y.size
    # Time from the middle of the piece: the coefficients of e and t e are then nearly independent.
    t: FloatArray = (np.arange(samples, dtype=np.float64) - 0.5 * (samples - 1)) / sample_rate_hz
    poles: ComplexArray = 2j * np.pi * np.asarray(start_hz, dtype=np.complex128)
    highest = np.pi * sample_rate_hz
    for _ in range(_ITERATIONS):
        columns, scale = _columns(t, poles, highest)
        coefficients = np.linalg.lstsq(columns, y, rcond=1e-12)[0] / scale
        a, b = _pairs(coefficients, poles.size)
        step = b / np.where(np.abs(a) > 0.0, a, 1.0)
        # At most half a cycle, and a factor e, over the piece.
        step = step / np.maximum(np.abs(step) * t[-1], 1.0)
        poles = np.asarray(poles + step, dtype=np.complex128)
        if float(np.max(np.abs(step) / np.maximum(np.abs(poles), 1e-300))) < _SETTLED:
            break
    return _described(y, t, poles, highest)


def _columns(t: FloatArray, poles: ComplexArray, highest: float) -> tuple[FloatArray, FloatArray]:
    """Columns (N, 1 + 4 K + harmonics) of unit norm: constant, then e and t e of each pole, then harmonics of the first."""
    parts = [np.ones((t.size, 1))]
    for p in poles:
        e = np.exp(p * t)
        parts.append(np.stack([e.real, -e.imag, t * e.real, -t * e.imag], axis=1))
    for order in (2, 3):
        if order * poles[0].imag < 0.9 * highest:
            e = np.exp(order * poles[0] * t)
            parts.append(np.stack([e.real, -e.imag], axis=1))
    columns = np.concatenate(parts, axis=1)
    scale = np.linalg.norm(columns, axis=0)
    return columns / scale, scale


def _pairs(coefficients: FloatArray, modes: int) -> tuple[ComplexArray, ComplexArray]:
    """a and b (K,)."""
    own = coefficients[1 : 1 + 4 * modes].reshape(modes, 4)
    return own[:, 0] + 1j * own[:, 1], own[:, 2] + 1j * own[:, 3]


def _described(y: FloatArray, t: FloatArray, poles: ComplexArray, highest: float) -> tuple[Oscillation, ...]:
    columns, scale = _columns(t, poles, highest)
    coefficients = np.linalg.lstsq(columns, y, rcond=1e-12)[0]
    rest = y - columns @ coefficients
    dof = max(t.size - columns.shape[1], 1)
    covariance = np.linalg.pinv(columns.T @ columns, rcond=1e-12, hermitian=True) * float(rest @ rest) / dof
    covariance = covariance / np.outer(scale, scale)
    a, _ = _pairs(coefficients / scale, poles.size)
    out = []
    for k, (p, own) in enumerate(zip(poles, a)):
        first = 1 + 4 * k
        size = max(abs(own), 1e-300)
        # d p = b / a: its real and imaginary part by those of b.
        turn = np.array([[own.real, own.imag], [-own.imag, own.real]]) / size**2
        spread = np.sqrt(
            np.maximum(np.diagonal(turn @ covariance[first + 2 : first + 4, first + 2 : first + 4] @ turn.T), 0)
        )
        level = float(np.sqrt(np.mean(np.exp(2.0 * p.real * t))))
        level_sd = float(np.sqrt(max(np.trace(covariance[first : first + 2, first : first + 2]) / 2.0, 0.0)))
        omega = max(abs(p), 1e-300)
        sd_zeta, sd_f = float(spread[0] / omega), float(spread[1] / (2.0 * np.pi))
        found = bool(size > 3.0 * level_sd and sd_f * (t[-1] - t[0]) < 0.5 and 0.0 < p.imag < highest)
        out.append(
            Oscillation(
                omega / (2.0 * np.pi), sd_f, float(-p.real / omega), sd_zeta, size * level, level_sd * level, found
            )
        )
    return tuple(out)
