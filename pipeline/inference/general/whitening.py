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

#: Relative sd below which the density counts as known.  The test of a band of 25 Hz over 3 s has a relative sd of 0.12; with the
#: density continued as a power law instead, 2 of 4 campaigns of 1/f noise were "unknown" for a residual at 0 to 25 Hz.
_KNOWN = 0.25


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
            # Sums over the few channels are several times faster than a general product of small matrices.
            channels = range(out.shape[-1])
            mixed = [sum(self.mixing[:, i, j] * out[..., j] for j in channels) for i in channels]
            out = np.stack(mixed, axis=-1)
        if self.common is not None:
            flat, u = out.reshape(*r.shape[:-2], -1), self.common.directions
            out = (flat - (flat @ u * self.common.removed) @ u.T).reshape(r.shape)
        return np.asarray(out)


def colour_of(noise: NoiseLevel, samples: int, sample_rate_hz: float) -> FloatArray | None:
    """sigma / sigma(f) (F, S) at the bins of a record; ``None`` for white noise.

    The silence is shorter than the record, so it does not determine the density at the lowest frequencies.  The bins below the
    first one with a known density have no weight.
    """
    spectrum = noise.spectrum
    if spectrum is None or spectrum.white:
        return None
    f = np.arange(samples // 2 + 1) * sample_rate_hz / samples
    known = (f >= spectrum.low_hz) & np.all(spectrum.relative_sd(f) < _KNOWN, axis=1)
    gain = noise.sigma_v / spectrum.sigma_at(f)
    return np.where((np.arange(f.size) >= int(np.argmax(known)))[:, None], gain, 0.0)


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
