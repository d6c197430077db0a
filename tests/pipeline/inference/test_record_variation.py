"""Variation between records is found with its size, is exactly zero for equal records, and no longer biases the parameters."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.errors import ConfigError
from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.excitation import drive_samples
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.record import Campaign, Record
from pipeline.experiment.systematic import Systematic
from pipeline.inference.general.fit import fit_campaign
from pipeline.inference.general.variance_components import grams_of, solved
from pipeline.inference.general.variation import record_variation
from pipeline.inference.general.varied_fit import fit_with_variation
from pipeline.learning.campaign import records_differ
from pipeline.learning.campaign.problem import CampaignProblem
from pipeline.learning.campaign.records_differ import prepared, repeats_differ
from workflows.simulate import standard_excitations
from workflows.studies.hidden.draw import INSTRUMENT, draw_device
from workflows.studies.hidden.truth import response

SIGMA_V = 1e-3


def campaign_of(ppm: float, start_s: float, gain: float, seed: int = 1):
    """A campaign with records of 1 s from the independent simulator; its parameters and the deviations of its records."""
    random = np.random.default_rng(seed)
    values = draw_device(random)
    records, deviations = [], {}
    for name, role, excitation in standard_excitations(1):
        drive = drive_samples(replace(excitation, duration_s=1.0), INSTRUMENT.sample_rate_hz)
        y = np.zeros_like(drive)
        if role != "noise":
            phi, tau = 1e-6 * ppm * random.uniform(-1.0, 1.0), start_s * random.uniform(0.0, 1.0)
            g = gain * random.uniform(-1.0, 1.0, 2)
            own = {**values, **{f"f{i}_hz": values[f"f{i}_hz"] * (1.0 + phi) for i in (1, 2, 3)}, "loop_delay.tau": tau}
            y = response(own, drive, INSTRUMENT) * (1.0 + g)
            deviations[name] = np.array([phi, tau, *g])
        y = y + SIGMA_V * random.standard_normal(y.shape)
        records.append(Record(name, INSTRUMENT.sample_rate_hz, drive, y, role=role))
    return Campaign("bench", tuple(records), INSTRUMENT, 0.7, 1.0), values, deviations


def first_fit(campaign):
    return fit_campaign(DEFAULT_COMPARE_MODEL, campaign, noise_level(campaign))


@pytest.mark.parametrize("seed", [1, 2])
def test_equal_records_need_no_variation_at_all(seed):
    campaign, _, _ = campaign_of(0.0, 0.0, 0.0, seed)
    assert record_variation(first_fit(campaign), campaign).spread.is_zero


@pytest.mark.parametrize(("ppm", "start_s", "gain"), [(10.0, 5e-5, 1e-3)])
def test_deviations_are_recovered_and_the_fit_reaches_the_noise(ppm, start_s, gain):
    campaign, values, deviations = campaign_of(ppm, start_s, gain)
    before = first_fit(campaign)
    found = fit_with_variation(before.model, campaign, before)
    assert before.error["fit"] > 1.02
    # Without a common part, which the parameters of the device and a delay take up.
    own = np.array([one.value[:4] for one in found.variation.deviations])
    true = np.array([deviations[one.record] for one in found.variation.deviations])
    error = (own - own.mean(axis=0)) - (true - true.mean(axis=0))
    sd = np.array([one.sd[:4] for one in found.variation.deviations])
    assert np.all(np.abs(error) < 6.0 * sd + 2e-3 * np.array([1e-6 * ppm, max(start_s, 1e-9), gain, gain]))
    assert found.fit.error["fit"] == pytest.approx(1.0, abs=0.02)
    assert found.fit.error["validate"] == pytest.approx(1.0, abs=0.02)
    for name in ("f1_hz", "theta_deg", "zeta1", "zeta2", "rocking_gain"):
        value, sd_ = found.fit.parameters[name]
        assert abs(value - values[name]) < 4.0 * sd_, name
    assert abs(before.theta_deg[0] - values["theta_deg"]) > abs(found.fit.theta_deg[0] - values["theta_deg"])
    # The check of the hold fits the beginning of the records, with the beginning of their common signals.
    short = tuple(replace(r, drive_v=r.drive_v[:4000], sense_v=r.sense_v[:4000]) for r in found.campaign.records)
    part = fit_campaign(
        found.fit.model, replace(campaign, records=short), found.noise.beginning(4000), found.fit.values
    )
    assert part.error["fit"] == pytest.approx(1.0, abs=0.03)


def test_a_declared_temperature_replaces_the_frequency_shifts_that_the_records_would_need(tmp_path):
    campaign, _, deviations = campaign_of(10.0, 0.0, 0.0, seed=3)
    tcf = -20.0
    declared = tuple(
        replace(r, temperature_c=25.0 + (1e6 * deviations[r.name][0] / tcf if r.name in deviations else 0.0))
        for r in campaign.records
    )
    write_campaign(replace(campaign, records=declared, systematic=Systematic(tcf_ppm_per_c=tcf)), tmp_path)
    known = read_campaign(tmp_path)
    fitted = [r for r in known.records if r.role == "fit"]
    assert np.mean([r.frequency_shift for r in fitted]) == pytest.approx(0.0, abs=1e-15)
    differences = [r.frequency_shift - deviations[r.name][0] for r in fitted]
    assert np.ptp(differences) < 1e-12
    plain, told = first_fit(campaign), first_fit(known)
    assert plain.error["fit"] > 1.2
    assert told.error["fit"] == pytest.approx(1.0, abs=0.01)
    assert record_variation(told, known).spread.is_zero


def test_deviations_beside_parameters_that_stay_do_not_absorb_the_step_that_is_not_taken():
    # The column of the deviation is nearly that of the parameter, and only a step of the parameter explains the residual.
    random = np.random.default_rng(3)
    j, c = random.standard_normal((2, 400, 1))
    c = j + 0.1 * c
    g = grams_of([c], [j], [(5.0 * j + c)[:, 0]])
    sd = np.array([1e3])
    assert solved(g, sd).deviations == pytest.approx(np.array([[1.0]]), rel=1e-4)
    alone = solved(g.without_parameters(), sd)
    assert alone.dx.size == 0
    expected = float((c.T @ (5.0 * j + c)).item() / ((c.T @ c).item() + 1e-6))
    assert alone.deviations == pytest.approx(np.array([[expected]]), rel=1e-9)


def test_records_that_cannot_be_corrected_beside_a_wrong_model_stay_as_they_are(monkeypatch):
    campaign, _, _ = campaign_of(5.0, 5e-5, 1e-3)
    problem = CampaignProblem(campaign, DEFAULT_COMPARE_MODEL, noise_level(campaign), 1)
    assert repeats_differ(problem)

    def refused(*args: object) -> None:
        raise ConfigError("parameter f1_hz is not finite", value=float("nan"))

    monkeypatch.setattr(records_differ, "fit_with_variation", refused)
    after = prepared(problem)
    assert after.variation is None
    assert after.fit(()).ok
