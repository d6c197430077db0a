"""Ring-downs of a device whose force law has coordinates of its own: a memory, or a hidden mode that no sense sees."""

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


@pytest.mark.parametrize(
    ("effect", "own", "moved"),
    [
        ("hysteresis", {"k": 2e4, "r": 1e-4}, "k"),
        ("internal_resonance_1_2", {"c^2": 3e16, "delta": 0.002, "zeta": 3e-3}, "c^2"),
    ],
)
def test_a_decay_with_a_free_start_gives_the_law_back(effect: str, own: dict[str, float], moved: str) -> None:
    plant = PlantSpec("modal", 1, "velocity", 1, 0)
    model = Model(plant, effects=(effect,))
    values = {"f1_hz": 500.0, "zeta1": 5e-4, **{f"{effect}.{name}": value for name, value in own.items()}}
    coordinates = 2 if effect.startswith("internal") else 1
    start = np.zeros(2 * coordinates)
    start[0], start[coordinates] = 3e-4, 0.5
    bare = Record("decay", RATE, np.zeros((SAMPLES, 0)), np.zeros((SAMPLES, 1)), "fit", at_rest=False)
    y = forward(model, values, bare, Instrument(sample_rate_hz=RATE), start=start)
    y = y + SIGMA * np.random.default_rng(0).standard_normal(y.shape)
    campaign = Campaign("decay", (replace(bare, sense_v=y),), Instrument(sample_rate_hz=RATE))
    noise = NoiseLevel(np.full(1, SIGMA), "silent", 10_000)
    found = fit_campaign(model, campaign, noise, {**values, f"{effect}.{moved}": 1.2 * own[moved]})
    assert found.converged
    # Six to nine parameters of a chi2 with an sd of sqrt(2 N) = 89.
    assert abs(found.chi2 - SAMPLES) < 4.0 * np.sqrt(2.0 * SAMPLES)
    assert found.values[f"{effect}.{moved}"] == pytest.approx(own[moved], rel=0.05)
    assert fit_campaign(Model(plant), campaign, noise, {"f1_hz": 500.0, "zeta1": 5e-4}).chi2 > 10.0 * SAMPLES
