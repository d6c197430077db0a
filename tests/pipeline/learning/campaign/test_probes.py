"""Generic shapes hold the direction of an effect that nobody offers, in few degrees of freedom."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.noise.level import NoiseLevel
from pipeline.experiment.record import Campaign, Record
from pipeline.learning.campaign.problem import CampaignProblem
from workflows.studies.hidden.draw import INSTRUMENT, SIGMA_V
from workflows.studies.hidden.truth import response

DEVICE = {
    "f1_hz": 533.27,
    "f2_hz": 534.41,
    "f3_hz": 588.49,
    "zeta1": 8.21e-4,
    "zeta2": 7.409e-4,
    "zeta3": 2.075e-3,
    "theta_deg": 35.23,
    "c12_per_s": 0.0,
    "rocking_gain": 12.884,
    "updown_gain": 27.69,
    "sense_imbalance": 0.02,
    "drive_imbalance": -0.01,
}
EFFECTS = {
    "quadratic_stiffness": "elastic force of third order",
    "cubic_stiffness": "elastic force of fourth order",
    "nonlinear_damping": "damping that follows the amplitude",
    "angular_rate": "viscous coupling",
    "levitation_force": "force of the squared drive",
    "frequency_drift": "slow change",
    "sense_nonlinearity": "pick-off with a gap that changes",
    "resistive_feedthrough": "drive in the read-out",
}


@cache
def problem() -> CampaignProblem:
    random, records = np.random.default_rng(5), []
    for number, level_v in enumerate((2.0, 0.7)):
        drive: FloatArray = drive_samples(
            Chirp(amplitude_v=(level_v, level_v), duration_s=0.8), INSTRUMENT.sample_rate_hz
        )
        y = response(DEVICE, drive, INSTRUMENT)
        noisy = y + SIGMA_V * random.standard_normal(y.shape)
        records.append(Record(f"chirp {number}", INSTRUMENT.sample_rate_hz, drive, noisy, "fit"))
    campaign = Campaign("A17", tuple(records), INSTRUMENT, 0.7, 1.0)
    return CampaignProblem(campaign, DEFAULT_COMPARE_MODEL, NoiseLevel(np.full(2, SIGMA_V), "silent", 100_000))


@pytest.mark.parametrize("effect", EFFECTS)
def test_a_family_holds_the_signature_of_an_effect(effect: str) -> None:
    fit = problem().fit(())
    known, probes = problem().signatures(fit), problem().probes(fit)
    hidden = next(c for c in known.candidates if c.name == effect)
    family = next(c for c in probes.candidates if c.name == EFFECTS[effect])
    columns, shapes = np.concatenate(known.blocks), np.concatenate(probes.blocks)
    z = np.concatenate([columns[:, cell] for cell in hidden.cells], axis=1)
    own = shapes[:, family.cells[0]]
    basis, _ = np.linalg.qr(own / np.linalg.norm(own, axis=0))
    left = np.linalg.norm(z - basis @ (basis.T @ z), axis=0) / np.linalg.norm(z, axis=0)
    assert left.max() < 0.1


def test_shapes_are_computed_again_only_after_the_records_have_moved() -> None:
    fit = problem().fit(())
    assert problem().probes(fit) is problem().probes(fit)
    assert all(block.shape[1] == problem().probes(fit).blocks[0].shape[1] for block in problem().probes(fit).blocks)
