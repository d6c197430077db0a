"""Files that other programs wrote: layouts of text, units, gaps, rounded time stamps, files that belong together."""

from __future__ import annotations

import re

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from pipeline.errors import ConfigError, MeasurementError
from pipeline.experiment.campaign import read_campaign
from pipeline.experiment.files.clock import clock_of, pieces
from pipeline.experiment.files.readers import read_columns, read_record
from pipeline.experiment.files.readers.text_layout import text_layout
from pipeline.experiment.files.units import split_unit

FS = 1000.0
T = np.arange(200) / FS
U = np.sin(2 * np.pi * 40.0 * T)
Y = np.cos(2 * np.pi * 40.0 * T)


def lines(mark, decimal=".", number="{:.9f}"):
    rows = (mark.join(number.format(v) for v in row) for row in zip(T, U, Y))
    return "\n".join(row.replace(".", decimal) for row in rows) + "\n"


LAYOUTS = {
    "names and units on two lines": "time;u;y\n[ms];(mV);V\n" + lines(";", ","),
    "preamble of an instrument": "Model;DAQ-7\nSample Rate;1000 Hz\n\nTime [s];CH1 [V];CH2 [V]\n" + lines(";"),
    "comment mark before names": "# t\tu\ty\n" + lines("\t"),
    "no names, white space": lines("   "),
    "trailing delimiter": lines("\t").replace("\n", "\t\n"),
    "latin-1 units": "t,u in µV,y\n" + lines(","),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_of_a_text_table_gives_the_same_numbers(tmp_path, name):
    (tmp_path / "r.txt").write_bytes(LAYOUTS[name].encode("latin-1"))
    found = read_columns(tmp_path / "r.txt")
    assert [len(v) for v in found.values()] == [200] * 3
    for values, written in zip(found.values(), (T, U, Y)):
        assert np.max(np.abs(values - written)) < 1e-9


def test_a_sample_rate_in_the_preamble_is_the_clock(tmp_path):
    rows = "\n".join(f"{u:.6f},{y:.6f}" for u, y in zip(U, Y))
    (tmp_path / "r.csv").write_text(f"Sampling interval,5e-4,s\ndrive1_V,sense1_V\n{rows}\n")
    assert read_record(tmp_path / "r.csv", None).sample_rate_hz == pytest.approx(2000.0)


@pytest.mark.parametrize(
    ("stated", "step_s"),
    [
        ("Sampling interval,0.5,ms", 5e-4),
        ("Sampling interval;5e-4;channel 2", 5e-4),
        ("Sample Rate: 2 KHZ", 5e-4),
        ("Sample rate = 2.5 MS/s", 4e-7),
        ("Sampling Frequency: 2 MHz", 5e-7),
        ("Sampling Frequency: 2 mHz", 500.0),
        ("Sampling Frequency: 2 MHZ", None),  # millihertz or megahertz: a factor of 1e9
        ("Sample rate: 2 V", None),
    ],
)
def test_the_unit_of_a_stated_rate_is_read_with_its_capitals(tmp_path, stated, step_s):
    (tmp_path / "r.csv").write_text(stated + "\ndrive1_V,sense1_V\n" + "0.1,0.2\n" * 5)
    assert text_layout(tmp_path / "r.csv").step_s == (None if step_s is None else pytest.approx(step_s))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a [m/s^2]", ("a", "m/s^2")),
        ("Voltage (mV)", ("Voltage", "mV")),
        ("U/µV", ("U", "uV")),
        ("time_ms", ("time", "ms")),
        ("acc_1", ("acc_1", None)),
        ("x_m", ("x_m", None)),
        ("force", ("force", None)),
    ],
)
def test_a_unit_behind_a_name_is_separated(name, expected):
    assert split_unit(name) == expected


def write_table(path, names, *columns):
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=names, comments="")


def campaign(folder, columns, text=None, record='file = "r.csv"\n'):
    if text is not None:
        (folder / "r.csv").write_text(text)
    (folder / "campaign.toml").write_text(f"[columns]\n{columns}\n[[record]]\n{record}")
    return read_campaign(folder)


def test_units_gain_and_offset_turn_columns_into_si(tmp_path):
    text = "t [ms],u [mV],a [g],n\n" + "\n".join(
        f"{1e3 * t:.9f},{u:.9f},{y:.9f},{k}" for k, (t, u, y) in enumerate(zip(T, U, Y))
    )
    columns = 'time_s = "t"\ndrive1_V = { name = "u", gain = 20.0, offset = 0.5 }\nsense1_V = 3\n'
    columns += 'sense2_V = { number = 4, unit = "counts" }'
    (record,) = campaign(tmp_path, columns, text + "\n").records
    assert record.sample_rate_hz == pytest.approx(FS)
    assert record.drive_v[:, 0] == pytest.approx(20.0 * 1e-3 * U - 0.5, abs=1e-9)
    assert record.sense_v[:, 0] == pytest.approx(9.80665 * Y, abs=1e-7)
    assert record.units == {"sense1_V": "m/s^2", "sense2_V": "counts"}


@pytest.mark.parametrize(
    ("columns", "kind", "words"),
    [
        ('drive1_V = 9\nsense1_V = "y"', MeasurementError, ["no column number 9", "1 to 3"]),
        ('drive1_V = { unit = "mV" }\nsense1_V = "y"', ConfigError, ["name or the number"]),
        ('drive1_V = { name = "u", unit = "mVolt" }\nsense1_V = "y"', ConfigError, ["unknown unit", "mVolt"]),
        ('drive1_V = { name = "u", unit = "ms" }\nsense1_V = "y"', ConfigError, ["mapped to a column in ms"]),
        ('drive1_V = { name = "u", gain = 0.0 }\nsense1_V = "y"', ConfigError, ["gain of 0"]),
        ('drive1_V = { name = "u", file = 2 }\nsense1_V = "y"', ConfigError, ["file = "]),
    ],
)
def test_a_wrong_mapping_is_one_message(tmp_path, columns, kind, words):
    with pytest.raises(kind) as error:
        campaign(tmp_path, 'time_s = "t"\n' + columns, "t,u,y\n" + lines(","))
    for word in words:
        assert word in str(error.value)


def test_drive_and_sense_in_separate_files_are_one_record(tmp_path):
    np.savetxt(tmp_path / "in.txt", np.stack([T, U], axis=1))
    np.savetxt(tmp_path / "out.txt", np.stack([T, Y], axis=1))
    columns = "time_s = 1\ndrive1_V = 2\nsense1_V = { number = 2, file = 2 }"
    (record,) = campaign(tmp_path, columns, record='file = ["in.txt", "out.txt"]\n').records
    assert np.array_equal(record.drive_v[:, 0], U)
    assert np.array_equal(record.sense_v[:, 0], Y)


def test_a_record_with_a_gap_becomes_two_of_which_the_second_does_not_start_at_rest(tmp_path):
    time_s = T + (T >= 0.1) * 0.0371
    text = "time_s,drive1_V,sense1_V\n" + "\n".join(f"{t:.9f},{u:.9f},{y:.9f}" for t, u, y in zip(time_s, U, Y))
    first, second = campaign(tmp_path, "", text + "\n").records
    assert np.concatenate([first.sense_v, second.sense_v])[:, 0] == pytest.approx(Y, abs=1e-9)
    assert (first.at_rest, second.at_rest) == (True, False)
    assert second.name == "r.csv (2)"
    assert second.clock.start_s == pytest.approx(0.1371)
    with pytest.raises(MeasurementError, match=r"37 samples are missing before row 100.*stop = 100"):
        read_record(tmp_path / "r.csv", None)


def test_the_advised_stop_removes_the_fault(tmp_path):
    # The rows that start and stop leave out are never looked at.
    rows = [f"{t:.9f},{u:.9f},{y:.9f}" for t, u, y in zip(T, U, Y)]
    rows[150] = "0.01,0.0,nan"
    text = "time_s,drive1_V,sense1_V\n" + "\n".join(rows) + "\n"
    with pytest.raises(MeasurementError, match="row 150"):
        campaign(tmp_path, "", text)
    (record,) = campaign(tmp_path, "", text, 'file = "r.csv"\nstop = 150\n').records
    assert record.sense_v.shape == (150, 1)


@pytest.mark.parametrize("fault", ["twice", "backwards", "not a number"])
@pytest.mark.parametrize("start", [0, 37])
def test_every_advised_start_and_stop_gives_a_record(tmp_path, fault, start):
    rows = [[f"{t:.9f}", f"{u:.9f}", f"{y:.9f}"] for t, u, y in zip(T, U, Y)]
    for row in (120, 121, 160):
        if fault == "not a number":
            rows[row][2] = "nan"
        else:
            rows[row][0] = rows[row - 1 if fault == "twice" else row - 30][0]
    text = "time_s,drive1_V,sense1_V\n" + "\n".join(",".join(row) for row in rows) + "\n"
    with pytest.raises(MeasurementError) as error:
        campaign(tmp_path, "", text, f'file = "r.csv"\nstart = {start}\n')
    cuts = [dict(re.findall(r"(start|stop) = (\d+)", part)) for part in error.value.next_step.split(" or ")[:2]]
    for cut in filter(None, cuts):
        lines = "\n".join(f"{key} = {value}" for key, value in {"start": str(start), **cut}.items())
        (record,) = campaign(tmp_path, "", text, f'file = "r.csv"\n{lines}\n').records
        assert record.sense_v.shape[0] >= 30
    assert any(cuts)


@pytest.mark.parametrize("digits", [3, 4])
def test_rounded_time_stamps_give_the_rate_and_no_gap(digits):
    # 3 digits at 10.3 kHz: ten samples share a stamp.
    time_s = np.round(5.0 + np.arange(5000) / 10_300.0, digits)
    assert pieces("r", time_s) == [slice(0, 5000)]
    assert clock_of("r", time_s, None).sample_rate_hz == pytest.approx(10_300.0, rel=1e-4)


def test_jitter_below_half_a_sample_is_no_gap_and_its_size_is_known():
    random = np.random.default_rng(3)
    time_s = np.arange(4000) / FS + random.uniform(-0.3, 0.3, 4000) / FS
    assert pieces("r", time_s) == [slice(0, 4000)]
    clock = clock_of("r", time_s, None)
    assert clock.sample_rate_hz == pytest.approx(FS, rel=1e-5)
    assert clock.jitter_samples == pytest.approx(0.3, abs=0.02)


def test_a_record_without_drive_columns_was_not_driven(tmp_path):
    write_table(tmp_path / "a.csv", "time_s,drive1_V,drive2_V,sense1_V", T, U, U, Y)
    write_table(tmp_path / "b.csv", "time_s,sense1_V", T, Y)
    (tmp_path / "campaign.toml").write_text('[[record]]\nfile = "a.csv"\n[[record]]\nfile = "b.csv"\nrole = "noise"\n')
    driven, silent = read_campaign(tmp_path).records
    assert driven.drive_v.shape == silent.drive_v.shape == (200, 2)
    assert not silent.drive_v.any()


def test_structs_groups_and_tables_of_mat_and_hdf5_are_columns(tmp_path):
    inner = {"u": U[:, None], "table": np.stack([T, Y], axis=1)}
    savemat(tmp_path / "r.mat", {"run": {"data": inner, "rate": FS}, "note": "text", "kernel": np.eye(200)})
    found = read_columns(tmp_path / "r.mat")
    assert np.array_equal(found["u"], U)
    assert np.array_equal(found["table[2]"], Y)
    assert not [name for name in found if "kernel" in name]
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["run/data/u"] = U
        file["run/data/table"] = inner["table"].T
        file["run/data/link"] = h5py.ExternalLink("other.h5", "/x")
    assert list(read_columns(tmp_path / "r.h5")) == ["table[1]", "table[2]", "u"]
    assert np.array_equal(read_columns(tmp_path / "r.h5")["table[2]"], Y)
