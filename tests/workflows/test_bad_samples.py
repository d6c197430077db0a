"""A spike and stuck samples in a campaign: what the commands say, and that theta stays where it is."""

import dataclasses
import json

import numpy as np
import pytest

from pipeline.experiment.campaign import write_campaign
from tests.pipeline.experiment.checks.planted_faults import healthy
from workflows.cli import call

THETA_DEG = -33.0


@pytest.fixture(scope="module")
def spoilt():
    """The paper's device; a 0.3 V spike and 30 stuck samples at the resonance of its first chirp."""
    campaign = healthy()
    sense = campaign.records[1].sense_v.copy()
    sense[14_000, 0] += 0.3
    sense[13_500:13_530, 1] = sense[13_499, 1]
    record = dataclasses.replace(campaign.records[1], sense_v=sense)
    return dataclasses.replace(campaign, records=(campaign.records[0], record, campaign.records[2]))


def answer_of(capfd, *command):
    code = call([*command, "--json"])
    return code, json.loads(capfd.readouterr().out)


def test_identify_leaves_bad_samples_out_and_lists_them(spoilt, tmp_path, capfd):
    write_campaign(spoilt, tmp_path)
    code, found = answer_of(capfd, "identify", str(tmp_path))
    assert (code, found["status"]) == (0, "ok")
    assert abs(found["theta_deg"] - THETA_DEG) < 4.0 * found["theta_deg_sd"]
    assert [(one["channel"], one["reason"], one["samples"]) for one in found["bad_samples"]] == [
        ("sense1", "spike", 1),
        ("sense2", "stuck", 31),
    ]


def test_compare_leaves_bad_samples_out_and_its_page_lists_them(spoilt, tmp_path, capfd):
    write_campaign(spoilt, tmp_path)
    code, found = answer_of(capfd, "compare", str(tmp_path), "--out", str(tmp_path / "page"))
    assert code == 0
    theta, sd = found["parameters"]["theta_deg"]
    assert abs(theta - THETA_DEG) < 4.0 * sd
    assert found["error"]["fit"] == pytest.approx(1.0, abs=0.02)
    assert [one["reason"] for one in found["bad_samples"]] == ["spike", "stuck"]
    assert found["bad_samples"][1]["time_s"] == pytest.approx([1.3499, 1.353])
    page = (tmp_path / "page" / "compare.html").read_text()
    assert "32 bad samples are left out of every fit (spikes and stuck samples in record-2.parquet)" in page
    assert "1.3499" in page


def test_check_warns_and_a_record_with_too_many_bad_samples_is_refused_by_name(spoilt, tmp_path, capfd):
    write_campaign(spoilt, tmp_path)
    code, found = answer_of(capfd, "check", str(tmp_path))
    (finding,) = [one for one in found["findings"] if one["kind"] == "bad_samples"]
    assert (finding["record"], finding["severity"], code) == ("record-2.parquet", "warning", 0)
    sense = spoilt.records[1].sense_v.copy()
    sense[np.random.default_rng(0).choice(30_000, 900, replace=False), 0] += 0.3
    record = dataclasses.replace(spoilt.records[1], sense_v=sense)
    write_campaign(dataclasses.replace(spoilt, records=(spoilt.records[0], record, spoilt.records[2])), tmp_path / "b")
    _, found = answer_of(capfd, "check", str(tmp_path / "b"))
    assert [one["severity"] for one in found["findings"] if one["kind"] == "bad_samples"] == ["fault"]
    for command in ("identify", "compare"):
        assert call([command, str(tmp_path / "b")]) == 5
        assert "record-2.parquet: too many bad samples" in capfd.readouterr().err
