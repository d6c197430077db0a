"""The paper's experiment, two chirp records and nothing that measures the noise: a hidden misfit is never called adequate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import as_ladder
from pipeline.criticism.selection import forward_selection
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.gate import Gate
from pipeline.inference.general.fit import fit_campaign
from pipeline.inference.general.goodness import campaign_status
from pipeline.inference.general.resonances import resonance_excess
from pipeline.inference.identify import identify
from pipeline.learning.campaign.answers import campaign_answers
from workflows.studies.hidden.draw import INSTRUMENT, SIGMA_V
from workflows.studies.hidden.restricted import RestrictedProblem
from workflows.studies.hidden.truth import response

DEVICE = {
    "f1_hz": 533.27,
    "f2_hz": 534.41,
    "f3_hz": 588.49,
    "zeta1": 4.21e-4,
    "zeta2": 3.409e-4,
    "zeta3": 2.075e-3,
    "theta_deg": 35.23,
    "c12_per_s": 0.0,
    "rocking_gain": 12.884,
    "updown_gain": 27.69,
    "sense_imbalance": 0.0,
    "drive_imbalance": 0.0,
}
#: SNR 190 once the parameters of the plant are refitted.
HYSTERESIS = {"hysteresis.k": 690.0, "hysteresis.r": 1.1983e-4}


def _campaign(hidden: dict[str, float]) -> Campaign:
    random = np.random.default_rng(7)

    def measured(name: str, chirp: Chirp) -> Record:
        drive: FloatArray = drive_samples(chirp, INSTRUMENT.sample_rate_hz)
        y = response({**DEVICE, **hidden}, drive, INSTRUMENT)
        return Record(name, INSTRUMENT.sample_rate_hz, drive, y + SIGMA_V * random.standard_normal(y.shape), "fit")

    up = Chirp(duration_s=1.5)
    down = replace(up, start_hz=up.stop_hz, stop_hz=up.start_hz)
    return Campaign("A17", (measured("chirp", up), measured("swapped", down)), INSTRUMENT, 0.7, 1.0)


def test_compare_identify_and_refine_agree_that_a_hysteresis_is_a_misfit() -> None:
    campaign = _campaign(HYSTERESIS)
    answers = campaign_answers(campaign, threads=1)
    assert answers.comparison.status == "misfit"
    assert answers.comparison.where_by_kind[0].kind == "resonance"  # type: ignore[index]
    assert identify(campaign).columns["status"] == "misfit"
    rules = Rules(rungs=1, draws=4000)
    without = RestrictedProblem(answers.problem, ("hysteresis",))
    ladder = as_ladder(without, forward_selection(without, (), rules), rules)
    assert ladder.verdict == "unknown"
    assert not any(rung.status == "confirmed" for rung in ladder.rungs)
    # The level is that of the fitted records themselves, so no error is stated in units of it.
    assert answers.comparison.error == {"fit": None, "validate": None}
    assert answers.noise.local_fit


@pytest.mark.parametrize(("hidden", "status"), [({}, "ok"), (HYSTERESIS, "misfit")])
def test_a_misfit_at_the_resonances_is_a_misfit_whatever_the_level_of_the_noise(
    hidden: dict[str, float], status: str
) -> None:
    campaign = _campaign(hidden)
    measured = noise_level(campaign)
    assert measured.source == "local"
    assert np.all(np.abs(measured.sigma_v / SIGMA_V - 1.0) < 0.02)
    known = fit_campaign(DEFAULT_COMPARE_MODEL, campaign, measured)
    bound = replace(measured, sigma_v=3.0 * measured.sigma_v, source="residual")
    unknown = fit_campaign(DEFAULT_COMPARE_MODEL, campaign, bound)
    assert campaign_status(known, campaign)[0] == campaign_status(unknown, campaign)[0] == status
    ratios = [resonance_excess(fit, campaign).ratio for fit in (known, unknown)]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-3)
    assert (ratios[0] > 5.0) == (status == "misfit")
    assert (resonance_excess(known, campaign).p_value < Gate().alpha) == (status == "misfit")
    # With an unknown level the residual scales the sds, so that they do not depend on the bound.
    sd = [fit.parameters["split_hz" if "split_hz" in fit.parameters else "f1_hz"][1] for fit in (known, unknown)]
    if not hidden:
        assert sd[1] == pytest.approx(sd[0], rel=0.02)
