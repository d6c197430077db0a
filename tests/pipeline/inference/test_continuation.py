"""Fits of strongly nonlinear records: restarts, and continuation in length where whole records have wrong minima."""

import numpy as np
import pytest

from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.level import NoiseLevel
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.general import gauss_newton
from pipeline.inference.general.fit import fit_campaign

RATE_HZ, SIGMA_V = 610.35, 1e-4
INSTRUMENT = Instrument(sample_rate_hz=RATE_HZ, hold="bandlimited", bias_v=0.0)
LINEAR = Model(PlantSpec("modal", 1, "displacement")).with_channels(1, 1)
DUFFING = LINEAR.with_effect("cubic_stiffness").with_effect("quadratic_stiffness")
#: An electronic resonator that hardens: at 150 mV of drive its frequency doubles.
VALUES = {
    "f1_hz": 68.4,
    "zeta1": 0.049,
    "gain1_s1d1": 1.86e5,
    "cubic_stiffness.k3": 7.3e5,
    "quadratic_stiffness.k2x": -1.9e4,
}


def measured(level_v, seed=0, samples=1024):
    """A multisine record up to 200 Hz with white noise."""
    random = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE_HZ)
    phases = np.exp(2j * np.pi * random.uniform(size=frequency.size))
    drive = np.fft.irfft(np.where((frequency > 0.0) & (frequency < 200.0), phases, 0.0), samples)
    drive = (drive * level_v / drive.std())[:, None]
    empty = Record("multisine", RATE_HZ, drive, np.zeros_like(drive), "fit")
    sense = forward(DUFFING, VALUES, empty, INSTRUMENT) + SIGMA_V * random.standard_normal(drive.shape)
    return Campaign("duffing", (Record("multisine", RATE_HZ, drive, sense, "fit"),), INSTRUMENT)


@pytest.mark.parametrize(("level_v", "seed"), [(0.05, 0), (0.2, 2)])
def test_a_hardening_resonator_is_fitted_from_the_default_start_down_to_the_noise(level_v, seed):
    """Without continuation, five of eight such records (150 and 200 mV, four seeds) end in a wrong minimum, this one at 1043."""
    noise = NoiseLevel(np.array([SIGMA_V]), "silent", 10_000)
    found = fit_campaign(DUFFING, measured(level_v, seed), noise)
    assert found.fit_ok
    assert found.error["fit"] == pytest.approx(1.0, abs=5.0 / np.sqrt(2.0 * found.dof))
    for name, truth in VALUES.items():
        value, sd = found.parameters[name]
        assert abs(value - truth) < 4.0 * sd


def test_an_unfinished_fit_goes_on_from_where_it_stopped(monkeypatch):
    noise = NoiseLevel(np.array([SIGMA_V]), "silent", 10_000)
    whole = fit_campaign(DUFFING, measured(0.05), noise)
    monkeypatch.setattr(gauss_newton, "ITERATIONS", 2)
    assert fit_campaign(DUFFING, measured(0.05), noise).chi2 == pytest.approx(whole.chi2, abs=0.1)
