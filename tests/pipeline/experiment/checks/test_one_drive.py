"""Lag and hold of a device with one drive and one sense."""

import dataclasses
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from planted_faults import kinds
from scipy import signal

from pipeline.experiment.campaign import read_campaign
from pipeline.experiment.checks.check import check
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Campaign, Record

SILVERBOX = Path(__file__).resolve().parents[5] / "shared" / "data" / "silverbox" / "SNLS80mV.mat"


def oscillator(lag=0, hold="foh", velocity=False):
    """One drive, one sense: 70 Hz, Q = 10, multisine to 200 Hz at 610 Hz, displacement or velocity."""
    random = np.random.default_rng(3)
    spectrum = np.zeros(4097, dtype=complex)
    spectrum[1:2600] = np.exp(2j * np.pi * random.random(2599))
    drive = np.tile(np.fft.irfft(spectrum), 6)[:, None]
    drive /= drive.std()
    w, zeta = 2 * np.pi * 70.0 / 610.0, 0.05
    A, B, C = [[0, 1], [-(w**2), -2 * zeta * w]], [[0], [w**2]], [[0, 1 / w] if velocity else [1, 0]]
    system = tuple(np.array(part, dtype=float) for part in (A, B, C, [[0]]))
    discrete = signal.cont2discrete(system, 1.0, hold)
    _, y, _ = signal.dlsim((*discrete[:4], 1.0), drive)
    y = np.roll(y, lag, axis=0) + 1e-3 * random.standard_normal(y.shape)
    record = Record("r.csv", 610.0, drive, y, role="fit")
    return Campaign("osc", (record,), Instrument(sample_rate_hz=610.0, hold=hold))


@pytest.mark.parametrize("velocity", [False, True])
@pytest.mark.parametrize("lag", [0, 4])
def test_the_lag_of_a_device_with_one_drive_is_measured(lag, velocity):
    report = check(oscillator(lag, velocity=velocity))
    found = report.of_kind("lag")
    assert [round(f.value) for f in found] == ([lag] if lag else [])


def test_a_wrong_hold_of_a_device_with_one_drive_is_found():
    campaign = oscillator(hold="foh")
    wrong = dataclasses.replace(campaign, instrument=dataclasses.replace(campaign.instrument, hold="zoh"))
    assert kinds(check(campaign)) == set()
    assert msgspec.toml.decode(check(wrong).toml) == {"instrument": {"hold": "foh"}}


def test_a_phase_that_another_mode_turns_is_no_lag_where_records_disagree():
    """Two sweeps over a device of three modes; in one band the phase of a sense turns as with a lag of many samples."""
    random, rate = np.random.default_rng(8), 400.0
    t = np.arange(18000) / rate
    records = []
    for name, (low, high) in {"low": (2.0, 8.5), "high": (8.5, 15.0)}.items():
        drive = np.sin(2 * np.pi * (low + (high - low) * t / t[-1] / 2) * t)
        sense = np.zeros(t.size)
        for f, zeta, gain in ((5.2, 0.013, -0.7), (7.3, 0.01, 0.3), (9.1, 0.02, 0.9)):
            w = 2 * np.pi * f
            sense += signal.lsim(([gain, 0.0, 0.0], [1.0, 2 * zeta * w, w * w]), drive, t)[1]
        sense += 0.01 * sense.std() * random.standard_normal(t.size)
        records.append(Record(f"{name}.csv", rate, drive[:, None], sense[:, None], role="fit"))
    report = check(Campaign("arm", tuple(records), Instrument(sample_rate_hz=rate, hold="foh")))
    assert report.of_kind("lag") == ()
    assert "several modes" in report.of_kind("undecided")[0].text


@pytest.mark.silverbox
@pytest.mark.skipif(not SILVERBOX.exists(), reason="the measured record is not beside the project")
def test_silverbox_was_not_driven_through_a_zero_order_hold(tmp_path):
    text = f"""
[instrument]
sample_rate_hz = 610.35
[columns]
drive1_V = "V1"
sense1_V = "V2"
[[record]]
file = {json.dumps(str(SILVERBOX))}
start = 40650
stop = 105712
at_rest = false
"""
    (tmp_path / "campaign.toml").write_text(text)
    report = check(read_campaign(tmp_path))
    assert msgspec.toml.decode(report.toml) == {"instrument": {"hold": "foh"}}
