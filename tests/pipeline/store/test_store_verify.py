"""Every damage to committed results is found, and stray files do not affect results."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from in_process import InProcess
from store_runs import CONFIG, PROVENANCE, block_tables, make_run

from pipeline.errors import IntegrityError, UsageError
from pipeline.store.files import sha256
from pipeline.store.manifest import NAME, decode, encode
from pipeline.store.parquet import decode_table, encode_table
from pipeline.store.query import query
from pipeline.store.read import read_run
from pipeline.store.run import create_run
from pipeline.store.schema import devices_schema
from pipeline.store.verify import verify


@pytest.fixture(autouse=True)
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Queries run in the process of the test, without its limits."""
    monkeypatch.setattr("pipeline.store.query.QueryProcess", InProcess)


def flip(path: Path, bit: int) -> bytes:
    """Flip one bit of a file; return what it held."""
    data = path.read_bytes()
    damaged = bytearray(data)
    damaged[bit // 8] ^= 1 << (bit % 8)
    path.write_bytes(damaged)
    return data


def test_a_sound_run_has_no_findings(tmp_path: Path) -> None:
    make_run(tmp_path, "r")
    report = verify(tmp_path)
    assert report.findings == ()
    assert (report.runs, report.files, report.devices, report.draws) == (1, 8, 12, 60)
    report.require()


@pytest.mark.parametrize("name", ["devices-00000.parquet", "posterior-00000.parquet", NAME, "run.toml"])
def test_a_flipped_bit_fails_reading_and_verification(tmp_path: Path, name: str) -> None:
    store = make_run(tmp_path, "r", blocks=(0,))
    path = store.folder / name
    bits = 8 * path.stat().st_size
    for bit in np.random.default_rng(1).choice(bits, min(bits, 60), replace=False):
        sound = flip(path, int(bit))
        with pytest.raises(IntegrityError):
            read_run(tmp_path, "r")
        report = verify(tmp_path)
        assert any(finding.fatal and finding.file == str(path) for finding in report.findings), bit
        with pytest.raises(IntegrityError):
            report.require()
        path.write_bytes(sound)
    assert verify(tmp_path).ok


def test_a_query_on_a_damaged_file_is_refused(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r", blocks=(0,))
    for name, table in (("devices-00000.parquet", "devices"), ("posterior-00000.parquet", "Posterior")):
        path = store.folder / name
        for bit in np.random.default_rng(2).choice(8 * path.stat().st_size, 10, replace=False):
            sound = flip(path, int(bit))
            with pytest.raises(IntegrityError, match="is not what was committed"):
                query(f"SELECT count(theta_deg) FROM {table}", tmp_path)
            path.write_bytes(sound)


def test_page_checksums_alone_catch_damaged_values() -> None:
    table = block_tables(0)[0]
    data = bytes(encode_table(table))
    metadata = pq.ParquetFile(pa.BufferReader(data)).metadata
    column = metadata.row_group(0).column(devices_schema().get_field_index("theta_deg"))
    # The last bytes of a chunk are those of its page's body.
    end = column.data_page_offset + column.total_compressed_size
    for bit in range(8 * (end - 8), 8 * end):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << (bit % 8)
        with pytest.raises(IntegrityError, match="not readable Parquet"):
            decode_table(bytes(damaged), devices_schema(), "file")


def test_missing_and_exchanged_files_are_named(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    shutil.copy(store.folder / "devices-00000.parquet", store.folder / "devices-00001.parquet")
    (store.folder / "posterior-00002.parquet").unlink()
    damaged = {Path(finding.file).name for finding in verify(tmp_path).findings if finding.fatal}
    assert damaged == {"devices-00001.parquet", "posterior-00002.parquet"}
    report = verify(tmp_path)
    assert all(name in str(report) for name in (*damaged, "2 damaged"))
    shown = json.loads(json.dumps(report.to_dict()))
    assert (shown["ok"], len(shown["findings"]), shown["findings"][0]["fatal"]) == (False, 2, True)


def test_stray_files_are_named_but_are_no_errors(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    foreign = pa.table({"device_id": [1, 2], "surprise": ["x", "y"]})
    strays = [store.folder / "devices-00099.parquet", store.folder / "notes.txt", tmp_path / "devices.parquet"]
    for path in strays:
        pq.write_table(foreign, path)
    (tmp_path / "run=empty").mkdir()
    report = verify(tmp_path)
    assert report.ok
    assert {finding.file for finding in report.findings} == {*map(str, strays), str(tmp_path / "run=empty")}
    assert query("SELECT count(*) AS n FROM devices", tmp_path).to_pylist() == [{"n": 12}]
    assert read_run(tmp_path).devices.num_rows == 12


def test_gaps_and_duplicates_in_a_forged_manifest_are_found(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    manifest = store.manifest
    path = store.folder / NAME

    kept = tuple(entry for entry in manifest.files if entry.block != 1)
    path.write_bytes(encode(replace(manifest, files=kept)))
    assert "blocks of a complete run" in [f.what for f in verify(tmp_path).findings if f.fatal]

    wrong_rows = tuple(replace(e, rows=5) if e.name == "devices-00001.parquet" else e for e in manifest.files)
    path.write_bytes(encode(replace(manifest, files=wrong_rows)))
    assert [f.what for f in verify(tmp_path).findings] == ["number of rows"]
    with pytest.raises(IntegrityError, match="wrong number of rows"):
        read_run(tmp_path)

    twin = (store.folder / "devices-00000.parquet").read_bytes()
    (store.folder / "devices-00001.parquet").write_bytes(twin)
    twins = tuple(
        replace(e, bytes=len(twin), sha256=sha256(twin)) if e.name == "devices-00001.parquet" else e
        for e in manifest.files
    )
    path.write_bytes(encode(replace(manifest, files=twins)))
    found = {f.what for f in verify(tmp_path).findings}
    assert found == {"devices with more than one row", "digest of the devices table"}


def test_committed_files_of_a_foreign_schema_are_refused(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    for foreign, match in (
        (pa.table({"device_id": ["a"], "theta_deg": ["text"]}), "theta_deg: string"),
        (pa.table({"device_id": ["a"], "surprise": [1.0]}), "surprise: double"),
    ):
        data = bytes(encode_table(foreign))
        with pytest.raises(IntegrityError, match=match):
            decode_table(data, devices_schema(), str(store.folder))


def test_columns_registered_later_read_as_null() -> None:
    old = block_tables(0)[0].drop_columns(["true_theta_deg", "cause"])
    table = decode_table(bytes(encode_table(old)), devices_schema(), "file")
    assert table.schema.equals(devices_schema())
    assert table.column("cause").null_count == table.num_rows
    assert table.column("theta_deg").equals(old.column("theta_deg"))


def test_a_manifest_of_another_run_or_version_is_refused(tmp_path: Path) -> None:
    store = make_run(tmp_path, "r")
    shutil.copytree(store.folder, tmp_path / "run=copy")
    assert [Path(f.file).parent.name for f in verify(tmp_path).findings if f.fatal] == ["run=copy"]
    newer = encode(replace(store.manifest, format=2))
    with pytest.raises(IntegrityError, match="another format version: 2"):
        decode(newer, "manifest")


def test_an_unfinished_run_with_gaps_is_sound(tmp_path: Path) -> None:
    store = create_run(tmp_path, "r", CONFIG, PROVENANCE)
    store.commit_block(3, *block_tables(3))
    report = verify(tmp_path)
    assert report.ok
    assert [finding.what for finding in report.findings] == ["blocks of a running run"]


def test_folders_without_runs_are_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="results folder holds no runs"):
        verify(tmp_path)
    with pytest.raises(UsageError, match="no such results folder"):
        verify(tmp_path / "nowhere")
