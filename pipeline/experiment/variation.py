"""Variation between the records of a campaign: each record has its own frequency, start time and gains.

    y_k(t) = (1 + g_k) f(t - tau_k; omega (1 + phi_k)) + b_k l(t) + noise,       l from -1 at the first to 1 at the last sample
    phi_k ~ N(0, s_phi^2),   tau_k ~ N(0, s_tau^2),   g_ks ~ N(0, s_g^2),   b_ks ~ N(0, s_b^2)      independent between records

phi is a common relative shift of all natural frequencies (temperature), tau the trigger time, g the gain of a channel, b half the
drift of its offset.  A spread of exactly zero means that the records do not need that kind of variation.

Shapes: N samples, S senses, m = 2 + 2 S deviations (phi, tau, g_1 .. g_S, b_1 .. b_S).  Units: seconds, volts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from ..arrays import ComplexArray, FloatArray

#: The kinds of variation, in the order of the fields of ``RecordSpread``.
KINDS = ("frequency", "start", "gain", "ramp")
#: Share of the Nyquist frequency up to which :func:`advanced` is an exact time shift.
_EXACT = 0.5
#: Samples by which a record is continued at both ends, so that the circular transform does not join its ends.
_CONTINUED = 256
#: Samples from which the continuation is predicted, and the order of the prediction: three modes and noise.
_FITTED, _ORDER = 512, 24


@dataclass(frozen=True)
class RecordSpread:
    """Standard deviations of the record variation: s_phi [1], s_tau [s], s_g [1], s_b [V]."""

    frequency: float = 0.0
    start_s: float = 0.0
    gain: float = 0.0
    ramp_v: float = 0.0

    @property
    def is_zero(self) -> bool:
        """Whether all records are equal up to noise."""
        return self.frequency == self.start_s == self.gain == self.ramp_v == 0.0

    def of_deviations(self, senses: int) -> FloatArray:
        """Sd (m,) of the deviations of one record."""
        return np.array([self.frequency, self.start_s, *([self.gain] * senses), *([self.ramp_v] * senses)])


@dataclass(frozen=True, eq=False)
class Deviations:
    """Estimated deviations (m,) of one record, their sds (m,), and the record's name."""

    record: str
    value: FloatArray
    sd: FloatArray

    @property
    def frequency(self) -> float:
        """phi [1]."""
        return float(self.value[0])

    @property
    def start_s(self) -> float:
        """tau [s]."""
        return float(self.value[1])

    @property
    def gain(self) -> FloatArray:
        """g (S,) [1]."""
        return self.value[2 : 2 + (self.value.size - 2) // 2]

    @property
    def ramp_v(self) -> FloatArray:
        """b (S,) [V]."""
        return self.value[2 + (self.value.size - 2) // 2 :]


def kind_of_deviation(senses: int) -> tuple[int, ...]:
    """(m,) index into ``KINDS`` of each deviation."""
    return (0, 1, *([2] * senses), *([3] * senses))


def advanced(y: FloatArray, shift_s: float, sample_rate_hz: float) -> FloatArray:
    """y(t + shift) of y (N, S), exact below a quarter of the sample rate.

    An all-pass filter whose phase omega shift goes smoothly to zero between that frequency and Nyquist: white noise stays white.
    """
    if shift_s == 0.0:
        return y
    samples = y.shape[0]
    reach = min(_CONTINUED, samples - 1)
    fade = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, reach + 1) / reach))[:, None]
    # Linear prediction continues a ringing mode; a cosine then leads both ends to the same value.
    middle = 0.5 * (y[:1] + y[-1:])
    tail = np.stack([_predicted(own, reach) for own in y.T], axis=1)
    head = np.stack([_predicted(own[::-1], reach) for own in y.T], axis=1)
    longer = np.concatenate([(middle + (head - middle) * fade)[::-1], y, middle + (tail - middle) * fade])
    response = advance_response(longer.shape[0], shift_s * sample_rate_hz)
    moved = irfft(rfft(longer, axis=0) * response[:, None], n=longer.shape[0], axis=0)
    return np.asarray(moved[reach : reach + samples])


def advance_response(samples: int, shift: float) -> ComplexArray:
    """The all-pass filter of ``advanced`` at the bins (N/2 + 1,) of ``samples``; ``shift`` in samples."""
    omega = 2.0 * np.pi * rfftfreq(samples)
    taper = np.clip((omega / np.pi - _EXACT) / (1.0 - _EXACT), 0.0, 1.0)
    return np.asarray(np.exp(0.5j * omega * shift * (1.0 + np.cos(np.pi * taper))))


def _predicted(y: FloatArray, count: int) -> FloatArray:
    """The next ``count`` samples after y (N,), by linear prediction from its last samples (Makhoul, Proc. IEEE 63 (1975) 561)."""
    # Loading scipy.signal takes 0.7 s, and few campaigns need it.
    from scipy.signal import lfilter, lfiltic

    last = y[-min(_FITTED, y.size) :]
    level = last.mean()
    window = np.lib.stride_tricks.sliding_window_view(last - level, _ORDER + 1)
    weights, *_ = np.linalg.lstsq(window[:, :-1], window[:, -1], rcond=1e-6)
    largest = 1.5 * float(np.max(np.abs(window)))
    denominator = np.concatenate([[1.0], -weights[::-1]])
    state = lfiltic([1.0], denominator, window[-1, :0:-1])
    with np.errstate(over="ignore", invalid="ignore"):
        following, _ = lfilter([1.0], denominator, np.zeros(count), zi=state)
    # An unstable prediction is limited to what the record shows.
    return np.asarray(level + np.clip(np.nan_to_num(following), -largest, largest))
