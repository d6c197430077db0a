"""Every format returns what was written, and every damaged file gives one measurement error."""

import subprocess
import sys

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from pipeline.errors import MeasurementError
from pipeline.experiment.files.readers import WRITTEN, read_columns, read_record, table, write_columns
from pipeline.experiment.record import Record

FS = 10_000.0
FORMS = sorted(WRITTEN)


def columns(samples=400, seed=1):
    random = np.random.default_rng(seed)
    names = ("drive1_V", "drive2_V", "sense1_V", "sense2_V")
    return {"time_s": np.arange(samples) / FS} | {name: random.standard_normal(samples) for name in names}


def csv_of(tmp_path, found, name="r.csv", **changes):
    path = tmp_path / name
    rows = zip(*found.values())
    path.write_text("\n".join([",".join(found), *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n")
    return path


@pytest.mark.parametrize("form", FORMS)
def test_every_format_returns_every_bit(tmp_path, form):
    if form == "tdms":
        pytest.importorskip("nptdms")
    written = columns()
    record = read_record(write_columns(tmp_path, "r", written, form), FS)
    assert np.array_equal(record.drive_v, np.stack([written["drive1_V"], written["drive2_V"]], axis=1))
    assert np.array_equal(record.sense_v, np.stack([written["sense1_V"], written["sense2_V"]], axis=1))
    assert record.sample_rate_hz == FS
    assert record.clock.jitter_samples < 1e-9


def mat5(path, found, **options):
    savemat(path, found, **options)


def mat5_struct(path, found):
    savemat(path, {"measurement": found, "comment": "taken on Monday"})


def mat73(path, found):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in found.items():
            file[name] = values[None, :]


def mat73_struct(path, found):
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("measurement")
        for name, values in found.items():
            group[name] = values[:, None]


@pytest.mark.parametrize("write", [mat5, mat5_struct, mat73, mat73_struct])
def test_mat_files_of_version_5_and_7_3_are_read(tmp_path, write):
    found = columns()
    write(tmp_path / "r.mat", found)
    record = read_record(tmp_path / "r.mat", None)
    assert np.array_equal(record.sense_v[:, 1], found["sense2_V"])


@pytest.mark.parametrize("oned_as", ["row", "column"])
@pytest.mark.parametrize("do_compression", [True, False])
def test_mat_integers_and_shapes_are_read(tmp_path, oned_as, do_compression):
    # MATLAB stores small integers in fewer bytes; scipy writes the given types.
    found = {"drive1_V": np.arange(50, dtype=np.int16), "sense1_V": np.arange(50, dtype=np.float32) / 4, "id": 7}
    savemat(tmp_path / "r.mat", found, oned_as=oned_as, do_compression=do_compression)
    record = read_record(tmp_path / "r.mat", 100.0)
    assert np.array_equal(record.drive_v[:, 0], np.arange(50.0))
    assert np.array_equal(record.sense_v[:, 0], np.arange(50) / 4)


def test_csv_with_semicolons_and_decimal_commas_is_read(tmp_path):
    (tmp_path / "r.csv").write_text(
        "time_s;drive1_V;sense1_V\n" + "".join(f"{k / 100};{k};-{k},5\n".replace(".", ",") for k in range(20))
    )
    assert read_record(tmp_path / "r.csv", 100.0).sense_v[3, 0] == -3.5


def test_other_columns_are_ignored(tmp_path):
    found = columns() | {"temperature_C": np.full(400, 21.0)}
    assert read_record(csv_of(tmp_path, found), FS).sense_v.shape == (400, 2)


def spoil_nan(c):
    c["sense2_V"][[17, 30]] = np.nan


def spoil_gap(c):
    c["time_s"][100:] += 3 / FS


def spoil_duplicate(c):
    c["time_s"][50] = c["time_s"][49]


def spoil_backwards(c):
    c["time_s"][60] = c["time_s"][10]


def spoil_jitter(c):
    c["time_s"][70] += 0.8 / FS


def spoil_rate(c):
    c["time_s"] *= 1.001


def spoil_missing(c):
    c["Sense2"] = c.pop("sense2_V")


def spoil_alike(c):
    c["drive_3"] = c["drive1_V"]


def spoil_numbering(c):
    c["sense3_V"] = c.pop("sense2_V")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (spoil_nan, ["sense2_V", "2 values", "row 17"]),
        (spoil_gap, ["3 samples are missing", "row 100", "stop = 100"]),
        (spoil_duplicate, ["twice", "row 50"]),
        (spoil_backwards, ["backwards", "row 60"]),
        (spoil_jitter, ["not uniform", "row 70", "0.795 samples"]),
        (spoil_rate, ["sample_rate_hz = 9990.00999", "[instrument]"]),
        (spoil_alike, ["drive_3", "drive3_V"]),
        (spoil_missing, ["Sense2", "sense2_V"]),
        (spoil_numbering, ["no column sense2_V", "sense3_V"]),
    ],
)
def test_a_wrong_column_is_reported_with_its_row_and_a_remedy(tmp_path, spoil, words):
    found = columns()
    spoil(found)
    path = write_columns(tmp_path, "r", found, "parquet")
    with pytest.raises(MeasurementError) as error:
        read_record(path, FS)
    for word in words:
        assert word in str(error.value)
    assert "r.parquet" in str(error.value)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("r.csv", "time_s,drive1_V,sense1_V\n0,1,2\n0.1,x,3\n", ["drive1_V", "does not hold numbers", "x"]),
        ("r.csv", "time_s,drive1_V,sense1_V\n0,1,2\n0.1,2\n", ["cannot be read as csv"]),
        ("r.csv", "", ["header"]),
        ("r.csv", "1.0 2.0 3.0\n", ["no column sense1_V", "column2"]),
        ("r.csv", "drive1_V,drive1_V,sense1_V\n1,2,3\n", ["twice"]),
        ("r.csv", "drive1_V,sense1_V\n1,2\n", ["too short"]),
        ("r.wav", "RIFF", ["known format", ".parquet"]),
        ("r.parquet", "time_s,drive1_V\n", ["cannot be read as parquet"]),
        ("r.mat", "plain text", ["MAT"]),
        ("r.npz", "", ["cannot be read as npz"]),
    ],
)
def test_a_wrong_file_gives_one_typed_message(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(MeasurementError) as error:
        read_record(tmp_path / name, FS)
    for word in words:
        assert word in str(error.value)


def test_a_missing_file_names_the_most_similar_one(tmp_path):
    (tmp_path / "record-1.csv").touch()
    with pytest.raises(MeasurementError, match=r"did you mean record-1\.csv"):
        read_record(tmp_path / "record_1.csv", FS)


def test_a_record_needs_a_time_column_or_a_declared_rate(tmp_path):
    found = columns()
    del found["time_s"]
    path = write_columns(tmp_path, "r", found, "npz")
    assert read_record(path, 5_000.0).duration_s == 400 / 5_000.0
    with pytest.raises(MeasurementError, match="sample_rate_hz"):
        read_record(path, None)


def test_objects_in_an_archive_are_never_unpickled(tmp_path):
    np.savez(tmp_path / "r.npz", drive1_V=np.array([{"a": 1}] * 20, dtype=object), sense1_V=np.zeros(20))
    with pytest.raises(MeasurementError):
        read_columns(tmp_path / "r.npz")


@pytest.mark.parametrize("form", ["hdf5", "npz", "parquet"])
def test_absurd_sizes_are_refused_before_memory_is_allocated(tmp_path, form, monkeypatch):
    if form == "hdf5":
        # A terabyte in a file of a few kilobytes, because no chunk was ever written.
        with h5py.File(tmp_path / "r.h5", "w") as file:
            for name in ("drive1_V", "sense1_V"):
                file.create_dataset(name, shape=(2**36,), chunks=(1024,), dtype="f8")
        path = tmp_path / "r.h5"
    else:
        monkeypatch.setattr(table, "RECORD_VALUES", 1000)
        path = write_columns(tmp_path, "r", columns(), form)
    with pytest.raises(MeasurementError, match="too many values"):
        read_record(path, FS)


def test_flipped_bits_in_parquet_pages_are_never_read_as_data(tmp_path):
    good = write_columns(tmp_path, "good", columns(), "parquet")
    truth, data = read_record(good, FS), good.read_bytes()
    # The last eight bytes are the length of the footer, which carries no checksum, and the magic.
    pages = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    random = np.random.default_rng(5)
    for _ in range(200):
        bad = bytearray(data)
        bad[random.integers(0, pages)] ^= 1 << int(random.integers(0, 8))
        (tmp_path / "bad.parquet").write_bytes(bad)
        try:
            record = read_record(tmp_path / "bad.parquet", FS)
        except MeasurementError:
            continue
        assert np.array_equal(record.sense_v, truth.sense_v)
        assert np.array_equal(record.drive_v, truth.drive_v)


# The mutations run in a process of their own, so that a reader that crashes the interpreter fails only this test.
FUZZ = """
import sys, warnings
from pathlib import Path
import numpy as np
from pipeline.errors import MeasurementError
from pipeline.experiment.files.readers import read_record
from pipeline.experiment.record import Record

warnings.simplefilter("error")
good = Path(sys.argv[1])
data = good.read_bytes()
bad = good.with_name("mutated" + good.suffix)
outcomes = {"record": 0, "error": 0}
for seed in range(int(sys.argv[2])):
    random = np.random.default_rng(seed)
    b = bytearray(data)
    # Half of the mutations hit the head, where headers lie; some the tail, where footers do.
    reach = len(b) if random.random() < 0.5 else min(len(b), 600)
    at = int(random.integers(0, reach))
    kind = seed % 5
    if kind == 0:
        b[at] ^= 1 << int(random.integers(0, 8))
    elif kind == 1:
        del b[at:]
    elif kind == 2:
        b[at:at] = random.bytes(int(random.integers(1, 20)))
    elif kind == 3:
        b[at : at + 4] = [b"\\xff" * 4, b"\\xff\\xff\\xff\\x7f", bytes(4)][int(random.integers(0, 3))]
    else:
        b[-1 - int(random.integers(0, min(len(b), 600)))] ^= 1 << int(random.integers(0, 8))
    bad.write_bytes(b)
    try:
        outcomes["record"] += isinstance(read_record(bad, None), Record)
    except MeasurementError as error:
        assert error.what and error.next_step, error
        outcomes["error"] += 1
print(outcomes["record"], outcomes["error"])
"""


@pytest.mark.parametrize("form", [*FORMS, "mat5_struct", "mat73_struct"])
def test_mutated_files_give_a_record_or_one_measurement_error(tmp_path, form):
    if form == "tdms":
        pytest.importorskip("nptdms")
    found = {"time_s": np.arange(200) / FS} | {
        k: v[:200] for k, v in columns().items() if k in ("drive1_V", "sense1_V")
    }
    if form in FORMS:
        path = write_columns(tmp_path, "good", found, form)
    else:
        path = tmp_path / "good.mat"
        (mat5_struct if form == "mat5_struct" else mat73_struct)(path, found)
    assert isinstance(read_record(path, None), Record)
    count = 400
    done = subprocess.run(
        [sys.executable, "-c", FUZZ, str(path), str(count)], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    records, errors = map(int, done.stdout.split())
    assert records + errors == count
    assert errors > 50
