"""Noise that is not white: the whitened likelihood, the noise that depends on the signal, and honest intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from pipeline.device.gyro import gyro_modes, to_cartesian
from pipeline.experiment.noise.source import NoiseKind, noise_volts
from pipeline.experiment.noise.spectrum import NoiseSpectrum, noise_spectrum, white_spectrum
from pipeline.experiment.variation import advance_response
from pipeline.inference.screening.compressed import BandData, compress
from pipeline.inference.screening.dependent_noise import advanced_products, factor_of, find_dependent_noise
from pipeline.inference.screening.fit import maximise
from pipeline.inference.screening.whitening import BandNoise, band_noise, on_grid, white_noise

RATE = 10_000.0
SIGMA = 1e-3


def _poles(bench, physical):
    return gyro_modes(np.asarray(physical)[None]).poles[0]


@pytest.fixture
def clean(bench, paper_device):
    return bench.volts(paper_device)


def _data(bench, volts, noise=None):
    band = bench.shared.band
    return BandData(band, band.transform(volts), bench.shared.nuisance, noise)


def test_white_noise_given_as_a_spectrum_leaves_the_likelihood_unchanged(bench, clean, paper_device):
    expansion = _poles(bench, paper_device)
    sigma = np.array([SIGMA, 2.0 * SIGMA])
    volts = clean + sigma * np.random.default_rng(1).standard_normal(clean.shape)
    plain = compress([_data(bench, volts)], sigma, expansion)
    whitened = compress([_data(bench, volts, white_noise(sigma, bench.shared.band))], sigma, expansion)
    assert np.allclose(
        np.abs(whitened.triangle), np.abs(plain.triangle), rtol=1e-9, atol=1e-9 * np.abs(plain.triangle).max()
    )
    assert np.allclose(np.abs(whitened.data), np.abs(plain.data), rtol=1e-6, atol=1e-6)
    assert np.allclose(whitened.rest_chi2, plain.rest_chi2, rtol=1e-6)


@pytest.mark.parametrize(
    "kind", [NoiseKind("ar"), NoiseKind("jitter", jitter_s=6e-7), NoiseKind("gain", gain_noise=2e-3)]
)
def test_whitened_data_of_noise_alone_are_independent_with_unit_variance(bench, clean, paper_device, kind):
    """sum |U^-1 d|^2 of noise is chi-square with 2 r degrees of freedom; as white noise of its mean level it is not."""
    band, expansion = bench.shared.band, _poles(bench, paper_device)
    random = np.random.default_rng(2)
    if kind.kind == "ar":
        turn = np.exp(-2j * np.pi * band.frequency_hz / RATE)
        variance = SIGMA**2 * (1.0 - kind.coefficient**2) / np.abs(1.0 - kind.coefficient * turn) ** 2
        noise = BandNoise(np.stack([variance, variance]), np.zeros(2), np.zeros((3, 0)))
    else:
        size = kind.jitter_s if kind.kind == "jitter" else kind.gain_noise
        s = size * factor_of(kind.kind, clean, RATE).T
        v = on_grid(np.stack([s[0] ** 2, s[0] * s[1], s[1] ** 2]), band)
        white = white_noise(np.full(2, SIGMA), band)
        noise = BandNoise(white.variance, white.relative_sd, v)
    found, dof = [], 0
    for _ in range(12):
        volts = noise_volts(kind, SIGMA, clean, RATE, random)
        data = compress([_data(bench, volts, noise)], np.full(2, SIGMA), expansion).data
        found.append(float(np.sum(data**2)))
        dof = data.size
    assert chi2.ppf(1e-4, 12 * dof) < sum(found) < chi2.ppf(1.0 - 1e-4, 12 * dof)


def test_jitter_of_an_advanced_record_has_the_variance_of_interpolated_noise():
    """The noise of a sample is spread over its neighbours: the variance at the zeros of the slope is not zero."""
    random, t = np.random.default_rng(6), np.arange(2000)
    shift, slope = 0.4, lambda k: np.cos(2.0 * np.pi * 0.054 * k)
    # Noise of sample j belongs to the signal at j - shift, because a record that starts late is advanced.
    noise = slope(t - shift) * random.standard_normal((400, t.size))
    moved = np.fft.irfft(np.fft.rfft(noise) * advance_response(t.size, shift), n=t.size)
    measured = np.mean(moved**2, axis=0)[300:-300]
    expected = advanced_products(slope(t) ** 2, shift)[300:-300]
    z = (measured / expected - 1.0) / np.sqrt(2.0 / 400)
    assert abs(np.mean(z)) < 5.0 / np.sqrt(z.size)
    assert np.mean(z**2) < 1.3


@pytest.mark.parametrize("kind", [NoiseKind("jitter", jitter_s=3e-7), NoiseKind("gain", gain_noise=1e-3)])
def test_dependent_noise_is_measured_above_the_band_and_told_by_its_kind(clean, kind):
    noise = white_spectrum(np.full(2, SIGMA), RATE, 10_000)
    found = find_dependent_noise(noise_volts(kind, SIGMA, clean, RATE, np.random.default_rng(3)), clean, noise, 700.0)
    assert found is not None
    assert found.kind == kind.kind
    true = kind.jitter_s if kind.kind == "jitter" else kind.gain_noise
    assert found.rms == pytest.approx(true, rel=0.05)
    # One clock samples both channels, and one reference converts them.
    assert found.covariance[0, 1] == pytest.approx(true**2, rel=0.15)


def test_white_noise_shows_no_dependent_noise(clean):
    random = np.random.default_rng(3)
    noise = white_spectrum(np.full(2, SIGMA), RATE, 10_000)
    for _ in range(5):
        volts = noise_volts(NoiseKind(), SIGMA, clean, RATE, random)
        assert find_dependent_noise(volts, clean, noise, 700.0) is None


def test_a_misfit_in_the_band_is_not_taken_for_dependent_noise(bench, clean, paper_device):
    other = np.array(paper_device)
    other[3] *= 1.02
    wrong = bench.volts(other) - clean + SIGMA * np.random.default_rng(4).standard_normal(clean.shape)
    noise = white_spectrum(np.full(2, SIGMA), RATE, 10_000)
    assert np.sqrt(np.mean(wrong**2)) > 2.0 * SIGMA
    assert find_dependent_noise(wrong, clean, noise, 700.0) is None


def test_clipping_is_not_taken_for_noise_that_grows_with_the_level(clean):
    """Its harmonics fold back into the band that is free of signal, on ridges of time and frequency."""
    noise = white_spectrum(np.full(2, SIGMA), RATE, 10_000)
    level = 0.95 * float(np.abs(clean).max())
    random = np.random.default_rng(8)
    volts = SIGMA * random.standard_normal(clean.shape) + np.clip(clean, -level, level) - clean
    plain = volts.std() / SIGMA
    assert plain > 1.05
    assert find_dependent_noise(volts, clean, noise, 700.0) is None


def test_the_sd_grows_with_the_density_of_the_noise_at_the_resonance(bench, clean, paper_device):
    x = to_cartesian(np.asarray(paper_device)[None])[0]
    band = bench.shared.band
    centre = np.array([10.0, 5000.0])
    level = np.log(np.full((2, 2), 2.0 * (3.0 * SIGMA) ** 2 / RATE))
    loud = NoiseSpectrum(RATE, np.full(2, SIGMA), 10_000, centre, level, np.zeros((2, 2)), 80.0)
    white = maximise([_data(bench, clean)], np.full(2, SIGMA), x)
    coloured = maximise([_data(bench, clean, band_noise(loud, band))], np.full(2, SIGMA), x)
    ratio = np.sqrt(np.diag(coloured.covariance) / np.diag(white.covariance))
    assert np.allclose(ratio, 3.0, rtol=1e-3)


def test_silence_that_shows_colour_widens_the_intervals():
    silence = noise_volts(NoiseKind("ar"), SIGMA, np.zeros((10_000, 2)), RATE, np.random.default_rng(5))
    spectrum = noise_spectrum(silence, RATE)
    assert np.allclose(spectrum.sigma_at(np.array([535.0])) / SIGMA, np.sqrt(0.51 / 0.1683), rtol=0.12)
