"""A record in a band of frequencies, with exact transients.

A pole p driven by held samples v from rest, x[n+1] = z x[n] + g v[n], has the discrete Fourier transform (bins w of N samples)

    X(w) = (g(p) V(w) - e^{iw} x_N(p)) / (e^{iw} - z(p)),      x_N = g sum_n z^{N-1-n} v[n]

The end state x_N depends on the pole; a constant x_N would make the sd of the split 39 times larger.  After the filter
G = sum_j r_j/(s - q_j)

    Phi(w; p) = G(p) X(w; p) + sum_j r_j / (q_j - p) X(w; q_j)

so that a model H = sum_k R_k/(s - p_k) + conj gives  Y(w) = sum_k R_k Phi(w; p_k) + conj(R_k) Phi(w; conj p_k)  in the band.
``columns`` has the Taylor coefficients of Phi in p, Phi(p + h) = sum_m Phi_m h^m.

With first-order hold, g v[n] becomes g0 v[n] + g1 v[n+1], with g0 and g1 of each pole.

Shapes: W bins, D drives.  Units: rad/s, volts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from ...arrays import ComplexArray, FloatArray, IntArray
from ...errors import ConfigError
from ...experiment.antialias import filter_poles, filter_response
from ...experiment.forward.modal_bank import hold_gains
from ...experiment.instrument import AntiAlias, Instrument
from .end_sums import end_sums

#: Longest record that is treated as a whole, and whose parts are kept for the next device [samples]: 26 s at 10 kHz.  Longer
#: ones are treated in parts where that saves memory, at the cost of time.
SHORT = 2**18


@dataclass(frozen=True, eq=False)
class Band:
    """The bins of a record between two frequencies, and the parts of the likelihood that depend on the drive alone.

    Parameters
    ----------
    sample_rate_hz, samples : of the record [Hz, 1].
    bins, e_iw : (W,) indices of the bins, and e^{iw}.
    drive_v : (N, D) [V].
    now, following : (D, W) transforms of v[n] and v[n+1] [V].
    antialias, first_order_hold : of the instrument.
    q, filter_part : poles of the filter (order,) [rad/s], and r_j X(w; q_j), (order, D, W).
    """

    sample_rate_hz: float
    samples: int
    bins: IntArray
    e_iw: ComplexArray
    drive_v: FloatArray
    now: ComplexArray
    following: ComplexArray
    antialias: AntiAlias | None
    first_order_hold: bool
    q: ComplexArray
    filter_part: ComplexArray

    @property
    def frequency_hz(self) -> FloatArray:
        """Frequencies of the bins (W,) [Hz]."""
        return self.bins * self.sample_rate_hz / self.samples

    def transform(self, y: FloatArray) -> ComplexArray:
        """sum_n y[n] exp(-i w n) (C, W) [V] of a record y (N, C) [V] at the bins of the band."""
        return transformed(y, self.bins)


def transformed(y: FloatArray, bins: IntArray) -> ComplexArray:
    """sum_n y[n] exp(-i w n) (C, W) [V] of a record y (N, C) [V] at some bins."""
    if y.shape[0] <= SHORT:
        return np.ascontiguousarray(rfft(y.T, axis=-1)[:, bins])
    # One channel after the other: the transform of all is as large as the record.
    out = np.empty((y.shape[1], bins.size), dtype=np.complex128)
    for one, column in zip(out, y.T):
        one[:] = rfft(np.ascontiguousarray(column))[bins]
    return out


def make_band(drive_v: FloatArray, instrument: Instrument, low_hz: float, high_hz: float) -> Band:
    """The band [low, high] Hz of records that ``drive_v`` (N, D) [V] drives.

    Raises
    ------
    ConfigError : hold "bandlimited", which has no closed form, or a band without a bin.
    """
    if instrument.hold == "bandlimited":
        raise ConfigError(
            "the in-band likelihood has no closed form for this hold",
            value=instrument.hold,
            allowed="zoh, foh",
            next_step="interpolate the drive samples to a higher rate and declare foh",
        )
    samples = drive_v.shape[0]
    resolution = instrument.sample_rate_hz / samples
    bins = np.arange(int(np.ceil(low_hz / resolution - 1e-9)), int(np.floor(high_hz / resolution + 1e-9)) + 1)
    bins = bins[(bins > 0) & (bins <= samples // 2)]
    if bins.size == 0:
        raise ConfigError("no frequency bin in the band", value=[low_hz, high_hz], allowed=f"above {resolution:.3g} Hz")
    e_iw = np.exp(2j * np.pi * bins / samples)
    now = transformed(drive_v, bins)
    following = transformed(following_drive(drive_v), bins)
    bare = Band(
        instrument.sample_rate_hz,
        samples,
        bins,
        e_iw,
        np.ascontiguousarray(drive_v),
        now,
        following,
        None,
        instrument.hold == "foh",
        np.zeros(0, dtype=np.complex128),
        np.zeros((0, drive_v.shape[1], bins.size), dtype=np.complex128),
    )
    if instrument.antialias is None:
        return bare
    q, r = filter_poles(instrument.antialias)
    part = np.stack([r[j] * features(bare, complex(q[j])) for j in range(q.size)])
    return Band(
        bare.sample_rate_hz,
        samples,
        bins,
        e_iw,
        bare.drive_v,
        now,
        following,
        instrument.antialias,
        bare.first_order_hold,
        q,
        part,
    )


def following_drive(drive_v: FloatArray) -> FloatArray:
    """v[n+1] (N, D) of samples v (N, D); the last one is held."""
    return np.concatenate([drive_v[1:], drive_v[-1:]])


def features(band: Band, pole: complex) -> ComplexArray:
    """Response Phi(w; p) (D, W) to a pole p [rad/s] of unit residue; ``columns`` has its Taylor coefficients in p."""
    step = 1.0 / band.sample_rate_hz
    log_z = np.array([pole * step])
    z, g0, g1 = (one[()] for one in hold_gains(np.array(pole), step, "foh" if band.first_order_hold else "zoh"))
    top = g0 * (band.now - band.e_iw * end_sums(band.drive_v, log_z, 1, SHORT)[0, 0, :, None])
    if band.first_order_hold:
        ends = end_sums(following_drive(band.drive_v), log_z, 1, SHORT)[0, 0, :, None]
        top += g1 * (band.following - band.e_iw * ends)
    free = top / (band.e_iw - z)
    if band.antialias is None:
        return free
    own = filter_response(band.antialias, np.array(pole))[()] * free
    return own + np.tensordot(1.0 / (band.q - pole), band.filter_part, axes=1)
