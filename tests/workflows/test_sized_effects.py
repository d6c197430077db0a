"""An effect that is named without sizes gets sizes with the documented SNR."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record
from workflows.simulate import sized

PLANT = {
    "f1_hz": 530.8,
    "f2_hz": 531.8,
    "f3_hz": 585.7,
    "zeta1": 2.9e-4,
    "zeta2": 2.8e-4,
    "zeta3": 1.3e-3,
    "theta_deg": 7.1,
    "rocking_gain": 13.1,
    "updown_gain": 28.2,
    "sense_imbalance": -0.002,
    "drive_imbalance": -0.001,
}


@pytest.mark.parametrize("effect", ["cubic_stiffness", "electrostatic_softening", "pickoff_crosstalk"])
def test_sized_gives_an_snr_of_300_within_5_percent(effect: str) -> None:
    instrument, drive = Instrument(antialias=AntiAlias()), drive_samples(Chirp(), 10_000.0)
    chirp = Record("chirp", 10_000.0, drive, np.zeros_like(drive))
    model = DEFAULT_COMPARE_MODEL.with_effect(effect)
    quiet = forward(DEFAULT_COMPARE_MODEL, PLANT, chirp, instrument)
    base = dict(model.complete(PLANT))
    for seed in range(3):
        size = sized(model, base, effect, chirp, instrument, 1e-3, np.random.default_rng(seed))
        moved = np.linalg.norm(forward(model, {**base, **size}, chirp, instrument) - quiet) / 1e-3
        assert moved == pytest.approx(300.0, rel=0.05)
