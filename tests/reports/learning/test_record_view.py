"""The curves and pictures of a record have the values that theory gives for known signals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from reports.learning.record_view import (
    RecordView,
    by_level,
    drive_band,
    drive_frequency,
    pictured,
    record_pairs,
    resonance_windows,
    sigma_v,
    spectra,
    time_frequency,
)

RATE, N, SIGMA = 4000.0, 6000, 1e-3
T = np.arange(N) / RATE
Build = Callable[..., RecordView]


def test_white_noise_lies_on_the_floor_of_both_spectra(record: Build) -> None:
    view = record(cubic=0.0)
    assert sigma_v(view) == pytest.approx([SIGMA, SIGMA], rel=0.01)
    found = spectra(view, (1000.0, 1900.0))
    # The amplitude of noise scatters from bin to bin; its mean square is that of the floor.
    power = np.mean(np.abs(np.fft.rfft(view.residual * SIGMA, axis=0)[1500:2850] * 2 / N) ** 2)
    assert np.sqrt(power) == pytest.approx(float(found.floor.mean()), rel=0.05)
    picture = time_frequency(view, 60, (0.0, 2000.0))
    assert 10 * np.log10(np.mean(10 ** (picture.over_noise_db / 10))) == pytest.approx(0.0, abs=0.15)


def test_a_tone_has_its_amplitude_in_the_spectrum() -> None:
    tone = 0.3 * np.sin(2 * np.pi * 400.0 * T)[:, None]
    view = RecordView("tone", "fit", RATE, tone, tone, 0.0 * tone, tone, 1.0)
    found = spectra(view, (390.0, 410.0))
    assert found.measured.max() == pytest.approx(0.3, rel=1e-3)
    assert found.frequency_hz[found.measured[:, 0].argmax()] == pytest.approx(400.0, abs=0.2)


def test_the_drive_frequency_is_that_of_the_sweep_and_the_residual_lies_on_its_third_harmonic(record: Build) -> None:
    view = record()
    times, drives = drive_frequency(view)
    assert drives.shape[0] == 2
    inner = slice(5, -5)
    slope = (500.0 - 300.0) / T[-1]
    np.testing.assert_allclose(drives[0][inner], 300.0 + slope * times[inner], atol=1.0)
    np.testing.assert_allclose(drives[1][inner], 500.0 - slope * times[inner], atol=1.0)
    picture = time_frequency(view, 60, (800.0, 2000.0))
    row, column = np.unravel_index(picture.over_noise_db.argmax(), picture.over_noise_db.shape)
    assert picture.frequency_hz[row] == pytest.approx(3 * (300.0 + slope * picture.time_s[column]), abs=60.0)


def test_a_multisine_has_no_instantaneous_frequency(record: Build) -> None:
    random = np.random.default_rng(3)
    sines = sum(np.sin(2 * np.pi * (300.0 + k) * T + random.uniform(0, 6.28)) for k in range(100))
    view = replace(record(), drive_v=np.asarray(sines)[:, None])
    assert drive_frequency(view)[1].shape[0] == 0
    low, high = drive_band(view)
    assert 295.0 < low < 310.0 < 390.0 < high < 405.0


def test_a_cubic_residual_rises_as_the_third_power_of_the_level(record: Build) -> None:
    level, residual = by_level(record(), 0)
    excess = np.sqrt(np.maximum(residual**2 - 1.0, 0.0))
    high = level > 0.3
    slope = np.polyfit(np.log(level[high]), np.log(excess[high]), 1)[0]
    assert slope == pytest.approx(3.0, abs=0.25)
    # The smallest bins hold three blocks of twelve samples: sd 0.12.
    assert np.all(np.abs(by_level(record(cubic=0.0), 0)[1] - 1.0) < 4 * 0.12)


def test_the_worst_fitted_and_held_out_records_are_pictured_and_repeats_once(record: Build) -> None:
    again = replace(record("again"), error=99.0)
    views = [
        record(),
        again,
        record("low", amplitude=1.0),
        record("held out", "validate", 1.5),
        record("other", amplitude=0.5),
    ]
    chosen = [pair[0].name for pair in pictured(record_pairs(views, None))]
    assert chosen == ["again", "held out", "low"]


def test_records_of_both_models_are_paired_by_name_and_shape(record: Build) -> None:
    first, last = record(), record(cubic=0.0)
    short = RecordView("short", "fit", RATE, *(np.zeros((3, 1)) for _ in range(4)), 0.0)
    single = replace(last, residual=last.residual[:, :1])
    assert record_pairs([first, short], [last]) == [(first, last)]
    assert record_pairs([first], [single]) == [(first, None)]
    assert record_pairs([first], None) == [(first, None)]


def test_close_resonances_share_a_window_and_resonances_above_nyquist_have_none(record: Build) -> None:
    parameters = {"f1_hz": 399.0, "f2_hz": 401.0, "f3_hz": 600.0, "f4_hz": 2500.0, "zeta3": 0.01, "theta_deg": 1.0}
    windows = resonance_windows(parameters, [record()])
    assert [window.centres_hz for window in windows] == [(399.0, 401.0), (600.0,)]
    # Thirty lines of 4000 / 6000 Hz, or twenty half-widths of the resonance.
    assert windows[0].band_hz == pytest.approx((379.0, 421.0))
    assert windows[1].half_hz == pytest.approx(120.0)
    # A model without resonances: the largest response of the record, at the centre of the sweep.
    (window,) = resonance_windows({}, [record(cubic=0.0)])
    assert window.centres_hz[0] == pytest.approx(400.0, abs=20.0)
