"""Full-band quality of a fit: its error in units of the silent noise, and of all noise that was identified.

    error            = rms over bins of |R(w)| / sqrt(N) / s(w),    s(w) from the silence; white noise: rms of r / sigma
    error_all_noise  = the same with s(w)^2 + mean v(t), the noise that depends on the signal included

R is the transform of r = measured - model, offset and lines removed.  Frequencies below the lowest one at which the silence
measured a coloured density do not count.

Shapes: records (N, S) [V], S = 2 senses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray
from ...experiment.noise.lines import lines_removed, without_lines
from ...experiment.noise.spectrum import NoiseSpectrum
from ...experiment.record import Record
from .compressed import BandData
from .dependent_noise import COLUMNS, DependentNoise, find_dependent_noise, most_significant
from .whitening import on_grid, white_noise

#: Excess of error^2 over 1 [sd] above which noise that depends on the signal is looked for: 1 white record in 4000.
_LOUDER = 3.5


@dataclass(frozen=True, eq=False)
class FullBandQuality:
    """Full-band quality of a fit.

    Parameters
    ----------
    error, relative_error, error_all_noise : see the head of the module.
    louder : whether the noise may be louder than the silence shows.
    colour : "white" or "coloured", as the silence shows it.
    dependent : the noise that depends on the signal, if the records show any.
    """

    error: float
    relative_error: float
    error_all_noise: float
    louder: bool
    colour: str
    dependent: DependentNoise | None = None

    def columns(self) -> dict[str, float | str | None]:
        """Columns of the devices table."""
        return {
            "error": self.error,
            "relative_error": self.relative_error,
            "error_all_noise": self.error_all_noise,
            "noise_colour": self.colour,
            **dict.fromkeys(COLUMNS.values()),
            **({} if self.dependent is None else self.dependent.columns()),
        }


def _squares(y: FloatArray) -> FloatArray:
    """Sums (S,) [V^2] of the squares of y (N, S)."""
    return np.asarray(np.vecdot(y.T, y.T))


def _mean_square(rest: FloatArray, noise: NoiseSpectrum, line_hz: float | None, dependent: FloatArray) -> float:
    """Mean square (1) of a residual without lines (N, S) in units of the noise and ``dependent`` (S,) [V^2]."""
    samples, senses = rest.shape
    rate = noise.sample_rate_hz
    removed = lines_removed(samples, rate, line_hz)
    if noise.white:
        whole = np.sum(_squares(rest) / (noise.sigma_v**2 + dependent))
        return float(whole) / (senses * (samples - removed))
    frequency = np.arange(samples // 2 + 1) * rate / samples
    kept = frequency >= max(noise.low_hz, rate / samples)
    power = 2.0 / (samples * rate) * np.abs(rfft(rest, axis=0)[kept]) ** 2
    ratio = power / (noise.psd(frequency[kept]) + 2.0 / rate * dependent)
    return float(ratio.sum()) / (senses * (np.count_nonzero(kept) - (removed - 1) / 2.0))


def full_band_quality(
    records: Sequence[Record], models_v: Sequence[FloatArray], noise: NoiseSpectrum, line_hz: float | None
) -> FullBandQuality:
    """Quality of models (N, S) [V] of ``records``, with the noise of the silence and lines at ``line_hz`` [Hz]."""
    rests = [without_lines(r.sense_v - m, r.sample_rate_hz, line_hz) for r, m in zip(records, models_v)]
    weight = np.array([rest.shape[0] for rest in rests], dtype=float)
    squares = [_mean_square(rest, noise, line_hz, np.zeros(rest.shape[1])) for rest in rests]
    relative = [
        math.sqrt(float(np.vdot(rest, rest)) / max(float(np.vdot(r.sense_v, r.sense_v)), 1e-300))
        for rest, r in zip(rests, records)
    ]
    share = weight / weight.sum()
    square = float(share @ squares)
    senses = noise.sigma_v.size
    sd = math.sqrt(2.0 / (senses * weight.sum()) + 2.0 / (senses * noise.dof))
    return FullBandQuality(
        math.sqrt(square),
        math.sqrt(float(share @ np.square(relative))),
        math.sqrt(square),
        not noise.white or square - 1.0 > _LOUDER * sd,
        "white" if noise.white else "coloured",
    )


def with_dependent_noise(
    quality: FullBandQuality,
    data: Sequence[BandData],
    records: Sequence[Record],
    models_v: Sequence[FloatArray],
    noise: NoiseSpectrum,
    line_hz: float | None,
) -> tuple[FullBandQuality, list[BandData]]:
    """The quality, and the records in their band, with the noise of each record that depends on its signal."""
    out, squares, found = [], [], []
    for item, record, model in zip(data, records, models_v):
        rest = without_lines(record.sense_v - model, record.sample_rate_hz, line_hz)
        dependent = find_dependent_noise(rest, model, noise, float(item.band.frequency_hz[-1]))
        own_v2 = np.zeros(noise.sigma_v.size)
        if dependent is not None:
            v = dependent.variances(model, record.sample_rate_hz)
            own_v2 = v[[0, 2]].mean(axis=1)
            own = item.noise or white_noise(noise.sigma_v, item.band)
            item = replace(item, noise=replace(own, dependent=on_grid(v, item.band)))
            found.append(dependent)
        squares.append(_mean_square(rest, noise, line_hz, own_v2))
        out.append(item)
    weight = [record.sense_v.shape[0] for record in records]
    error = math.sqrt(float(np.average(squares, weights=weight)))
    return replace(quality, error_all_noise=error, dependent=most_significant(found)), out
