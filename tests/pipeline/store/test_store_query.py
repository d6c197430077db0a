from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from in_process import InProcess
from store_runs import CONFIG, PROVENANCE, block_tables, make_run

from pipeline.errors import IntegrityError, UsageError
from pipeline.store.query import answer, query, write_table
from pipeline.store.read import read_run
from pipeline.store.run import create_run
from pipeline.store.schema import COLUMNS


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    make_run(folder, "one")
    make_run(folder, "two", blocks=(0, 1), seed=8)
    create_run(folder, "empty", CONFIG, PROVENANCE)
    return folder


@pytest.fixture(autouse=True)
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Queries run in the process of the test, without its limits."""
    monkeypatch.setattr("pipeline.store.query.QueryProcess", InProcess)


def written(table: pa.Table, format: str) -> str:
    sink = io.BytesIO()
    write_table(table, format, sink)
    return sink.getvalue().decode()


def test_run_id_distinguishes_devices_of_the_same_name(results: Path) -> None:
    answer = query("SELECT run_id, count(*) AS n FROM devices GROUP BY run_id ORDER BY run_id", results, run="all")
    assert answer.to_pylist() == [{"run_id": "one", "n": 12}, {"run_id": "two", "n": 8}]
    draws = query("SELECT count(*) AS n FROM posterior WHERE run_id = 'two'", results, run="all")
    assert draws.to_pylist() == [{"n": 40}]


def test_devices_and_draws_are_those_of_the_latest_run_unless_another_is_named(results: Path, tmp_path: Path) -> None:
    make_run(tmp_path, "one")
    make_run(tmp_path, "two", blocks=(0, 1), seed=8)
    counted = "SELECT count(*) AS n, (SELECT count(*) FROM posterior) AS draws FROM devices"
    for run, expected in (("latest", (8, 40)), ("one", (12, 60)), ("all", (20, 100))):
        assert query(counted, tmp_path, run=run).to_pylist() == [{"n": expected[0], "draws": expected[1]}]
    assert query(counted, tmp_path) == query(counted, tmp_path, run="latest")
    assert query("SELECT run_id FROM runs", tmp_path).num_rows == 2
    for view in ("devices", "posterior", "runs"):
        assert "run_id" in query(f"FROM {view}", tmp_path).column_names
    with pytest.raises(UsageError, match="no such run"):
        query(counted, tmp_path, run="three")


def test_values_are_those_committed_with_their_units(results: Path) -> None:
    columns = read_run(results, "one").devices.schema.names
    answer = query(f"SELECT {', '.join(columns)} FROM devices ORDER BY device_id", results, run="one")
    committed = read_run(results, "one").devices
    assert answer.to_pydict() == committed.to_pydict()
    assert answer.schema.field("split_hz").metadata == committed.schema.field("split_hz").metadata


def test_every_column_is_explained_in_the_view_columns(results: Path) -> None:
    for view in ("devices", "posterior", "runs", "columns"):
        has = query(f"FROM (DESCRIBE {view})", results).column("column_name").to_pylist()
        explained = query(f"""SELECT name FROM columns WHERE "table" = '{view}'""", results).column("name").to_pylist()
        assert explained == has
    unit = query("SELECT unit FROM columns WHERE name = 'quadrature_rate_dps_sd'", results)
    assert unit.column("unit").to_pylist() == ["deg/s"]
    assert len(query("FROM columns", results)) > len(COLUMNS)


def test_the_view_runs_has_status_and_counts(results: Path) -> None:
    answer = query("SELECT run_id, status, devices, draws, blocks, seed FROM runs ORDER BY run_id", results).to_pylist()
    assert [row["status"] for row in answer] == ["running", "complete", "complete"]
    assert answer[1] == {"run_id": "one", "status": "complete", "devices": 12, "draws": 60, "blocks": 3, "seed": "7"}


def test_runs_without_blocks_give_empty_tables(tmp_path: Path) -> None:
    create_run(tmp_path, "r", CONFIG, PROVENANCE)
    answer = query("SELECT * FROM devices JOIN posterior USING (run_id, device_id)", tmp_path)
    assert answer.num_rows == 0
    assert "theta_deg_q95" in answer.schema.names


@pytest.mark.parametrize(
    ("sql", "match"),
    [
        ("SELEC 1", "syntax error"),
        ("", "found 0 SQL statements"),
        ("-- nothing", "found 0 SQL statements"),
        ("SELECT 1; SELECT 2", "found 2 SQL statements"),
        ("SELECT teta_deg FROM devices", r"theta_deg.*next: .SELECT name, unit, meaning FROM columns"),
        ("SELECT * FROM device", 'Did you mean "devices"'),
        ("SELECT CAST('x' AS INT)", "Could not convert"),
        ("SELECT '\udc80'", "UTF-8|incompatible"),
        ("SELECT error('the devil')", "the devil"),
    ],
)
def test_wrong_sql_is_one_clear_message(results: Path, sql: str, match: str) -> None:
    with pytest.raises(UsageError, match=match):
        query(sql, results)


def test_a_query_opens_only_sound_files_however_it_names_its_tables(results: Path, tmp_path: Path) -> None:
    folder = make_run(tmp_path, "r", blocks=(0,)).folder
    path = folder / "posterior-00000.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    for table in ("Posterior", "query('FROM poster' || 'ior')", "query_table('posterior')", '"pos\u0074erior"'):
        with pytest.raises(IntegrityError, match=r"posterior-00000\.parquet is not what was committed"):
            query(f"SELECT count(*) FROM {table}", tmp_path)
    # What is not opened cannot falsify an answer.
    assert query("SELECT count(*) AS n FROM devices", tmp_path).to_pylist() == [{"n": 4}]


def test_queries_beyond_time_memory_or_size_limits_are_refused(
    results: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    endless = "SELECT count(*) FROM range(10000000) a, range(10000000) b WHERE hash(a.range) % 7 = hash(b.range) % 3"
    with pytest.raises(UsageError, match=r"no result within 0.2 s"):
        query(endless, results, timeout_s=0.2)
    # DuckDB does not count this memory, and does not look for interrupts while it fills it.
    with pytest.raises(UsageError, match="more memory than it may take"):
        query("SELECT length(repeat('x', 3000000000))", results, memory_limit="300MB")
    with pytest.raises(UsageError, match="more memory than it may take"):
        query("SELECT list(range) FROM range(100000000)", results, memory_limit="100MB")
    monkeypatch.setattr("pipeline.store.query.MAX_ANSWER_BYTES", 1 << 20)
    with pytest.raises(UsageError, match="larger than 1 MiB"):
        query("SELECT range FROM range(1000000000)", results)
    found = answer("SELECT range FROM range(1000000)", results, rows=3)
    assert (found.table.num_rows, found.rows) == (3, 1_000_000)
    assert list(tmp_path.iterdir()) == []


def test_invalid_query_limits_are_refused(results: Path) -> None:
    with pytest.raises(UsageError, match="the timeout is not a positive time: nan"):
        query("SELECT 1", results, timeout_s=float("nan"))
    with pytest.raises(UsageError, match=r"memory limit.*: 'much'"):
        query("SELECT 1", results, memory_limit="much")


def test_the_text_table_shows_units_and_aligns() -> None:
    devices = block_tables(0)[0].select(["device_id", "split_hz", "verdict"])
    lines = written(devices.slice(0, 1), "table").splitlines()
    assert lines == [
        "device_id  split_hz  verdict",
        "               [Hz]",
        "---------  --------  -------",
        "000000            -  pass",
        "(1 row)",
    ]
    assert "\x1b" not in written(pa.table({"a": ["\x1b[31m"]}), "table")


def test_json_csv_and_parquet_keep_the_full_precision(tmp_path: Path) -> None:
    table = block_tables(3)[0].select(["device_id", "theta_deg", "split_hz", "verdict"])
    rows = table.to_pylist()
    assert json.loads(written(table, "json")) == rows
    read: list[dict[str, Any]] = list(csv.DictReader(io.StringIO(written(table, "csv"))))
    assert [float(row["theta_deg"]) for row in read] == table.column("theta_deg").to_pylist()
    assert read[0]["split_hz"] == ""
    write_table(table, "parquet", tmp_path / "answer.parquet")
    back = pq.read_table(tmp_path / "answer.parquet")
    assert back.equals(table)
    assert back.schema.field("split_hz").metadata[b"unit"] == b"Hz"


def test_every_duckdb_type_is_written_as_valid_json_and_csv(results: Path) -> None:
    answer = query(
        "SELECT 'inf'::DOUBLE AS a, 'nan'::DOUBLE AS b, sum(range) AS c, [1, 2] AS d, {'k': 1.5} AS e,"
        " DATE '2026-01-02' AS f, 'x'::BLOB AS g, INTERVAL 1 DAY AS h, 1.25::DECIMAL(4, 2) AS i FROM range(10)",
        results,
    )
    row = json.loads(written(answer, "json"))[0]
    assert (row["a"], row["b"], row["c"], row["d"], row["e"]) == ("inf", None, 45, [1, 2], {"k": 1.5})
    assert (row["f"], row["g"], row["i"]) == ("2026-01-02", "78", 1.25)
    assert len(list(csv.DictReader(io.StringIO(written(answer, "csv"))))) == 1
    assert json.loads(written(answer.slice(0, 0), "json")) == []


def test_repeated_column_names_are_numbered(results: Path) -> None:
    answer = query("SELECT a.device_id, b.device_id FROM devices a, devices b LIMIT 1", results)
    assert answer.schema.names == ["device_id", "device_id_1"]


def test_unwritable_files_and_unknown_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="the file cannot be written"):
        write_table(pa.table({"a": [1]}), "csv", tmp_path / "nowhere" / "a.csv")
    with pytest.raises(UsageError, match="unknown format: 'xlsx'; allowed: table, csv, json, parquet"):
        write_table(pa.table({"a": [1]}), "xlsx", tmp_path / "a.xlsx")
