"""Ring-downs of a device whose force law has a coordinate of its own, a memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.level import NoiseLevel
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.general.fit import fit_campaign

RATE, SIGMA, SAMPLES = 10_000.0, 1e-3, 4000


def test_a_decay_with_a_free_start_gives_the_law_back() -> None:
    plant = PlantSpec("modal", 1, "velocity", 1, 0)
    model = Model(plant, effects=("hysteresis",))
    values = {"f1_hz": 500.0, "zeta1": 5e-4, "hysteresis.k": 2e4, "hysteresis.r": 1e-4}
    start = np.array([3e-4, 0.5])
    bare = Record("decay", RATE, np.zeros((SAMPLES, 0)), np.zeros((SAMPLES, 1)), "fit", at_rest=False)
    y = forward(model, values, bare, Instrument(sample_rate_hz=RATE), start=start)
    y = y + SIGMA * np.random.default_rng(0).standard_normal(y.shape)
    campaign = Campaign("decay", (replace(bare, sense_v=y),), Instrument(sample_rate_hz=RATE))
    noise = NoiseLevel(np.full(1, SIGMA), "silent", 10_000)
    found = fit_campaign(model, campaign, noise, {**values, "hysteresis.k": 2.4e4})
    assert found.converged
    # Six to nine parameters of a chi2 with an sd of sqrt(2 N) = 89.
    assert abs(found.chi2 - SAMPLES) < 4.0 * np.sqrt(2.0 * SAMPLES)
    assert found.values["hysteresis.k"] == pytest.approx(2e4, rel=0.05)
    assert fit_campaign(Model(plant), campaign, noise, {"f1_hz": 500.0, "zeta1": 5e-4}).chi2 > 10.0 * SAMPLES
