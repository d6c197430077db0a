"""The time shift of a record is exact in the signal band, and leaves white noise white."""

import numpy as np
import pytest

from pipeline.experiment.variation import advanced

RATE_HZ = 10_000.0
T = np.arange(20_000) / RATE_HZ


def ringing(t: np.ndarray) -> np.ndarray:
    """A burst (N, 1) around 535 Hz that starts and ends smoothly."""
    envelope = np.exp(-(((t - 1.0) / 0.2) ** 2))
    return (envelope * np.sin(2.0 * np.pi * 535.0 * t))[:, None]


@pytest.mark.parametrize("shift_s", [3e-7, -2.7e-5, 1.1e-4])
def test_a_shifted_record_equals_the_signal_at_shifted_times(shift_s):
    np.testing.assert_allclose(advanced(ringing(T), shift_s, RATE_HZ), ringing(T + shift_s), atol=1e-9)


def test_a_record_that_rings_to_its_end_is_shifted_without_an_error_that_counts_at_the_ends():
    def signal(t):
        return (np.sin(2.0 * np.pi * 535.0 * t) * (1.0 - np.exp(-(t**2) / 0.02)))[:, None]

    error = advanced(signal(T), 4e-5, RATE_HZ) - signal(T + 4e-5)
    # Noise of a typical record is 1e-3 of its signal per sample.
    assert np.max(np.abs(error)) < 1e-3
    assert np.sqrt(np.sum(error**2)) < 2e-3


def test_white_noise_stays_white():
    noise = np.random.default_rng(1).standard_normal((T.size, 1))
    moved = advanced(noise, 5e-5, RATE_HZ)
    power = np.abs(np.fft.rfft(moved[:, 0])) ** 2 / T.size
    octaves = [band.mean() for band in np.array_split(power[1:], 8)]
    assert np.std(moved) == pytest.approx(np.std(noise), rel=2e-3)
    # Each mean of 1250 exponential variables has a relative sd of 2.8 %.
    np.testing.assert_allclose(octaves, 1.0, atol=0.12)
