"""Noise of a record that is not white, made white after division by sigma.

    coloured        r -> F^-1 [ F r  sigma / sigma(f) ]            sigma(f): white noise with the density at f
    signal-dependent  r[n] -> L_n^-1 r[n],  L_n L_n' = I + V_n      V_n (S, S): variance of sample n beyond sigma, in sigma^2
    common signals  r -> (I + C C')^-1/2 r = r - U (1 - (1 + s^2)^-1/2) U' r,     C = U s V'   (N S, m)

White noise takes none of these steps.  Shapes: N samples, S senses, F = N/2 + 1 bins, m common signals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft

from ...arrays import FloatArray
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Record

#: Bins in which the slope of the density is taken to continue it below the lowest frequency of the silence.
_SLOPE_BANDS = 4


@dataclass(frozen=True, eq=False)
class CommonSignals:
    """(I + C C')^-1/2 of the common signals in the noise of a record: U (N S, m), 1 - (1 + s^2)^-1/2 (m,)."""

    directions: FloatArray
    removed: FloatArray


@dataclass(frozen=True, eq=False)
class Whitening:
    """What makes the residual of one record white: ``colour`` (F, S), ``mixing`` L_n^-1 (N, S, S), ``common``; or ``None``."""

    colour: FloatArray | None = None
    mixing: FloatArray | None = None
    common: CommonSignals | None = None

    @property
    def is_white(self) -> bool:
        """Whether there is nothing to do."""
        return self.colour is None and self.mixing is None and self.common is None

    def __call__(self, r: FloatArray) -> FloatArray:
        """r (.., N, S) in sigmas, made white."""
        out = r
        if self.colour is not None:
            # Along the last, contiguous axis a transform is several times faster than down a column.
            lines = np.ascontiguousarray(np.moveaxis(out, -2, -1))
            lines = irfft(rfft(lines) * self.colour.T, n=r.shape[-2])
            out = np.ascontiguousarray(np.moveaxis(lines, -1, -2))
        if self.mixing is not None:
            out = np.einsum("nij,...nj->...ni", self.mixing, out)
        if self.common is not None:
            flat, u = out.reshape(*r.shape[:-2], -1), self.common.directions
            out = (flat - (flat @ u * self.common.removed) @ u.T).reshape(r.shape)
        return np.asarray(out)


def colour_of(noise: NoiseLevel, samples: int, sample_rate_hz: float) -> FloatArray | None:
    """sigma / sigma(f) (F, S) at the bins of a record; ``None`` for white noise.

    Below the lowest frequency of the silence the density continues with its slope there, between 0 and 1/f^2.
    """
    spectrum = noise.spectrum
    if spectrum is None or spectrum.white:
        return None
    f = np.maximum(np.arange(samples // 2 + 1), 1) * sample_rate_hz / samples
    gain = noise.sigma_v / spectrum.sigma_at(f)
    low = spectrum.frequency_hz[:_SLOPE_BANDS]
    span = np.log(low[-1] / low[0])
    slope = np.clip((spectrum.log_density[0] - spectrum.log_density[low.size - 1]) / span, 0.0, 2.0)
    below = np.minimum(f / spectrum.low_hz, 1.0)
    return np.asarray(gain * below[:, None] ** (0.5 * slope))


def common_signals(white: FloatArray) -> CommonSignals:
    """The inverse root of I + C C' from the columns (m, N, S) of C, in sigmas."""
    c = white.reshape(white.shape[0], -1).T
    size, vectors = np.linalg.eigh(c.T @ c)
    kept = size > 1e-12 * max(float(size[-1]), 1e-300)
    directions = c @ (vectors[:, kept] / np.sqrt(size[kept]))
    return CommonSignals(directions, 1.0 - 1.0 / np.sqrt(1.0 + size[kept]))


def whitening_of(noise: NoiseLevel, record: Record) -> Whitening:
    """The whitening of a record without its common signals."""
    colour = colour_of(noise, record.sense_v.shape[0], record.sample_rate_hz)
    return Whitening(colour, noise.mixing.get(record.name))
