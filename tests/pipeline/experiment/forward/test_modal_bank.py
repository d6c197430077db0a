"""The modal bank against matrix exponentials of the whole device with its filter, and excitation, ADC and noise."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import butter, freqs

from pipeline.device.gyro import gyro_mechanics, gyro_modes
from pipeline.experiment.antialias import behind_filter, filter_poles, filter_response
from pipeline.experiment.excitation import Chirp, Multisine, drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.instrument import Adc, AntiAlias
from pipeline.experiment.noise.measure import Hum, convert, measured

DEVICE = np.array([[534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007]])
RATE = 10_000.0


def state_space(antialias):
    """A, B, C of mechanics and two filters in biquads, volts in, volts out."""
    m = gyro_mechanics(DEVICE)
    corner = 2.0 * np.pi * antialias.corner_hz
    q = [p for p in filter_poles(antialias)[0] if p.imag > 0.0]
    size = 6 + 4 * len(q)
    a, b, c = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((2, size))
    a[:3, 3:6], a[3:6, :3], a[3:6, 3:6] = np.eye(3), -m.stiffness[0], -m.damping[0]
    b[3:6] = m.drive[0]
    for sense in range(2):
        for k, pole in enumerate(q):
            i = 6 + 2 * len(q) * sense + 2 * k
            a[i, i + 1], a[i + 1, i], a[i + 1, i + 1] = corner, -corner, 2.0 * pole.real
            if k == 0:
                a[i + 1, 3:6] = corner * m.velocity_sense[0, sense]
            else:
                a[i + 1, i - 2] = corner
        c[sense, i] = 1.0
    return a, b, c


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_response_equals_that_of_the_matrix_exponential(hold):
    antialias = AntiAlias()
    drive = drive_samples(Chirp(duration_s=0.4), RATE)
    volts = respond(behind_filter(gyro_modes(DEVICE), antialias), drive, RATE, hold)[0]
    a, b, c = state_space(antialias)
    size = a.shape[0]
    # The input and its slope are additional states, which is exact for both holds.
    big = np.zeros((size + 4, size + 4))
    big[:size, :size], big[:size, size : size + 2] = a / RATE, b / RATE
    big[size : size + 2, size + 2 :] = np.eye(2)
    step = expm(big)[:size]
    x, direct = np.zeros(size), np.empty_like(drive)
    for n in range(drive.shape[0]):
        direct[n] = c @ x
        ahead = drive[min(n + 1, drive.shape[0] - 1)] - drive[n] if hold == "foh" else np.zeros(2)
        x = step @ np.concatenate([x, drive[n], ahead])
    assert np.max(np.abs(volts - direct)) < 1e-11 * np.max(np.abs(direct))


def test_bandlimited_hold_gives_the_steady_state_response_to_a_periodic_drive():
    drive = np.tile(drive_samples(Multisine(duration_s=0.5, period_s=0.5), RATE), (6, 1))
    damped = DEVICE.copy()
    damped[:, 3:6] = 5e-3  # the transient is gone within a period
    modes = gyro_modes(damped)
    volts = respond(behind_filter(modes, AntiAlias()), drive, RATE, "bandlimited")[0]
    period = 5000
    s = 2j * np.pi * np.fft.rfftfreq(period, 1.0 / RATE)
    transfer = modes.response(s)[0] * filter_response(AntiAlias(), s)
    spectrum = np.einsum("sdw,wd->ws", transfer, np.fft.rfft(drive[:period], axis=0))
    steady = np.fft.irfft(spectrum, n=period, axis=0)
    last = slice(-2 * period, -period)
    assert np.max(np.abs(volts[last] - steady)) < 1e-4 * np.max(np.abs(steady))


@pytest.mark.parametrize("order", [1, 2, 5, 8])
def test_the_filter_equals_the_butterworth_of_scipy(order):
    antialias = AntiAlias(order=order, corner_hz=4800.0)
    omega = 2.0 * np.pi * np.array([0.0, 60.0, 535.0, 4800.0, 20_000.0])
    _, expected = freqs(*butter(order, 2.0 * np.pi * 4800.0, analog=True), worN=omega)
    q, r = filter_poles(antialias)
    np.testing.assert_allclose(filter_response(antialias, 1j * omega), expected, rtol=1e-9)
    np.testing.assert_allclose(np.sum(r / (1j * omega[:, None] - q), axis=1), expected, rtol=1e-9)


def test_a_chirp_of_zero_amplitude_leaves_its_drive_silent():
    drive = drive_samples(Chirp(amplitude_v=(2.0, 0.0)), RATE)
    assert np.all(drive[:, 1] == 0.0)
    assert np.max(np.abs(drive[:, 0])) == pytest.approx(2.0, rel=1e-6)


def test_a_chirp_sweeps_from_its_start_to_its_stop_frequency():
    drive = drive_samples(Chirp(), RATE)
    crossings = np.flatnonzero(np.diff(np.signbit(drive[:, 0])))
    frequency = RATE / 2.0 / np.diff(crossings)
    assert np.median(frequency[:50]) == pytest.approx(400.0, rel=0.05)
    assert np.median(frequency[-50:]) == pytest.approx(700.0, rel=0.05)


def test_the_adc_rounds_to_its_lsb_and_clips_at_full_scale():
    adc = Adc(bits=8, full_scale_v=1.0)
    volts = np.linspace(-2.0, 2.0, 4001)
    codes = convert(volts, adc)
    inside = np.abs(volts) < 0.98
    assert np.max(np.abs(codes[inside] - volts[inside])) <= adc.lsb_v / 2.0 + 1e-15
    assert codes.min() == -1.0
    assert codes.max() == 1.0 - adc.lsb_v


def test_noise_and_hum_have_the_declared_variance():
    random = np.random.default_rng(3)
    record = measured(np.zeros((60_000, 2)), RATE, 0.01, Hum(60.0, (0.05,)), None, random)
    expected = 0.01**2 + 0.05**2 / 2.0
    assert np.var(record) == pytest.approx(expected, rel=5.0 * np.sqrt(2.0 / record.size))
