"""Noise from steady-state periods: the right factor, the settling left out, periods found without being declared."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.signal import fftconvolve

from pipeline.arrays import FloatArray
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.noise.periods import period_of, steady_periods
from pipeline.experiment.record import Campaign, Record

RATE_HZ, PERIOD = 1000.0, 1000


def multisine(periods: int, seed: int = 1) -> FloatArray:
    phase = np.random.default_rng(seed).uniform(0.0, 6.28, 200)
    t = np.arange(PERIOD)[:, None] * np.arange(1, 201) / PERIOD
    return np.tile(np.cos(2.0 * np.pi * t + phase).sum(axis=1), periods)


@lru_cache(maxsize=4)
def settling(periods: int) -> FloatArray:
    """A mode of 80 Hz with a decay time of 0.5 s, from rest."""
    t = np.arange(4 * PERIOD) / RATE_HZ
    return fftconvolve(multisine(periods), 0.01 * np.exp(-2.0 * t) * np.sin(2.0 * np.pi * 80.0 * t))[: periods * PERIOD]


def record(periods: int, sigma: float, seed: int, colour: float = 0.0) -> Record:
    """The settling device with noise of one autoregressive pole."""
    u, random = multisine(periods), np.random.default_rng(seed)
    y = settling(periods)
    white = random.standard_normal(u.size + 200)
    noise = np.convolve(white, np.sqrt(1.0 - colour**2) * colour ** np.arange(200.0))[200 : 200 + u.size]
    return Record("multisine", RATE_HZ, u[:, None], (y + sigma * noise)[:, None], "fit")


def campaign(one: Record) -> Campaign:
    return Campaign("m", (one,), Instrument(RATE_HZ))


def test_the_period_of_a_drive_is_found_only_where_it_repeats_exactly() -> None:
    u = multisine(3)
    assert period_of(u[:, None]) == PERIOD
    assert period_of(np.stack([u, np.zeros(u.size)], axis=1)) == PERIOD
    t = np.arange(3000) / RATE_HZ
    for other in (u + 1e-3 * np.random.default_rng(0).standard_normal(u.size), np.sin(300.0 * t * t), np.zeros(3000)):
        assert period_of(other[:, None]) is None


def test_periods_in_which_the_device_settles_do_not_count() -> None:
    y = steady_periods(record(12, 1e-3, 3))
    assert y is not None
    # The transient of 0.1 V falls by e^-2 in a period: below the noise of 1 mV from the fourth on.
    assert 6 <= y.shape[0] <= 10
    assert steady_periods(record(2, 1e-3, 3)) is None


@pytest.mark.parametrize("periods", [8, 20])
def test_the_level_has_one_degree_of_freedom_less_than_periods_for_each_sample(periods: int) -> None:
    z = []
    for seed in range(20):
        level = noise_level(campaign(record(periods, 1e-2, seed)))
        assert (level.source, level.independent) == ("repeats", True)
        used = steady_periods(record(periods, 1e-2, seed))
        assert used is not None
        assert level.dof == pytest.approx((used.shape[0] - 1) * PERIOD, rel=0.02)
        z.append(((level.sigma_v[0] / 1e-2) ** 2 - 1.0) / np.sqrt(2.0 / level.dof))
    # The steady periods are those of lower energy, so what remains of the transient and the choice may shift z by a part of a sd.
    assert abs(np.mean(z)) < 0.6
    assert 0.6 < np.std(z) < 1.5


def test_the_spectrum_of_coloured_noise_follows_from_the_periods() -> None:
    level = noise_level(campaign(record(40, 1e-2, 5, colour=0.7)))
    assert level.spectrum is not None
    f = np.array([5.0, 50.0, 200.0, 450.0])
    wave = np.exp(-2j * np.pi * f / RATE_HZ)
    expected = 1e-2 * np.sqrt(1.0 - 0.7**2) / np.abs(1.0 - 0.7 * wave)
    assert level.spectrum.sigma_at(f)[:, 0] == pytest.approx(expected, rel=0.1)


def test_the_periods_of_records_cut_from_one_file_count_together() -> None:
    whole = record(12, 1e-3, 3)
    cut = 10 * PERIOD
    first = replace(whole, drive_v=whole.drive_v[:cut], sense_v=whole.sense_v[:cut], file="m.csv")
    later = {"drive_v": whole.drive_v[cut:], "sense_v": whole.sense_v[cut:], "file": "m.csv", "role": "validate"}
    second = replace(whole, name="held out", elapsed_s=cut / RATE_HZ, **later)
    both, alone = (noise_level(Campaign("m", each, Instrument(RATE_HZ))) for each in ((first, second), (whole,)))
    assert (both.source, both.dof, both.sigma_v[0]) == ("repeats", alone.dof, alone.sigma_v[0])
    # A gap between them would turn the phase of the periods.
    apart = replace(second, elapsed_s=second.elapsed_s + 0.1)
    assert noise_level(Campaign("m", (first, apart), Instrument(RATE_HZ))).dof < alone.dof
