"""How noisy a campaign is, never from a model's own residual.

    silent    rms of the silent records less offset, trend and lines; LSB^2/12 added where silence does not exercise
    the ADC; pooled with the repeats where there are some and both agree
    repeats   rms of the difference of records with the same drive, over sqrt 2
    local     what a local polynomial in frequency (response and transient, second order) leaves of each record, median
              over windows

Shapes: N samples, S senses.  sigma (S,) [V], the standard deviation of a sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.fft import rfft
from scipy.ndimage import maximum_filter1d, median_filter

from ...arrays import FloatArray
from ...errors import MeasurementError
from ..instrument import Adc
from ..record import Campaign, Record
from .lines import line_basis

Source = Literal["silent", "repeats", "local"]

#: A bin this many times above the median of its neighbourhood is a line (chance 1e-6 a bin in white noise).
_LINE = 20.0
_NEIGHBOURS = 201
#: Lines with less than this share of the power are subtracted by their power alone.
_FAINT = 0.03
#: Silence and repeats agree within this many sd.
_AGREE = 3.0
#: Below this many LSB of noise, silence does not exercise the converter.
_EXERCISED_LSB = 0.5


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """sigma_v (S,) [V] a sample; where it came from; the degrees of freedom behind it (a channel)."""

    sigma_v: FloatArray
    source: Source
    dof: int


def _spectral_variance(y: FloatArray, sample_rate_hz: float, line_hz: float | None) -> tuple[FloatArray, int]:
    """Variance (S,) of y (N, S) less offset, trend, harmonics of ``line_hz`` and any other narrow line; its dof."""
    samples = y.shape[0]
    basis = line_basis(samples, sample_rate_hz, line_hz, True)
    rest = y - basis @ (basis.T @ y)
    power = np.abs(rfft(rest * np.hanning(samples)[:, None], axis=0)[1:]) ** 2
    reach = min(_NEIGHBOURS, power.shape[0] | 1)
    # A Hann window spreads a line over three bins whatever its frequency.
    # Channel by channel: a filter of one axis is ten times faster than the same over two.
    level = np.stack([median_filter(own, size=reach, mode="nearest") for own in power.T], axis=1) / np.log(2.0)
    line = maximum_filter1d(power > _LINE * level, size=5, axis=0)
    free = samples - basis.shape[1]
    plain = np.sum(rest**2, axis=0) / max(free, 1)
    kept = np.maximum(np.sum(~line, axis=0), 1)
    window = np.sum(np.hanning(samples) ** 2)
    quiet = np.sum(np.where(line, 0.0, power), axis=0) / kept
    # A^2/2 = 2 sum |X|^2 / (N sum w^2) over the bins of a line.
    lines = 2.0 * np.sum(np.where(line, power - quiet, 0.0), axis=0) / (window * samples)
    if np.all(lines < _FAINT * plain):
        # The window throws half of the samples away; faint lines, most of them chance, are taken off the whole.
        return plain - lines, free - int(2 * line.sum(axis=0).max())
    return quiet / window * samples / max(free, 1), int(kept.min())


def _silent(records: tuple[Record, ...], line_hz: float | None, adc: Adc | None) -> NoiseLevel:
    total, dof = np.zeros(records[0].sense_v.shape[1]), 0
    for record in records:
        variance, own = _spectral_variance(record.sense_v, record.sample_rate_hz, line_hz)
        total, dof = total + own * variance, dof + own
    variance = total / dof
    if adc is not None:
        quiet = variance < (_EXERCISED_LSB * adc.lsb_v) ** 2
        variance = np.where(quiet, variance + adc.lsb_v**2 / 12.0, variance)
    return NoiseLevel(np.sqrt(variance), "silent", dof)


def _repeated(campaign: Campaign) -> list[tuple[Record, Record]]:
    driven = [r for r in campaign.records if r.role != "noise" and np.any(r.drive_v)]
    return [
        (a, b)
        for a, b in combinations(driven, 2)
        if a.drive_v.shape == b.drive_v.shape
        and np.array_equal(a.drive_v, b.drive_v)
        and (a.bias_v, a.rate_dps) == (b.bias_v, b.rate_dps)
        and a.at_rest
        and b.at_rest
    ]


def _between(repeats: list[tuple[Record, Record]], line_hz: float | None) -> NoiseLevel | None:
    """From the differences of repeats; ``None`` without any."""
    if not repeats:
        return None
    total, dof = np.zeros(repeats[0][0].sense_v.shape[1]), 0
    for a, b in repeats:
        variance, own = _spectral_variance((a.sense_v - b.sense_v) / np.sqrt(2.0), a.sample_rate_hz, line_hz)
        total, dof = total + own * variance, dof + own
    return NoiseLevel(np.sqrt(total / dof), "repeats", dof)


def _agreed(silent: NoiseLevel, repeats: NoiseLevel | None) -> NoiseLevel:
    """The level of silence, made surer by repeats where they say the same within 3 sd; else silence alone counts."""
    if repeats is None:
        return silent
    ratio = (repeats.sigma_v / silent.sigma_v) ** 2 - 1.0
    if not np.all(np.abs(ratio) < _AGREE * np.sqrt(2.0 / silent.dof + 2.0 / repeats.dof)):
        return silent
    dof = silent.dof + repeats.dof
    pooled = (silent.dof * silent.sigma_v**2 + repeats.dof * repeats.sigma_v**2) / dof
    return NoiseLevel(np.sqrt(pooled), "silent", dof)


def _local_variance(record: Record) -> tuple[FloatArray, int]:
    """Median over windows of what a local quadratic in frequency leaves, (S,), and the dof of all windows."""
    samples, drives = record.drive_v.shape
    y, u = rfft(record.sense_v - record.sense_v.mean(axis=0), axis=0), rfft(record.drive_v, axis=0)
    unknowns = 3 * (drives + 1)
    width = 4 * unknowns
    starts = range(1, y.shape[0] - width, width)
    x = np.linspace(-1.0, 1.0, width)[:, None] ** np.arange(3)
    left = []
    for first in starts:
        rows = slice(first, first + width)
        columns = np.concatenate([x, *(x * u[rows, d : d + 1] for d in range(drives))], axis=1)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        basis, size, _ = np.linalg.svd(columns, full_matrices=False)
        basis = basis[:, size > 1e-9 * size[0]]
        rest = y[rows] - basis @ (basis.conj().T @ y[rows])
        left.append(np.sum(np.abs(rest) ** 2, axis=0) / (width - basis.shape[1]) / samples)
    free = width - unknowns
    # Median of a mean of ``free`` exponentials: 1 - 1/(3 free).
    return np.median(left, axis=0) / (1.0 - 1.0 / (3.0 * free)), 2 * free * len(left)


def noise_level(campaign: Campaign, line_hz: float | None = None) -> NoiseLevel:
    """Noise of ``campaign`` a sample and channel.

    Parameters
    ----------
    campaign : records; those with role "noise" are silent.
    line_hz : mains frequency, whose harmonics are removed exactly; other narrow lines in silence are found.

    Raises
    ------
    MeasurementError : a channel shows no noise at all (then no error in sigmas exists), or records are too short to
        tell.
    """
    silent = campaign.with_role("noise")
    repeats = _between(_repeated(campaign), line_hz)
    if silent:
        level = _agreed(_silent(silent, line_hz, campaign.instrument.adc), repeats)
    elif repeats is not None:
        level = repeats
    else:
        found = [_local_variance(r) for r in campaign.records if r.drive_v.shape[0] > 50 * (r.drive_v.shape[1] + 1)]
        if not found:
            raise MeasurementError("records are too short to tell the noise", next_step="add a silent record")
        dof = sum(own for _, own in found)
        level = NoiseLevel(np.sqrt(sum(own * variance for variance, own in found) / dof), "local", dof)
    if not np.all(level.sigma_v > 0.0):
        raise MeasurementError(
            "a sense channel shows no noise",
            value=level.sigma_v.tolist(),
            allowed="sigma above zero in every channel",
            next_step="declare the converter ([instrument] adc) or add a silent record",
        )
    return level
