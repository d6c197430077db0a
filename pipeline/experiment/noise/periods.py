"""Noise from the steady-state periods of a periodic drive.

    n_k = sqrt(M / (M - 1)) (y_k - mean of y over the M periods),        M - 1 degrees of freedom for each sample and bin

The factor restores the variance that the mean takes, so the n_k in sequence are as good as silence: their spectrum is that of
the noise.  Periods in which the device still settles do not count: the differences of successive periods have equal energies in
steady state, so from the end of the record backwards periods are taken while

    e_k <= e (1 + 4 sqrt(2 / n (1 + 1/m)))

e_k is the energy of the n samples of a quarter of a difference, e the mean of the m quarters behind it.

The period is declared (``period_samples``) or that of a drive that repeats exactly.  Records that follow each other in one file
are one run here, whatever their roles.

Shapes: N samples, P samples of a period, M periods, D drives, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ...arrays import FloatArray
from ..instrument import Adc
from ..record import Record
from .spectrum import NoiseSpectrum, noise_spectrum

#: Shortest period [samples]; largest relative rms difference of a drive that repeats exactly.
_SHORTEST, _EXACT = 16, 1e-7
#: Quarters of a difference, and sds by which the energy of a quarter may exceed that of those behind it.
_PARTS, _SDS = 4, 4.0


def period_of(drive_v: FloatArray) -> int | None:
    """The period [samples] of drives (N, D) that repeat exactly at least twice; ``None`` where there is none."""
    samples = drive_v.shape[0]
    v = drive_v - drive_v.mean(axis=0, keepdims=True) if drive_v.shape[1] else drive_v
    power = float(np.sum(v**2))
    if power <= 0.0 or samples < 2 * _SHORTEST:
        return None
    size = next_fast_len(2 * samples, real=True)
    correlation = irfft(np.sum(np.abs(rfft(v, n=size, axis=0)) ** 2, axis=1), n=size)[: samples // 2 + 1]
    running = np.concatenate([[0.0], np.cumsum(np.sum(v**2, axis=1))])
    lag = np.arange(correlation.size)
    # |v[n + P] - v[n]|^2 summed over n, relative to both.
    both = running[samples - lag] + (running[samples] - running[lag])
    close = np.flatnonzero((both - 2.0 * correlation)[_SHORTEST:] < 1e-6 * both[_SHORTEST:]) + _SHORTEST
    for period in close.tolist():
        if np.sqrt(np.mean((v[period:] - v[:-period]) ** 2)) <= _EXACT * np.sqrt(power / v.size):
            return int(period)
    return None


def steady_periods(record: Record) -> FloatArray | None:
    """The periods y (M, P, S) [V] of a record in steady state, its last ones; ``None`` for fewer than two."""
    period = record.period_samples or period_of(record.drive_v)
    if period is None or 2 * period > record.sense_v.shape[0]:
        return None
    count = record.sense_v.shape[0] // period
    y = record.sense_v[record.sense_v.shape[0] - count * period :].reshape(count, period, -1)
    difference = np.diff(y, axis=0)
    difference = difference - difference.mean(axis=1, keepdims=True)
    width = period // _PARTS
    quarters = difference[:, : width * _PARTS].reshape(count - 1, _PARTS, width, -1)
    # Relative to the last one, channel by channel, so that a loud channel does not hide another one.
    energy = np.mean(quarters**2, axis=2).reshape((count - 1) * _PARTS, -1)
    steady = energy.shape[0] - 1
    while steady > 0:
        behind = energy[steady:]
        limit = 1.0 + _SDS * np.sqrt(2.0 / width * (1.0 + 1.0 / behind.shape[0]))
        if np.any(energy[steady - 1] > limit * behind.mean(axis=0)):
            break
        steady -= 1
    first = -(-steady // _PARTS)
    return y[first:] if count - first >= 2 else None


def runs_of(records: Sequence[Record]) -> list[Record]:
    """The records, those joined that follow each other in one file under the same conditions."""
    runs: list[Record] = []
    for record in sorted(records, key=lambda one: (one.file or "", one.elapsed_s)):
        last = runs[-1] if runs else None
        if last is not None and _goes_on(last, record):
            drive, sense = (
                np.concatenate(both) for both in ((last.drive_v, record.drive_v), (last.sense_v, record.sense_v))
            )
            runs[-1] = replace(last, drive_v=drive, sense_v=sense, bad=None)
        else:
            runs.append(record)
    return runs


def _goes_on(before: Record, after: Record) -> bool:
    conditions = [
        (one.file, one.bias_v, one.rate_dps, one.frequency_shift, one.period_samples) for one in (before, after)
    ]
    apart = (after.elapsed_s - before.elapsed_s) * before.sample_rate_hz - before.sense_v.shape[0]
    return before.file is not None and conditions[0] == conditions[1] and abs(apart) < 0.5


@dataclass(frozen=True, eq=False)
class PeriodNoise:
    """Noise variance (S,) [V^2] per sample, its degrees of freedom, and its spectrum."""

    variance: FloatArray
    dof: int
    spectrum: NoiseSpectrum


def period_noise(records: Sequence[Record], line_hz: float | None, adc: Adc | None) -> PeriodNoise | None:
    """The noise of ``records`` with at least two steady periods; ``None`` without such records.

    The spectrum is that of the record with the most degrees of freedom.
    """
    found = [(record, y) for record in runs_of(records) if (y := steady_periods(record)) is not None]
    if not found:
        return None
    total, dof = np.zeros(found[0][1].shape[2]), 0
    spectra: list[tuple[int, NoiseSpectrum]] = []
    for record, y in found:
        count, _, senses = y.shape
        rest = np.sqrt(count / (count - 1.0)) * (y - y.mean(axis=0))
        spectrum = noise_spectrum(rest.reshape(-1, senses), record.sample_rate_hz, line_hz, adc)
        # Offset and trend are left out; the mean of the periods takes the share 1/M of what remains.
        own = max(int(spectrum.dof * (count - 1) / count), 1)
        spectra.append((own, replace(spectrum, dof=own)))
        total, dof = total + own * spectrum.sigma_v**2, dof + own
    return PeriodNoise(total / dof, dof, max(spectra, key=lambda one: one[0])[1])
