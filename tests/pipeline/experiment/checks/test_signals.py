"""Offsets, motion at the start, roles, hum, clipping, resolution, dead channels; sound records raise no finding."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from planted_faults import FS, campaign_of, chirps, corrected, healthy, kinds, noise, sensed, transformed

from pipeline.experiment.checks.check import check
from pipeline.experiment.checks.flat import flat_extreme
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument


@pytest.mark.parametrize("device", [{"theta_deg": 0.0}, {"theta_deg": 45.0}, {"theta_deg": 72.0, "split_hz": 0.05}])
def test_a_sound_campaign_has_no_findings(device):
    report = check(healthy(seed=7, **device))
    assert report.findings == ()
    assert report.ok
    assert report.toml == ""


def test_a_bias_in_the_drive_columns_is_found_and_corrected(sound, tmp_path):
    report, again = corrected(transformed(sound, drive=lambda v: v + np.array([5.0, 4.8])), tmp_path)
    assert kinds(report) == {"drive_offset"}
    assert np.allclose(again.records[1].drive_v, sound.records[1].drive_v, atol=2e-3)
    assert check(again).ok


def test_motion_at_the_first_sample_is_found_and_corrected(sound, tmp_path):
    moving = sensed(chirps(), start=[3.0, 0.0, 0.0, 0.0, 0.0, 0.0]) + noise(30_000, 5)
    records = (sound.records[0], dataclasses.replace(sound.records[1], sense_v=moving), sound.records[2])
    report, again = corrected(dataclasses.replace(sound, records=records), tmp_path)
    assert [f.record for f in report.of_kind("rest")] == ["record-2.parquet"]
    assert [record.at_rest for record in again.records] == [True, False, True]
    assert check(again).findings == ()


def test_roles_that_contradict_the_drives_are_corrected(sound, tmp_path):
    roles = ("fit", "noise", "validate")
    records = tuple(dataclasses.replace(r, role=role) for r, role in zip(sound.records, roles))
    report, again = corrected(dataclasses.replace(sound, records=records), tmp_path)
    assert kinds(report) == {"silence"}
    assert [record.role for record in again.records] == ["noise", "fit", "validate"]
    assert check(again).findings == ()


def test_a_silent_record_that_still_rings_is_a_fault(sound):
    ringing = sensed(np.zeros((10_000, 2)), start=[0.5, 0.0, 0.0, 0.0, 0.0, 0.0]) + noise(10_000, 3)
    records = (dataclasses.replace(sound.records[0], sense_v=ringing), *sound.records[1:])
    assert "silence" in kinds(check(dataclasses.replace(sound, records=records)))


@pytest.mark.parametrize("mains", [50.0, 60.0])
def test_hum_is_found_with_its_mains_frequency_and_amplitude(sound, mains):
    def hum(y):
        t = np.arange(len(y))[:, None] / FS
        return y + [0.4e-3, 0.0] * np.cos(2 * np.pi * mains * t) + [0.0, 0.2e-3] * np.sin(2 * np.pi * 5 * mains * t)

    found = check(transformed(sound, sense=hum)).of_kind("hum")
    assert {f.channel for f in found} == {"sense1", "sense2"}
    assert all(f"{mains:g} Hz mains" in f.text for f in found)
    for finding, size in zip(found, (0.4e-3, 0.2e-3)):
        assert abs(finding.value - size) < 5.0 * finding.sd


def test_an_offset_is_reported_with_its_sd_and_is_no_fault(sound):
    report = check(transformed(sound, sense=lambda y: y + np.array([0.25, 0.0])))
    (silent,) = [f for f in report.of_kind("offset") if f.record == "record-1.parquet"]
    assert abs(silent.value - 0.25) < 5.0 * silent.sd
    assert {f.channel for f in report.findings} == {"sense1"}
    assert report.ok


@pytest.mark.parametrize("sigma", [0.0, 1e-3])
def test_clipping_is_found_at_its_level(sound, sigma):
    level = 0.7 * np.max(np.abs(sound.records[1].sense_v[:, 0]))
    # Noise is added after clipping, except for sigma = 0.
    fault = transformed(sound, sense=lambda y: np.clip(y, -level, level) + noise(len(y), 8, sigma))
    found = check(fault).of_kind("clipping")
    assert {f.record for f in found} >= {"record-2.parquet"}
    assert all(abs(abs(f.value) - level) < 0.01 * level for f in found)


def test_smooth_tops_are_not_clipping():
    # A slow sine has long, smooth tops, which the steps of the ADC make flat over many samples.
    t = np.arange(20_000) / FS
    y = np.round(np.stack([np.sin(2 * np.pi * 20.0 * t), np.cos(2 * np.pi * 55.0 * t)], axis=1) / 1e-3) * 1e-3
    campaign = campaign_of((chirps(20_000), y), roles=("fit",))
    assert check(campaign).of_kind("clipping") == ()


def test_samples_at_one_extreme_are_clipping_at_any_level_and_smooth_or_held_signals_are_not():
    random, t = np.random.default_rng(4), np.arange(4000)
    found = []
    for _ in range(40):
        tones = sum(
            np.sin(2 * np.pi * f * t + a) for f, a in zip(random.uniform(2e-3, 0.05, 5), random.uniform(0, 7, 5))
        )
        scale = 10.0 ** random.uniform(1.5, 4.5)  # from 30 to 30,000 steps
        smooth = np.round(scale * tones / np.abs(tones).max() + 0.5 * random.standard_normal(t.size))
        level = np.round(scale * random.uniform(0.3, 0.8))
        flat = flat_extreme(np.clip(smooth, -level, level), 1.0)
        found.append(flat is not None and abs(flat.level) == level)
        sine = np.round(scale * np.sin(2 * np.pi * t / 10.0 ** random.uniform(0.5, 3.0)))
        for sound in (smooth, sine, np.repeat(sine, 5)[: t.size], np.sign(sine)):
            assert flat_extreme(sound, 1.0) is None
    assert np.mean(found) > 0.9
    # The motor command of a measured loop, clipped at 200 counts in 14 samples of 2000.
    file = Path(__file__).resolve().parents[5] / "shared" / "data" / "measured" / "ruler-swept-1.txt"
    if file.exists():
        flat = flat_extreme(np.loadtxt(file, skiprows=1)[:, 3], 1.0)
        assert flat is not None
        assert flat.level == 200.0


@pytest.mark.parametrize("declared", [None, Adc(12, 10.0), Adc(14, 10.0)])
def test_the_lsb_is_read_from_the_data(tmp_path, declared):
    true = Adc(14, 5.0)
    campaign = transformed(healthy(), sense=lambda y: np.round(y / true.lsb_v) * true.lsb_v)
    instrument = Instrument(antialias=AntiAlias(), adc=declared)
    report, again = corrected(dataclasses.replace(campaign, instrument=instrument), tmp_path)
    (found,) = report.of_kind("converter")
    assert found.value == pytest.approx(true.lsb_v, rel=1e-6)
    assert again.instrument.adc.lsb_v == pytest.approx(true.lsb_v, rel=1e-6)
    assert check(again).findings == ()
    assert check(dataclasses.replace(campaign, instrument=Instrument(antialias=AntiAlias(), adc=true))).findings == ()


def test_dead_senses_and_drives_without_effect_are_named(sound):
    only_noise = transformed(sound, sense=lambda y: np.stack([y[:, 0], noise(len(y), 4)[:, 1]], axis=1))
    assert [f.channel for f in check(only_noise).of_kind("dead")] == ["sense2", "sense2"]
    constant = transformed(sound, sense=lambda y: y * [1.0, 0.0])
    assert {f.channel for f in check(constant).of_kind("dead")} == {"sense2"}

    drive = chirps()
    quiet = campaign_of((drive, sensed(drive * [1.0, 0.0]) + noise(30_000, 1)), roles=("fit",))
    (found,) = check(quiet).of_kind("drive")
    assert found.channel == "drive2"
    never = campaign_of((drive * [0.0, 1.0], sensed(drive * [0.0, 1.0]) + noise(30_000, 1)), roles=("fit",))
    assert [(f.channel, f.value) for f in check(never).of_kind("drive")] == [("drive1", 0.0)]
    same = campaign_of((drive[:, [0, 0]], sensed(drive[:, [0, 0]]) + noise(30_000, 1)), roles=("fit",))
    assert [(f.severity, f.channel) for f in check(same).of_kind("drive")] == [("fault", None)]


def test_a_record_shorter_than_the_decay_is_reported():
    drive = chirps(5_000)
    report = check(campaign_of((drive, sensed(drive) + noise(5_000, 1)), roles=("fit",)))
    assert "short" in kinds(report)


def test_nothing_is_concluded_from_records_without_modes(sound):
    # White noise has no modes, so polarity and lag must stay open.
    random = np.random.default_rng(0)
    report = check(transformed(sound, sense=lambda y: random.standard_normal(y.shape)))
    assert "undecided" in {f.kind for f in report.findings}
    assert {f.kind for f in report.findings} & {"polarity", "swap", "lag", "hold", "rest"} == set()


def test_random_sound_devices_raise_no_false_alarm():
    random = np.random.default_rng(11)
    alarms = 0
    for k in range(6):
        theta, split, sigma = random.uniform(-90, 90), 10 ** random.uniform(-1.3, 0.7), 10 ** random.uniform(-4, -1)
        drive = chirps()
        sense = sensed(drive, theta_deg=theta, split_hz=split) + noise(30_000, 100 + k, sigma)
        alarms += bool(kinds(check(campaign_of((drive, sense), roles=("fit",)))))
    assert alarms == 0
