"""Noise of the driven records that is louder than that of the silence: identify, compare and refine agree about it."""

import dataclasses
import json

import numpy as np

from pipeline.experiment.campaign import write_campaign
from tests.pipeline.experiment.checks.planted_faults import healthy
from workflows.cli import call


def test_noise_louder_than_the_silence_is_no_missing_effect(tmp_path, capfd):
    random = np.random.default_rng(4)
    campaign = healthy()
    sigma = float(np.std(campaign.with_role("noise")[0].sense_v))
    records = tuple(
        record
        if record.role == "noise"
        else dataclasses.replace(record, sense_v=record.sense_v + sigma * random.standard_normal(record.sense_v.shape))
        for record in campaign.records
    )
    write_campaign(dataclasses.replace(campaign, records=records), tmp_path)

    def answer(command):
        call([command, str(tmp_path), "--json"])
        return json.loads(capfd.readouterr().out)

    identified, compared, refined = (answer(command) for command in ("identify", "compare", "refine"))
    assert refined["verdict"] == "adequate"
    assert refined["noise_louder"] > 1.1
    # The sds rest on the noise of the silence, so the gate refuses the device; the reason leaves the cause to refine.
    for one in (identified, compared):
        assert one["status"] == "misfit"
        assert one["status_reason"].startswith("error 1.")
        assert "refine, which tells noise that is louder than measured from a missing effect" in one["status_reason"]
    assert identified["effect_p_value"] > 1e-3
