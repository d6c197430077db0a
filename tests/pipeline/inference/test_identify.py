"""One entry point for every plant; the in-band path and the general fit give a campaign the same status."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.device.gyro import PHYSICAL
from pipeline.device.model import SCREENING_MODEL, Model, PlantSpec
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Record
from pipeline.experiment.systematic import Systematic
from pipeline.inference.gate import Gate
from pipeline.inference.identify import identify
from pipeline.inference.screening.mismatch import NIGHTLY_MODEL

RATE, SIGMA_V = 10_000.0, 1e-3
INSTRUMENT = Instrument(antialias=AntiAlias())
PAPER = dict(zip(PHYSICAL, [534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.3, 13.33, 28.6, 0.0386, 0.0007]))


def campaign_of(model, values, drive, silent=True):
    random = np.random.default_rng(1)
    channels = model.with_channels(drive.shape[1], drive.shape[1])
    bare = Record("chirp", RATE, drive, np.zeros_like(drive), role="fit")
    volts = forward(channels, values, bare, INSTRUMENT)
    records = [replace(bare, sense_v=volts + SIGMA_V * random.standard_normal(volts.shape))]
    if silent:
        noise = SIGMA_V * random.standard_normal(drive.shape)
        records.append(Record("silence", RATE, np.zeros_like(drive), noise, role="noise"))
    return Campaign("C1", tuple(records), INSTRUMENT, 0.7, 1.0)


@pytest.mark.parametrize(
    ("split_hz", "delay_s", "status", "refused_for"),
    [(0.05, 0.0, "ok", None), (0.05, 1e-7, "misfit", "bias theta"), (1.9, 2e-6, "misfit", "error")],
)
def test_both_paths_give_the_same_status_for_the_same_reason(split_hz, delay_s, status, refused_for):
    values = {**PAPER, "f2_hz": PAPER["f1_hz"] + split_hz, "loop_delay.tau": delay_s}
    campaign = campaign_of(SCREENING_MODEL.with_effect("loop_delay"), values, drive_samples(Chirp(), RATE))
    in_band, general = identify(campaign).columns, identify(campaign, NIGHTLY_MODEL).columns
    assert "theta_u1_deg" in in_band
    assert "theta_u1_deg" not in general
    for columns in (in_band, general):
        assert columns["status"] == status
        assert (columns["error"] > Gate().error_max) == (refused_for == "error")
    if refused_for is not None:
        # The in-band path scores the library, so it names the effect whose size the other path can only bound.
        assert "effect loop_delay is significant" in in_band["status_reason"]
        assert refused_for in general["status_reason"]


def test_a_tilt_of_the_up_down_mode_leaves_theta_right_on_both_paths():
    values = {**PAPER, "updown_tilt.t_x": 2e-2, "electrode_mismatch.m_S": 3e-3}
    model = SCREENING_MODEL.with_effect("updown_tilt").with_effect("electrode_mismatch")
    campaign = campaign_of(model, values, drive_samples(Chirp(), RATE))
    in_band, general = identify(campaign).columns, identify(campaign, NIGHTLY_MODEL).columns
    for columns in (in_band, general):
        assert columns["status"] == "ok"
        assert abs(columns["theta_deg"] - PAPER["theta_deg"]) < 4.5 * columns["theta_deg_sd"]
    # Both effects act as one mismatch: m_S + t and m_D + t.
    assert abs(in_band["sense_mismatch"] - 2.3e-2) < 1e-4
    assert abs(in_band["drive_mismatch"] - 2.0e-2) < 1e-4
    # Without the mismatches the same campaign is a misfit, and theta is wrong by 150 sd.
    assert identify(campaign, SCREENING_MODEL).columns["status"] == "misfit"


def test_a_campaign_of_one_drive_and_one_sense_is_identified_as_one_mode():
    values = {"f1_hz": 534.5, "zeta1": 1e-3, "gain1_s1d1": 20.0}
    plant = PlantSpec("modal", 1, "velocity")
    drive = drive_samples(Chirp((400.0,), (700.0,), (1.0,), 1.0), RATE)
    campaign = campaign_of(Model(plant), values, drive)
    campaign = replace(campaign, reference={"f1_hz": (534.5, 0.1)})
    found = identify(campaign)
    assert found.columns["status"] == "ok"
    assert found.columns["model"] == Model(plant).with_channels(1, 1).to_toml().splitlines()[0]
    for name, truth in values.items():
        assert abs(found.columns[name] - truth) < 4.5 * found.columns[f"{name}_sd"]
    assert abs(found.reference["f1_hz"]["z"]) < 0.1


def test_a_record_without_a_role_is_fitted_and_without_silence_its_error_is_null():
    values = {**PAPER, "f2_hz": PAPER["f1_hz"] + 1.9}
    campaign = campaign_of(SCREENING_MODEL, values, drive_samples(Chirp(), RATE), silent=False)
    campaign = replace(campaign, records=tuple(replace(r, role=None) for r in campaign.records))
    for model in (None, SCREENING_MODEL):
        columns = identify(campaign, model).columns
        assert columns["status"] == "ok"
        assert columns["error"] is None
        assert abs(columns["theta_deg"] - PAPER["theta_deg"]) < 4.5 * columns["theta_deg_sd"]


def test_both_paths_add_the_common_errors_that_the_campaign_declares():
    bare = campaign_of(SCREENING_MODEL, PAPER, drive_samples(Chirp(), RATE))
    tester = Systematic(phase_error_sd_deg=0.5, gain_sd=0.01, clock_sd_ppm=10.0, temperature_sd_c=1.0)
    with_tester = replace(bare, systematic=tester)
    before, in_band, general = (
        identify(bare).columns,
        identify(with_tester).columns,
        identify(with_tester, SCREENING_MODEL).columns,
    )
    frequency = PAPER["f1_hz"] * 1e-6 * np.hypot(10.0, 28.0)
    assert before["f1_hz_sd"] < 0.1 * frequency
    for after in (in_band, general):
        assert after["f1_hz_sd"] == pytest.approx(frequency, rel=0.03)
        assert after["rocking_gain_sd"] == pytest.approx(0.01 * PAPER["rocking_gain"], rel=0.03)
    assert in_band["theta_deg_sd"] == pytest.approx(before["theta_deg_sd"], rel=1e-9)
    assert (in_band["status"], in_band["error"]) == (before["status"], before["error"])
    leaked = abs(in_band["quadrature_rate_dps"]) * np.deg2rad(0.5)
    assert in_band["rate_bias_dps_sd"] == pytest.approx(leaked, rel=0.03)
