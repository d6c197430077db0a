"""The noise level of a campaign, measured without a model of the device.

    sigma = standard deviation of the noise per sample and channel [V]

It comes from the first of these sources that is available:

    "silent"    the rms of the silent records after offset, trend and lines are removed.  LSB^2/12 is added where the noise is
                too small to exercise the ADC.  Repeats are pooled with it if both agree within 3 sd.
    "repeats"   the rms of the difference of two records with the same drive and conditions, divided by sqrt 2; or that of the
                periods of a periodic drive in steady state (``periods``)
    "local"     a local fit of the response over neighbouring frequencies (``local``)
    "residual"  nothing measures the noise: sigma is only an upper bound, from the same local fit; ``known`` is false

sigma is never taken from the residual of the device model, because a wrong model would then look right.

Shapes: N samples, S senses, D drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.fft import rfft
from scipy.ndimage import maximum_filter1d, median_filter

from ...arrays import FloatArray
from ...errors import MeasurementError
from ..instrument import Adc
from ..record import Campaign, Record
from .lines import fitted_lines, regressors, with_quantisation
from .local import has_windows, local_noise
from .periods import period_noise
from .spectrum import NoiseSpectrum, noise_spectrum

Source = Literal["silent", "repeats", "local", "residual"]

#: A bin this many times above the level of its neighbourhood is a line (false-alarm probability 2e-9 per bin of white noise).
_LINE = 20.0
_NEIGHBOURS = 201
#: If all lines together have less than this share of the power, their power is subtracted; else their bins are left out.
_FAINT = 0.03
#: Silence and repeats agree if their variances differ by less than this many sd.
_AGREE = 3.0


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """A measured noise level.

    Parameters
    ----------
    sigma_v : (S,) standard deviation per sample and channel [V].
    source : how it was measured: "silent", "repeats", "local" or "residual" (see the head of this module).
    dof : degrees of freedom per channel; the relative sd of sigma^2 is sqrt(2 / dof).
    common_v : record name -> (m, N, S) [V], signals of independent unit-normal size that the noise of a record contains,
        such as the effect of a random start time; the covariance of the record is sigma^2 I + sum_i c_i c_i'.
    spectrum : of the silence; ``None`` counts as white.
    mixing : record name -> L_n^-1 (N, S, S) with L_n L_n' the covariance of sample n in units of sigma, for noise that depends
        on the signal.
    """

    sigma_v: FloatArray
    source: Source
    dof: int
    common_v: Mapping[str, FloatArray] = field(default_factory=dict)
    spectrum: NoiseSpectrum | None = None
    mixing: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether the level was measured; else it is only bounded."""
        return self.source != "residual"

    @property
    def independent(self) -> bool:
        """Whether the level was measured on other data than the driven records; else no error in units of it is given."""
        return self.source in ("silent", "repeats")

    def beginning(self, samples: int) -> NoiseLevel:
        """The noise of the first ``samples`` of every record."""
        common = {name: signals[:, :samples] for name, signals in self.common_v.items()}
        return replace(self, common_v=common, mixing={name: inverse[:samples] for name, inverse in self.mixing.items()})


def _spectral_variance(y: FloatArray, sample_rate_hz: float, line_hz: float | None) -> tuple[FloatArray, int]:
    """Variance (S,) [V^2] of y (N, S) without offset, trend, harmonics of ``line_hz`` and other narrow lines; its dof.

    Lines are sought relative to their neighbours only, because the noise level is unknown.  ``criticism.regions`` answers another
    question: which bins exceed a known noise level as well as their neighbours.
    """
    samples = y.shape[0]
    detrended = y - fitted_lines(y, sample_rate_hz, line_hz, True)
    power = np.abs(rfft(detrended * np.hanning(samples)[:, None], axis=0)[1:]) ** 2
    reach = min(_NEIGHBOURS, power.shape[0] | 1)
    # The median of an exponential distribution is ln 2 of its mean.  One channel at a time: a filter over one axis is ten
    # times as fast as over two.
    level = np.stack([median_filter(own, size=reach, mode="nearest") for own in power.T], axis=1) / np.log(2.0)
    # A Hann window spreads a line over at most five bins.
    line = maximum_filter1d(power > _LINE * level, size=5, axis=0)
    free = samples - regressors(sample_rate_hz, line_hz, True)
    plain = np.sum(detrended**2, axis=0) / max(free, 1)
    kept = np.maximum(np.sum(~line, axis=0), 1)
    window = np.sum(np.hanning(samples) ** 2)
    background = np.sum(np.where(line, 0.0, power), axis=0) / kept
    # A^2/2 = 2 sum |X|^2 / (N sum w^2) over the bins of a line.
    lines = 2.0 * np.sum(np.where(line, power - background, 0.0), axis=0) / (window * samples)
    if np.all(lines < _FAINT * plain):
        # The window discards half of the information, so the unwindowed variance is used less the power of the lines.
        return plain - lines, free - int(2 * line.sum(axis=0).max())
    return background / window * samples / max(free, 1), int(kept.min())


def _silent(records: tuple[Record, ...], line_hz: float | None, adc: Adc | None) -> NoiseLevel:
    total, dof = np.zeros(records[0].sense_v.shape[1]), 0
    for record in records:
        variance, own = _spectral_variance(record.sense_v, record.sample_rate_hz, line_hz)
        total, dof = total + own * variance, dof + own
    variance = total / dof
    return NoiseLevel(np.sqrt(with_quantisation(variance, adc)), "silent", dof)


def repeats_of(campaign: Campaign) -> list[tuple[Record, Record]]:
    """Pairs of driven records with the same drive samples and conditions that start at rest."""
    driven = _driven(campaign)
    return [
        (a, b)
        for a, b in combinations(driven, 2)
        if a.drive_v.shape == b.drive_v.shape
        and np.array_equal(a.drive_v, b.drive_v)
        and (a.bias_v, a.rate_dps, a.frequency_shift) == (b.bias_v, b.rate_dps, b.frequency_shift)
        and a.at_rest
        and b.at_rest
    ]


def _driven(campaign: Campaign) -> list[Record]:
    return [record for record in campaign.records if record.role != "noise" and np.any(record.drive_v)]


def _from_repeats(repeats: list[tuple[Record, Record]], line_hz: float | None) -> NoiseLevel | None:
    """Noise level from the differences of repeats; ``None`` without repeats."""
    if not repeats:
        return None
    total, dof = np.zeros(repeats[0][0].sense_v.shape[1]), 0
    for a, b in repeats:
        variance, own = _spectral_variance((a.sense_v - b.sense_v) / np.sqrt(2.0), a.sample_rate_hz, line_hz)
        total, dof = total + own * variance, dof + own
    return NoiseLevel(np.sqrt(total / dof), "repeats", dof)


def _pooled(silent: NoiseLevel, repeats: NoiseLevel | None) -> NoiseLevel:
    """Silence and repeats together if their variances agree within 3 sd; else silence alone."""
    if repeats is None:
        return silent
    ratio = (repeats.sigma_v / silent.sigma_v) ** 2 - 1.0
    if not np.all(np.abs(ratio) < _AGREE * np.sqrt(2.0 / silent.dof + 2.0 / repeats.dof)):
        return silent
    dof = silent.dof + repeats.dof
    variance = (silent.dof * silent.sigma_v**2 + repeats.dof * repeats.sigma_v**2) / dof
    return NoiseLevel(np.sqrt(variance), "silent", dof)


def noise_level(campaign: Campaign, line_hz: float | None = None) -> NoiseLevel:
    """The noise level of ``campaign``.

    Parameters
    ----------
    campaign : its records; those with role "noise" are silent.
    line_hz : mains frequency [Hz] whose harmonics are removed exactly; other narrow lines are detected.

    Raises
    ------
    MeasurementError : a channel has no noise at all, or the noise level could not be measured because the records are too
        short for a local fit.
    """
    silent = campaign.with_role("noise")
    repeats = _from_repeats(repeats_of(campaign), line_hz)
    if silent:
        longest = max(silent, key=lambda record: record.sense_v.shape[0])
        spectrum = noise_spectrum(longest.sense_v, longest.sample_rate_hz, line_hz, campaign.instrument.adc)
        if spectrum.white:
            level = _pooled(_silent(silent, line_hz, campaign.instrument.adc), repeats)
        else:
            level = NoiseLevel(spectrum.sigma_v, "silent", spectrum.dof, spectrum=spectrum)
    elif repeats is not None:
        level = repeats
    elif (periods := period_noise(_driven(campaign), line_hz, campaign.instrument.adc)) is not None:
        if periods.spectrum.white:
            level = NoiseLevel(np.sqrt(periods.variance), "repeats", periods.dof)
        else:
            level = NoiseLevel(periods.spectrum.sigma_v, "repeats", periods.dof, spectrum=periods.spectrum)
    else:
        found = [record for record in campaign.records if has_windows(record)]
        if not found:
            raise MeasurementError(
                "the noise level could not be measured: the records are too short",
                value=max(record.drive_v.shape[0] for record in campaign.records),
                allowed="a silent record, repeats, or more than 50 (drives + 1) samples",
                next_step='add a record with all drives at zero and role = "noise"',
            )
        local = local_noise(found)
        level = NoiseLevel(np.sqrt(local.variance), "local" if local.measured else "residual", local.dof)
    if not np.all(level.sigma_v > 0.0):
        raise MeasurementError(
            "a sense channel has no noise",
            value=level.sigma_v.tolist(),
            allowed="sigma above 0 V in every channel",
            next_step="declare adc under [instrument] so that its quantisation counts, or add a silent record",
        )
    return level
