"""In-band identification of a campaign, with and without a silent record."""

from dataclasses import replace

import numpy as np

from pipeline.experiment.record import Campaign, Record
from pipeline.inference.estimate import reference_comparison
from pipeline.inference.gate import Gate
from pipeline.inference.screening.campaign import identify_campaign
from pipeline.inference.screening.device import IdentificationSettings
from pipeline.inference.screening.sample import SamplerSettings


def campaign_of(bench, device, silent):
    y, sigma = bench.record(device, seed=31)
    quiet = np.random.default_rng(5).normal(size=(10_000, 2)) * sigma
    records = [Record("chirp", 10_000.0, bench.drive, y, role="fit")]
    if silent:
        records.insert(0, Record("silence", 10_000.0, np.zeros_like(quiet), quiet, role="noise"))
    return Campaign("C1", tuple(records), bench.instrument, 0.7, 1.0, reference={"f1_hz": (534.6, 0.1)})


def identify(campaign):
    return identify_campaign(campaign, IdentificationSettings(), SamplerSettings(), Gate(), np.random.SeedSequence(2))


def test_without_a_silent_record_the_estimates_agree_and_the_error_is_null(bench, paper_device):
    with_silence, without = (identify(campaign_of(bench, paper_device, s)) for s in (True, False))
    assert with_silence.columns["error"] is not None
    assert without.columns["error"] is None
    sd = with_silence.columns["theta_deg_sd"]
    assert abs(without.columns["theta_deg"] - with_silence.columns["theta_deg"]) < sd
    assert abs(without.columns["theta_deg_sd"] / sd - 1.0) < 0.5


def test_reference_values_are_compared_in_units_of_both_uncertainties(bench, paper_device):
    campaign = campaign_of(bench, paper_device, True)
    z = reference_comparison(campaign.reference, identify(campaign).columns)["f1_hz"]["z"]
    assert abs(z + 1.0) < 0.01
    off = replace(campaign, reference={"theta_deg": (paper_device[6] + 180.0, 0.1)})
    assert abs(reference_comparison(off.reference, identify(off).columns)["theta_deg"]["z"]) < 0.1
