"""The measured density of noise equals that of the process that made it, within the sd it states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.arrays import FloatArray
from pipeline.experiment.instrument import Adc
from pipeline.experiment.noise.lines import silent_sigma
from pipeline.experiment.noise.measure import Hum, measured
from pipeline.experiment.noise.spectrum import noise_spectrum

RATE, SAMPLES = 10_000.0, 10_000
AT_HZ: FloatArray = np.array([30.0, 100.0, 450.0, 535.0, 590.0, 2000.0, 4500.0])


def _autoregressive(coefficient: float, random: np.random.Generator) -> FloatArray:
    """AR(1) noise (N, 2) of sd 1 V."""
    fresh = random.standard_normal((SAMPLES + 300, 2))
    return np.asarray(lfilter([np.sqrt(1.0 - coefficient**2)], [1.0, -coefficient], fresh, axis=0))[300:]


def _autoregressive_density(coefficient: float) -> FloatArray:
    turn = np.exp(-2j * np.pi * AT_HZ / RATE)
    return np.asarray(2.0 / RATE * (1.0 - coefficient**2) / np.abs(1.0 - coefficient * turn) ** 2)


@pytest.mark.parametrize("coefficient", [0.7, -0.5])
def test_density_of_autoregressive_noise_is_measured_within_its_sd(coefficient: float) -> None:
    random = np.random.default_rng(3)
    z = []
    for _ in range(40):
        spectrum = noise_spectrum(_autoregressive(coefficient, random), RATE)
        assert not spectrum.white
        found = np.log(spectrum.psd(AT_HZ) / _autoregressive_density(coefficient)[:, None])
        z.append(found / spectrum.relative_sd(AT_HZ))
    # A smooth density is known better than the prior of its steps allows for: rms z of 0.6 to 1.
    rms = np.sqrt(np.mean(np.square(z), axis=(0, 2)))
    assert np.all((rms > 0.4) & (rms < 1.25))
    assert np.abs(np.mean(z)) < 5.0 / np.sqrt(len(z))


def test_density_of_one_over_f_noise_is_measured_without_bias_down_to_the_lowest_band() -> None:
    random, corner_hz = np.random.default_rng(8), 200.0
    f = np.maximum(np.fft.rfftfreq(SAMPLES, 1.0 / RATE), RATE / SAMPLES)
    z = []
    for _ in range(40):
        white = np.fft.rfft(random.standard_normal((SAMPLES, 2)), axis=0)
        y = np.fft.irfft(white * np.sqrt(1.0 + corner_hz / f)[:, None], n=SAMPLES, axis=0)
        spectrum = noise_spectrum(y, RATE)
        at_hz = spectrum.frequency_hz[:4]
        z.append(
            (spectrum.log_density[:4] - np.log(2.0 / RATE * (1.0 + corner_hz / at_hz))[:, None]) / spectrum.log_sd[:4]
        )
    # The mean of 80 values has an sd of 0.11 where z is N(0, 1); equal steps in ln(1 + f/f0) gave -3.4 in the lowest band.
    mean = np.mean(z, axis=(0, 2))
    assert np.all(np.abs(mean) < 0.5), mean


def test_white_noise_keeps_one_sigma_from_all_samples() -> None:
    random = np.random.default_rng(4)
    coloured = 0
    for _ in range(100):
        y = 1e-3 * random.standard_normal((SAMPLES, 2))
        spectrum = noise_spectrum(y, RATE, 60.0)
        coloured += not spectrum.white
        if spectrum.white:
            assert np.array_equal(spectrum.sigma_v, silent_sigma(y, RATE, 60.0, None))
            assert np.allclose(spectrum.sigma_at(AT_HZ), spectrum.sigma_v, rtol=1e-12)
    # 200 tests at 1e-3: three or more have a probability of 1e-3.
    assert coloured <= 2


def test_integral_of_the_density_is_the_variance() -> None:
    spectrum = noise_spectrum(_autoregressive(0.7, np.random.default_rng(5)), RATE)
    f = np.linspace(0.0, RATE / 2.0, 20_001)
    variance = np.trapezoid(spectrum.psd(f), f, axis=0)
    assert np.allclose(variance, spectrum.sigma_v**2, rtol=0.05)


def test_lines_do_not_count_as_colour() -> None:
    random = np.random.default_rng(6)
    t = np.arange(SAMPLES) / RATE
    y = random.standard_normal((SAMPLES, 2)) + 3.0 * np.sin(2.0 * np.pi * 517.3 * t)[:, None]
    spectrum = noise_spectrum(y, RATE)
    assert np.allclose(spectrum.sigma_at(AT_HZ), 1.0, atol=0.05)


def test_hum_and_quantisation_are_accounted_for() -> None:
    adc = Adc(16, 10.0)
    quiet = measured(np.zeros((SAMPLES, 2)), RATE, 0.2 * adc.lsb_v, Hum(), adc, np.random.default_rng(7))
    spectrum = noise_spectrum(quiet, RATE, None, adc)
    assert np.all(spectrum.sigma_v**2 > adc.lsb_v**2 / 12.0)
    assert np.all(spectrum.psd(AT_HZ) > 2.0 / RATE * adc.lsb_v**2 / 12.0)
    hum = Hum(50.0, (0.005, 0.002, 0.003))
    loud = measured(np.zeros((SAMPLES, 2)), RATE, 1e-3, hum, adc, np.random.default_rng(8))
    assert noise_spectrum(loud, RATE, 50.0, adc).white
