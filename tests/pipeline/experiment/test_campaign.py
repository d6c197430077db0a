"""campaign.toml is read back exactly, corrections are applied in order, and every error in it gives one message."""

import dataclasses
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import ConfigError, GyroscreenError, MeasurementError, UsageError
from pipeline.experiment.campaign import read_campaign, read_measurement, write_campaign
from pipeline.experiment.checks.finding import composed
from pipeline.experiment.files.channels import correct
from pipeline.experiment.files.readers import WRITTEN, write_columns
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Channels, Record
from pipeline.experiment.systematic import Systematic
from pipeline.performance.operating_point import DeclaredOperation

FS = 10_000.0
SILVERBOX = Path(__file__).resolve().parents[4] / "shared" / "data" / "silverbox" / "SNLS80mV.mat"


def record(seed=0, samples=100, **conditions):
    random = np.random.default_rng(seed)
    return Record(
        f"run {seed}", FS, random.standard_normal((samples, 2)), random.standard_normal((samples, 2)), **conditions
    )


def full_campaign():
    return Campaign(
        'A17 "rocking" é\n',
        (
            record(0, role="noise", rate_dps=0.0),
            record(1, role="fit", bias_v=4.5, at_rest=False),
            record(2, role="validate", rate_dps=-12.5),
        ),
        Instrument(FS, "foh", 5.25, AntiAlias(order=4, corner_hz=4000.0), Adc(12, 5.0)),
        angular_gain=0.7,
        phase_error_deg=1.0 / 3.0,
        drive="f2",
        reference={"f1_hz": (534.6, 0.1), "theta_deg": (-33.0, 2.0)},
        systematic=Systematic(0.5, 0.01, 0.02, 10.0, 0.3, -31.0),
        operation=DeclaredOperation(drive_amplitude_v=0.5, gap_um=10.0, temperature_c=-40.0),
    )


@pytest.mark.parametrize("form", sorted(WRITTEN))
def test_round_trip_keeps_every_number_and_condition(tmp_path, form):
    if form == "tdms":
        pytest.importorskip("nptdms")
    written = full_campaign()
    write_campaign(written, tmp_path, format=form)
    read = read_campaign(tmp_path)
    for name in (
        "device_id",
        "instrument",
        "angular_gain",
        "phase_error_deg",
        "drive",
        "reference",
        "channels",
        "systematic",
        "operation",
    ):
        assert getattr(read, name) == getattr(written, name)
    for ours, theirs in zip(written.records, read.records, strict=True):
        assert np.array_equal(ours.drive_v, theirs.drive_v)
        assert np.array_equal(ours.sense_v, theirs.sense_v)
        for name in ("name", "sample_rate_hz", "role", "at_rest", "rate_dps", "bias_v"):
            assert getattr(ours, name) == getattr(theirs, name)


@pytest.mark.parametrize(
    ("declared", "roles"),
    [
        ([None], ["fit"]),
        ([None, None, None], ["fit", "fit", "validate"]),
        (["noise", None, None], ["noise", "fit", "validate"]),
        (["noise", None], ["noise", "fit"]),
        (["fit", None], ["fit", "validate"]),
        (["validate", None, None], ["validate", "fit", "fit"]),
    ],
)
def test_the_last_record_without_a_role_becomes_the_held_out_record(tmp_path, declared, roles):
    records = tuple(record(k, role=role) for k, role in enumerate(declared))
    write_campaign(Campaign("d", records, Instrument(FS)), tmp_path)
    assert [r.role for r in read_campaign(tmp_path).records] == roles


def folder_with(tmp_path, text, **changes):
    drive, sense = record().drive_v, record().sense_v
    found = {"time_s": np.arange(100) / FS, "drive1_V": drive[:, 0], "sense1_V": sense[:, 0]}
    write_columns(tmp_path, "a", found, "csv")
    (tmp_path / "campaign.toml").write_text(text)
    return tmp_path


GOOD = '[[record]]\nfile = "a.csv"\n'


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("[[record]\n", ConfigError, ["not TOML"]),
        ("", ConfigError, ["missing", "record", "[[record]]"]),
        ("record = []\n", ConfigError, ["record"]),
        (GOOD + "rol = 'fit'\n", ConfigError, ["record[0]", "rol", "did you mean role"]),
        (GOOD + "role = 'training'\n", ConfigError, ["role", "training"]),
        ("[instrument]\nsample_rate_khz = 10.0\n" + GOOD, ConfigError, ["did you mean sample_rate_hz"]),
        (
            "[instrument]\nsample_rate_hz = '10 kHz'\n" + GOOD,
            ConfigError,
            ["instrument.sample_rate_hz", "10 kHz", "a number above 0"],
        ),
        (
            "[instrument]\nsample_rate_hz = -1.0\n" + GOOD,
            ConfigError,
            ["instrument.sample_rate_hz", "-1.0", "a number above 0"],
        ),
        ("[instrument]\nbias_v = nan\n" + GOOD, ConfigError, ["bias_v", "finite"]),
        ("[instrument]\nhold = 'first'\n" + GOOD, ConfigError, ["hold", "first"]),
        ("[instrument]\nantialias = { order = 8 }\n" + GOOD, ConfigError, ["antialias", "corner_hz"]),
        ("[instrument]\nadc = { bits = 16.5, full_scale_v = 1.0 }\n" + GOOD, ConfigError, ["adc.bits"]),
        ("[reference]\nf1 = [534.6, 0.1]\n" + GOOD, ConfigError, ["f1", "did you mean f1_hz"]),
        ("[reference]\nf1_hz = [534.6, 0.0]\n" + GOOD, ConfigError, ["f1_hz", "sd"]),
        ("[reference]\nf1_hz = 534.6\n" + GOOD, ConfigError, ["reference"]),
        ("[channels]\nsense_polarity = [1, 0]\n" + GOOD, ConfigError, ["sense_polarity"]),
        (
            "[channels]\nsense_polarity = [1, -1]\n" + GOOD,
            ConfigError,
            ["sense_polarity", "one value per column of the files (1)"],
        ),
        ("[channels]\nsense_order = [2]\n" + GOOD, ConfigError, ["permutation"]),
        ("[channels]\nlag_samples = 95\n" + GOOD, ConfigError, ["lag_samples"]),
        ("[columns]\nvolts = 'sense1_V'\n" + GOOD, MeasurementError, ["volts", "sense<k>_V"]),
        ("[columns]\nsense1_V = 'sens1_V'\n" + GOOD, MeasurementError, ["did you mean 'sense1_V'"]),
        ("[[record]]\nfile = 'b.csv'\n", MeasurementError, ["b.csv", "did you mean a.csv"]),
        ("[[record]]\nfile = '../elsewhere.csv'\n", MeasurementError, ["elsewhere.csv"]),
        (GOOD + "start = 50\nstop = 200\n", MeasurementError, ["200", "stop <= 100"]),
        (GOOD + "start = 90\n", MeasurementError, ["start"]),
    ],
)
def test_a_wrong_campaign_gives_one_message_with_a_next_step(tmp_path, text, kind, words):
    with pytest.raises(GyroscreenError) as error:
        read_campaign(folder_with(tmp_path, text))
    assert type(error.value) is kind
    for word in words:
        assert word in str(error.value)
    assert error.value.next_step


def test_a_folder_without_campaign_toml_is_reported(tmp_path):
    with pytest.raises(MeasurementError, match=r"campaign\.toml"):
        read_campaign(tmp_path)


def test_records_with_different_channels_are_refused(tmp_path):
    folder_with(tmp_path, GOOD + '[[record]]\nfile = "b.csv"\n')
    found = {"drive1_V": np.zeros(50), "sense1_V": np.zeros(50), "sense2_V": np.ones(50)}
    write_columns(tmp_path, "b", found, "csv")
    with pytest.raises(MeasurementError, match="1 drives, 1 senses, as in the first record"):
        read_campaign(tmp_path)


def test_a_single_file_is_read_as_a_campaign_of_one_record(tmp_path):
    folder = folder_with(tmp_path, GOOD)
    single = read_measurement(folder / "a.csv")
    assert (single.device_id, single.records[0].role) == ("a", "fit")
    assert single.instrument == Instrument(FS)
    whole = read_measurement(folder)
    assert np.array_equal(whole.records[0].sense_v, single.records[0].sense_v)
    assert read_measurement(folder / "campaign.toml").device_id == whole.device_id == tmp_path.name


def test_channel_corrections_are_applied_in_the_documented_order():
    n = np.arange(40.0)
    drive, sense = np.stack([n + 5.0, 10.0 * n], axis=1), np.stack([n, 100.0 * n], axis=1)
    channels = Channels((1, -1), (-1, 1), (2, 1), (2, 1), (5.0, 0.0), 3)
    done = correct(Record("r", FS, drive, sense), channels)
    assert np.array_equal(done.drive_v, np.stack([10.0 * n, -n], axis=1)[:-3])
    assert np.array_equal(done.sense_v, np.stack([-100.0 * n, n], axis=1)[3:])
    assert done.at_rest


def test_a_lag_that_drops_driven_samples_ends_the_state_of_rest():
    driven = record(at_rest=True)
    assert not correct(driven, Channels(lag_samples=-2)).at_rest
    waiting = dataclasses.replace(driven, drive_v=np.concatenate([np.zeros((2, 2)), driven.drive_v[2:]]))
    assert correct(waiting, Channels(lag_samples=-2)).at_rest


signs = st.none() | st.tuples(*[st.sampled_from([-1, 1])] * 2)
orders = st.none() | st.permutations([1, 2]).map(tuple)
offsets = st.none() | st.tuples(*[st.integers(-5, 5).map(float)] * 2)
corrections = st.builds(Channels, signs, signs, orders, orders, offsets, st.integers(-5, 5))


@settings(max_examples=60, deadline=None)
@given(corrections, corrections)
def test_two_corrections_in_a_row_equal_their_composition(first, second):
    # A lag forward and back loses samples at both ends, so lags are composed alone.
    second = dataclasses.replace(second, lag_samples=second.lag_samples if first.lag_samples == 0 else 0)
    raw = record(samples=50)
    twice = correct(correct(raw, first), second)
    once = correct(raw, composed(first, second, 2, 2))
    assert np.allclose(once.drive_v, twice.drive_v, rtol=0.0, atol=1e-12)
    assert np.array_equal(once.sense_v, twice.sense_v)


def test_unwritable_folders_other_rates_and_formats_are_usage_errors(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot be written"):
        write_campaign(full_campaign(), tmp_path / "file")
    with pytest.raises(UsageError, match="sample rate"):
        write_campaign(dataclasses.replace(full_campaign(), instrument=Instrument(5_000.0)), tmp_path)
    with pytest.raises(UsageError, match="format"):
        write_campaign(full_campaign(), tmp_path, format="xls")


@pytest.mark.parametrize("seed", range(3))
def test_mutated_campaign_files_give_typed_errors_only(tmp_path, seed):
    write_campaign(full_campaign(), tmp_path)
    path = tmp_path / "campaign.toml"
    good = path.read_bytes()
    random = np.random.default_rng(seed)
    for _ in range(150):
        bad = bytearray(good)
        at = int(random.integers(0, len(bad)))
        match random.integers(0, 3):
            case 0:
                bad[at] = random.integers(0, 256)
            case 1:
                del bad[at : at + int(random.integers(1, 30))]
            case _:
                bad[at:at] = random.bytes(3)
        path.write_bytes(bad)
        try:
            read_measurement(tmp_path)
        except (ConfigError, MeasurementError):
            continue


@pytest.mark.silverbox
@pytest.mark.skipif(not SILVERBOX.exists(), reason="the measured record is not beside the project")
def test_a_file_with_foreign_column_names_is_read_without_conversion(tmp_path):
    parts = [(40650, 105712, "fit"), (105712, 127400, "validate"), (100, 40575, "validate")]
    entries = [
        f"[[record]]\nfile = {json.dumps(str(SILVERBOX))}\nname = 'part {k}'\nrole = '{role}'\n"
        f"start = {start}\nstop = {stop}\nat_rest = false\n"
        for k, (start, stop, role) in enumerate(parts)
    ]
    columns = '[columns]\ndrive1_V = "V1"\nsense1_V = "V2"\n'
    head = "[instrument]\nsample_rate_hz = 610.35\nhold = 'foh'\nbias_v = 0.0\n"
    (tmp_path / "campaign.toml").write_text(head + columns + "\n".join(entries))
    campaign = read_campaign(tmp_path)
    assert [r.drive_v.shape for r in campaign.records] == [(stop - start, 1) for start, stop, _ in parts]
    assert [r.role for r in campaign.records] == ["fit", "validate", "validate"]
    assert not any(r.at_rest for r in campaign.records)
    # The third part of the Silverbox record is filtered Gaussian noise of rising amplitude ("arrow").
    arrow = campaign.records[2].drive_v[:, 0]
    quarters = np.array_split(arrow, 4)
    assert all(a.std() < b.std() for a, b in pairwise(quarters))


def test_records_cut_from_one_file_are_one_run_so_that_a_drift_goes_on(tmp_path):
    random = np.random.default_rng(6)
    time_s = np.delete(np.arange(1000) / 100.0, slice(600, 650))
    table = np.stack([time_s, *random.standard_normal((2, 950))], axis=1)
    np.savetxt(tmp_path / "m.csv", table, delimiter=",", header="time_s,drive1_V,sense1_V", comments="")
    cuts = ("start = 100\nstop = 300", "start = 300", "start_s = 2.0\nstop_s = 4.0")
    entries = "".join(f'[[record]]\nfile = "m.csv"\nname = "{k}"\n{cut}\n' for k, cut in enumerate(cuts))
    (tmp_path / "campaign.toml").write_text(entries)
    records = read_campaign(tmp_path).records
    # Row 300 follows 2 s behind row 100, and the piece behind the gap 5.5 s.
    expected = {"0": 0.0, "1": 2.0, "1 (2)": 5.5, "2": 1.0}
    assert {r.name: r.elapsed_s for r in records} == pytest.approx(expected)
