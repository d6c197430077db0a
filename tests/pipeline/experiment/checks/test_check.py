"""Faults are planted into records of a device that shares no code with the project; once corrected, each check is clean.

The plant is the paper's, as a state space with its filters, discretised by scipy.
"""

import dataclasses
import functools
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy import signal
from threadpoolctl import threadpool_limits

from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.checks.check import CheckReport, check
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Record

FS = 10_000.0
MS = np.array([[-1.0, -1.0], [1.0, -1.0]])
MD = np.array([[-1.0, 1.0], [1.0, 1.0]])
SILVERBOX = Path(__file__).resolve().parents[5] / "shared" / "data" / "silverbox" / "SNLS80mV.mat"


def paper_device(theta_deg, split_hz=1.9, filtered=True):
    """State space in units of one sample: time in samples, so that its matrices are well scaled."""
    c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    rotation = np.array([[c, -s], [s, c]])
    gains_s, gains_d = np.diag([0.964, 1.036]), np.diag([0.999, 1.001])
    B = np.vstack([13.3 * rotation.T @ MD @ gains_d, 28.5 * np.ones((1, 2)) @ gains_d]) / FS
    C = np.hstack([gains_s @ MS @ rotation, gains_s @ np.ones((2, 1))])
    w = 2.0 * np.pi * np.array([534.5, 534.5 + split_hz, 590.3]) / FS
    zeta = np.array([3.167e-4, 1.586e-4, 1.17e-3])
    A = np.zeros((6, 6))
    A[0::2, 1::2], A[1::2, 0::2], A[1::2, 1::2] = np.eye(3), np.diag(-(w**2)), np.diag(-2.0 * zeta * w)
    inputs, outputs = np.zeros((6, 2)), np.zeros((2, 6))
    inputs[1::2], outputs[:, 1::2] = B, C
    if not filtered:
        return A, inputs, outputs
    Af, Bf, Cf, _ = signal.zpk2ss(*signal.butter(8, 2.0 * np.pi * 0.48, analog=True, output="zpk"))
    Af, Bf, Cf = np.kron(np.eye(2), Af), np.kron(np.eye(2), Bf), np.kron(np.eye(2), Cf)
    whole = np.block([[A, np.zeros((6, 16))], [Bf @ outputs, Af]])
    return whole, np.vstack([inputs, np.zeros((16, 2))]), np.hstack([np.zeros((2, 6)), Cf])


def sensed(drive, theta_deg=-33.0, hold="zoh", start=None, **device):
    """Exact response (N, 2) of the paper's device; ``start`` is the state at the first sample."""
    A, B, C = paper_device(theta_deg, **device)
    A, B, C, D, _ = signal.cont2discrete((A, B, C, np.zeros((2, 2))), 1.0, hold)
    z, V = np.linalg.eig(A)
    Bm, Cm = np.linalg.solve(V, B), C @ V
    first = np.zeros(z.size) if start is None else np.linalg.solve(V, np.resize([*start, *[0] * 22], z.size))
    y = drive @ D.T + 0j
    for k in range(z.size):
        x = signal.lfilter([0.0, 1.0], [1.0, -z[k]], drive @ Bm[k])
        y += (x + first[k] * z[k] ** np.arange(len(drive)))[:, None] * Cm[:, k]
    return y.real


def chirps(samples=30_000, swapped=False, amplitude=2.0):
    t = np.arange(samples) / FS
    up = amplitude * signal.chirp(t, 400.0, samples / FS, 700.0)
    down = amplitude * signal.chirp(t, 700.0, samples / FS, 400.0)
    return np.stack([down, up] if swapped else [up, down], axis=1)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def noise(samples, seed, sigma=1e-3):
    return sigma * np.random.default_rng(seed).standard_normal((samples, 2))


def campaign_of(*pairs, instrument=None, roles=("noise", "fit", "validate")):
    records = tuple(
        Record(f"record-{k + 1}.parquet", FS, drive, sense, role=role)
        for k, ((drive, sense), role) in enumerate(zip(pairs, roles, strict=True))
    )
    return Campaign("A17", records, instrument or Instrument(antialias=AntiAlias()))


@functools.cache
def healthy(seed=0, **device):
    """Silence, the paper's chirp, the chirp with its directions swapped."""
    silent = np.zeros((10_000, 2))
    one, two = chirps(), chirps(swapped=True)
    return campaign_of(
        (silent, noise(10_000, seed)),
        (one, sensed(one, **device) + noise(30_000, seed + 1)),
        (two, sensed(two, **device) + noise(30_000, seed + 2)),
    )


@pytest.fixture(scope="module")
def sound():
    return healthy()


def transformed(campaign, *, drive=lambda v: v, sense=lambda y: y, **changes):
    """The campaign with functions applied to the drive and sense samples of every record."""
    records = (dataclasses.replace(r, drive_v=drive(r.drive_v), sense_v=sense(r.sense_v)) for r in campaign.records)
    return dataclasses.replace(campaign, records=tuple(records), **changes)


def merged(text, patch):
    """campaign.toml with the lines of a patch written or replaced, as a user would do it."""
    old, new = msgspec.toml.decode(text), msgspec.toml.decode(patch)
    for name, table in new.items():
        if name != "record":
            old[name] = {**old.get(name, {}), **table}
    for entry in new.get("record", []):
        next(e for e in old["record"] if e["file"] == entry["file"]).update(entry)
    return old


def toml_of(tree):
    from pipeline.toml_files import table

    tables = [table(f"[{name}]", values) for name, values in tree.items() if name != "record"]
    return "\n".join([*tables, *(table("[[record]]", entry) for entry in tree["record"])])


def corrected(campaign, folder) -> tuple[CheckReport, Campaign]:
    """Write the campaign, check it, apply the printed lines to campaign.toml, and read it again."""
    write_campaign(campaign, folder)
    report = check(read_campaign(folder))
    path = folder / "campaign.toml"
    path.write_text(toml_of(merged(path.read_text(), report.toml)))
    return report, read_campaign(folder)


def kinds(report):
    return {finding.kind for finding in report.findings if finding.severity != "note"}


@pytest.mark.parametrize("device", [{"theta_deg": 0.0}, {"theta_deg": 45.0}, {"theta_deg": 72.0, "split_hz": 0.05}])
def test_a_sound_campaign_has_no_findings(device):
    report = check(healthy(seed=7, **device))
    assert report.findings == ()
    assert report.ok
    assert report.toml == ""


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


def test_the_report_is_json_with_the_documented_keys(sound):
    report = check(transformed(sound, sense=lambda y: y * [1, -1]))
    tree = json.loads(json.dumps(report.to_dict()))
    assert tree["ok"] is False
    assert tree["toml"] == "[channels]\nsense_polarity = [1, -1]\n"
    keys = {"kind", "severity", "text", "record", "channel", "value", "sd", "unit", "toml"}
    assert tree["findings"][0].keys() == keys
    assert tree["findings"][0]["kind"] == "polarity"
    assert {level["channel"] for level in tree["levels"]} == {"sense1", "sense2"}


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
