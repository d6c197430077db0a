"""Polarity, order of the channels, lag, hold and filter: faults are found, and once corrected the check is clean."""

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from planted_faults import corrected, healthy, kinds, merged, toml_of, transformed

from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.checks.check import check
from pipeline.experiment.instrument import AntiAlias, Instrument


@pytest.mark.parametrize(
    ("sense", "drive", "correction"),
    [
        ([1, -1], [1, 1], {"sense_polarity": [1, -1]}),
        ([-1, 1], [1, 1], {"sense_polarity": [-1, 1]}),
        ([-1, -1], [1, 1], {"sense_polarity": [-1, -1]}),
        ([1, 1], [1, -1], {"drive_polarity": [1, -1]}),
        ([1, 1], [-1, 1], {"drive_polarity": [-1, 1]}),
    ],
)
def test_an_inverted_channel_is_named_and_its_correction_restores_the_record(sound, tmp_path, sense, drive, correction):
    fault = transformed(sound, sense=lambda y: y * sense, drive=lambda v: v * drive)
    report, again = corrected(fault, tmp_path)
    assert kinds(report) == {"polarity"}
    assert msgspec.toml.decode(report.toml) == {"channels": correction}
    assert check(again).findings == ()
    assert np.array_equal(again.records[1].sense_v, sound.records[1].sense_v)


def test_either_correction_of_an_inverted_sense_and_drive_gives_the_same_device(sound, tmp_path):
    # Inverting S1 and D2 is the same experiment as inverting S2 and D1, so either correction gives a sound device.
    report, again = corrected(transformed(sound, sense=lambda y: y * [-1, 1], drive=lambda v: v * [1, -1]), tmp_path)
    assert kinds(report) == {"polarity"}
    assert check(again).findings == ()


@pytest.mark.parametrize("which", ["sense", "drive"])
def test_a_swap_names_both_possible_corrections(sound, tmp_path, which):
    report, again = corrected(transformed(sound, **{which: lambda x: x[:, ::-1]}), tmp_path)
    assert kinds(report) == {"swap"}
    text = report.of_kind("swap")[0].text
    assert "sense_order = [2, 1]" in text
    assert "drive_order = [2, 1]" in text
    assert check(again).findings == ()


def test_swapping_both_senses_and_drives_is_invisible(sound):
    assert check(transformed(sound, sense=lambda y: y[:, ::-1], drive=lambda v: v[:, ::-1])).findings == ()


@pytest.mark.parametrize("lag", [1, 3, 9, 40, -2, -17])
def test_a_lag_of_whole_samples_is_measured_and_corrected(sound, tmp_path, lag):
    # The record starts before the drive and ends after it, so that a shift loses nothing.
    def late(y):
        return np.concatenate([np.zeros((max(lag, 0), 2)), y, np.zeros((max(-lag, 0), 2))])[max(-lag, 0) :][: len(y)]

    report, again = corrected(transformed(sound, sense=late), tmp_path)
    (found,) = report.of_kind("lag")
    assert abs(found.value - lag) < 0.1
    assert msgspec.toml.decode(report.toml) == {"channels": {"lag_samples": lag}}
    assert kinds(check(again)) == set()


def test_polarity_swap_and_lag_are_separated_when_they_occur_together(sound, tmp_path):
    def sense(y):
        return np.concatenate([np.zeros((5, 2)), y[:-5]])[:, ::-1] * [1, -1]

    report, again = corrected(transformed(sound, sense=sense), tmp_path)
    assert kinds(report) == {"polarity", "swap", "lag"}
    assert check(again).findings == ()
    assert np.array_equal(again.records[1].sense_v, sound.records[1].sense_v[:-5])


def test_a_correction_of_a_wrong_correction_is_written_as_one(sound, tmp_path):
    write_campaign(transformed(sound, sense=lambda y: y[:, ::-1] * [1, -1]), tmp_path)
    path = tmp_path / "campaign.toml"
    text = path.read_text()
    # Wrong on purpose: the true correction is polarity [1, -1], order [2, 1], lag 0.
    wrong = {"sense_polarity": [-1, -1], "sense_order": [1, 2], "lag_samples": 4}
    path.write_text(toml_of({**msgspec.toml.decode(text), "channels": wrong}))
    report = check(read_campaign(tmp_path))
    path.write_text(toml_of(merged(path.read_text(), report.toml)))
    again = read_campaign(tmp_path)
    assert check(again).findings == ()
    assert np.array_equal(again.records[1].sense_v, sound.records[1].sense_v)


@pytest.mark.parametrize(("declared", "true"), [("zoh", "foh"), ("foh", "zoh")])
def test_a_wrong_hold_is_found_as_half_a_sample_and_corrected(tmp_path, declared, true):
    campaign = healthy(hold=true)
    campaign = dataclasses.replace(campaign, instrument=Instrument(hold=declared, antialias=AntiAlias()))
    report, again = corrected(campaign, tmp_path)
    (found,) = report.of_kind("hold")
    assert found.value == (-0.5 if declared == "zoh" else 0.5)
    assert again.instrument.hold == true
    assert kinds(check(again)) == set()


def test_an_undeclared_filter_is_reported_as_a_lag_without_a_correction():
    report = check(dataclasses.replace(healthy(), instrument=Instrument()))
    # 8th-order Butterworth: delay sum 1/(2 sin) / w_c = 5.126 / (2 pi 4800 Hz) = 1.70 samples.
    (left,) = [f for f in report.of_kind("lag") if f.severity == "warning"]
    (whole,) = [f for f in report.of_kind("lag") if f.severity == "fault"]
    assert abs(whole.value - 1.70) < 0.02
    assert "antialias" in left.text
    assert left.toml == ""


def test_the_report_is_json_with_the_documented_keys(sound):
    report = check(transformed(sound, sense=lambda y: y * [1, -1]))
    tree = json.loads(json.dumps(report.to_dict()))
    assert tree["ok"] is False
    assert tree["toml"] == "[channels]\nsense_polarity = [1, -1]\n"
    keys = {"kind", "severity", "text", "record", "channel", "value", "sd", "unit", "toml"}
    assert tree["findings"][0].keys() == keys
    assert tree["findings"][0]["kind"] == "polarity"
    assert {level["channel"] for level in tree["levels"]} == {"sense1", "sense2"}
