"""Hostile SQL against a run: time, peak memory, and whether anything outside the results was read or written.

    python tests/measure/hostile_sql.py OUT.jsonl [--seconds 20] [--memory 2GB]

Each statement runs in a process of its own, as `gyroscreen query` runs it. OUT.jsonl has one line a statement; a study that was
interrupted continues there. A statement is harmless if its answer does not contain the secret that lies beside the results, no
file was made, changed or removed, and time and peak memory stay within the limits.
"""

# ruff: noqa: E402, E501 - packages beside this file; one statement a place
from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "pipeline" / "store")]

from store_runs import make_run

from pipeline.errors import GyroscreenError
from pipeline.store import query as queries

SECRET = "a9f4-the-secret"
_READERS = (
    "read_csv",
    "read_csv_auto",
    "read_text",
    "read_blob",
    "read_json",
    "read_json_auto",
    "read_ndjson",
    "read_parquet",
)
_MORE = (
    "read_json_objects",
    "read_ndjson_objects",
    "read_ndjson_auto",
    "read_duckdb",
    "parquet_scan",
    "sniff_csv",
    "glob",
)
_PARQUET = ("parquet_metadata", "parquet_schema", "parquet_file_metadata", "parquet_kv_metadata", "parquet_bloom_probe")
_PLACES = ("{secret}", "{folder}/*", "/etc/passwd", "/proc/self/environ", "https://127.0.0.1/x.csv", "s3://bucket/x")


def _readers() -> Iterator[str]:
    for name in (*_READERS, *_MORE):
        for place in _PLACES[: 4 if name in _READERS else 2]:
            yield f"SELECT * FROM {name}('{place}')"
    for name in _PARQUET:
        yield f"SELECT * FROM {name}('{{table}}')"
    for place in _PLACES:
        yield f"SELECT * FROM '{place}'"
        yield f"SELECT * FROM query('SELECT * FROM read_text(''{place}'')')"
    yield "SELECT * FROM query('SELECT * FROM read_' || 'text(''{secret}'')')"
    yield "SELECT * FROM query_table('{secret}')"
    yield "SELECT * FROM query_table(['devices', '{secret}'])"
    yield 'SELECT * FROM "{secret}"'
    yield "SELECT (SELECT content FROM read_text('{secret}'))"
    yield "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r, read_text('{secret}')) SELECT * FROM r"
    yield "SELECT getenv('HOME')"
    yield "SELECT getvariable('HOME')"
    yield "SELECT * FROM duckdb_secrets()"
    yield "SELECT * FROM which_secret('s3://x', 's3')"
    yield "SELECT * FROM json_execute_serialized_sql(json_serialize_sql('SELECT * FROM read_text(''{secret}'')'))"
    yield "SELECT json_serialize_sql('SELECT * FROM read_text(''{secret}'')')"
    yield "SELECT * FROM read_csv('{sec' || 'ret}')"
    yield "SELECT * FROM read_text('/dev/stdin')"
    yield "SELECT * FROM read_text('/dev/zero')"
    yield "SELECT * FROM read_csv('|cat {secret}')"
    yield "SELECT * FROM python_variable"
    yield "SELECT * FROM tables"
    yield "SELECT * FROM ｒead_text('{secret}')"
    yield "SELECT * FROM read\u200b_text('{secret}')"
    yield "SELECT * FROM U&\"\\0072ead_text\"('{secret}')"
    yield "SELECT/**/*/**/FROM/**/read_text('{secret}')"
    yield "FROM read_text('{secret}') SELECT *"
    yield "FROM 'file://{secret}'"
    yield "DESCRIBE SELECT * FROM read_csv('{secret}')"
    yield "SUMMARIZE FROM read_csv('{secret}')"
    yield "PIVOT (FROM read_csv('{secret}')) ON a USING count(*)"
    yield "SELECT * FROM devices AT (TIMESTAMP => read_text('{secret}'))"


def _writers() -> Iterator[str]:
    for what in ("devices", "(SELECT 1)", "(FROM runs)"):
        for form in ("csv", "parquet", "json"):
            yield f"COPY {what} TO '{{out}}' (FORMAT {form})"
    yield from (
        "COPY (SELECT 1) TO '/dev/stdout'", "COPY devices FROM '{secret}'", "EXPORT DATABASE '{out}'", "IMPORT DATABASE '{folder}'",
        "ATTACH '{out}'", "ATTACH '{out}' AS o (TYPE duckdb)", "ATTACH ':memory:' AS m", "DETACH memory", "USE memory", "CHECKPOINT",
        "CREATE TABLE t AS SELECT 1", "CREATE TEMP TABLE t AS SELECT 1", "CREATE VIEW devices AS SELECT 1", "CREATE MACRO f(a) AS a",
        "CREATE SECRET s (TYPE s3)", "CREATE PERSISTENT SECRET s (TYPE s3)", "CREATE SCHEMA s", "CREATE SEQUENCE s", "CREATE TYPE t AS INT",
        "DROP VIEW devices", "DROP TABLE runs", "ALTER VIEW devices RENAME TO d", "INSERT INTO runs VALUES (1)", "DELETE FROM runs",
        "UPDATE runs SET seed = 1", "MERGE INTO runs USING devices ON true WHEN MATCHED THEN DELETE", "TRUNCATE runs", "VACUUM", "ANALYZE",
        "INSTALL httpfs", "LOAD httpfs", "FORCE INSTALL httpfs", "INSTALL spatial FROM community", "LOAD '{secret}'", "UPDATE EXTENSIONS",
        "SET enable_external_access = true", "SET lock_configuration = false", "RESET lock_configuration", "SET memory_limit = '90GB'",
        "SET threads = 64", "SET temp_directory = '{folder}'", "SET home_directory = '{folder}'", "SET GLOBAL allowed_directories = ['/']",
        "SET python_enable_replacements = true", "SET custom_extension_repository = 'http://127.0.0.1'", "SET VARIABLE a = 1",
        "SET log_query_path = '{out}'", "SET profiling_output = '{out}'", "SET enable_logging = true", "SET logging_storage = 'file'",
        "PRAGMA database_list", "PRAGMA enable_profiling", "PRAGMA enable_profiling='json'", "PRAGMA disable_checkpoint_on_shutdown",
        "CALL pragma_version()", "CALL enable_logging(storage = 'file', storage_path = '{out}')", "EXPLAIN ANALYZE SELECT 1", "PREPARE p AS SELECT 1",
        "EXECUTE p", "DEALLOCATE p", "BEGIN", "COMMIT", "ROLLBACK", "SELECT 1; COPY (SELECT 1) TO '{out}'", "SELECT 1;;;SELECT 2",
        "WITH x AS (INSERT INTO runs VALUES (1)) SELECT 1", "SELECT * FROM query('COPY devices TO ''{out}''')", "SELECT write_log('x', scope := 'connection')",
        "SELECT set_config('memory_limit', '90GB')", "SELECT nextval('s')", "COMMENT ON VIEW devices IS 'x'",
    )  # fmt: skip


def _greedy() -> Iterator[str]:
    deep = 2000
    yield from (
        "SELECT length(repeat('x', 3000000000))", "SELECT repeat('x', 3000000000)", "SELECT repeat(repeat('x', 100000), 100000)",
        "SELECT length(repeat(theta_deg::VARCHAR, 1000000000)) FROM devices", "SELECT lpad('x', 2000000000, 'y')",
        "SELECT string_agg(repeat('x', 1000000), '') FROM range(100000)", "SELECT list(range) FROM range(1000000000)",
        "SELECT len(range(5000000000))", "SELECT len(generate_series(1, 5000000000))", "SELECT range(100000000) FROM range(100)",
        "SELECT count(*) FROM range(10000000) a, range(10000000) b WHERE hash(a.range) % 7 = hash(b.range) % 3",
        "SELECT count(*) FROM devices a, devices b, devices c, devices d, devices e, devices f, devices g, devices h, posterior p, posterior q",
        "SELECT * FROM range(100000) a, range(100000) b", "SELECT * FROM range(1000000000)", "SELECT sum(range) FROM range(100000000000)",
        "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT count(*) FROM r",
        "WITH RECURSIVE r AS (SELECT 'x' AS s UNION ALL SELECT s || s FROM r) SELECT max(length(s)) FROM r",
        "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + k FROM r, range(10) t(k)) SELECT count(*) FROM r",
        "SELECT range AS a FROM range(200000000) ORDER BY hash(range)", "SELECT DISTINCT hash(range) FROM range(1000000000)",
        "SELECT hash(range) AS h, count(*) FROM range(1000000000) GROUP BY h", "SELECT median(hash(range)) FROM range(1000000000)",
        "SELECT row_number() OVER (ORDER BY hash(range)) FROM range(1000000000)", "SELECT 10::HUGEINT ** 1000000", "SELECT factorial(100000)",
        "SELECT regexp_matches(repeat('a', 1000000), '(a*)*b')", "SELECT regexp_replace(repeat('a', 100000000), 'a', 'bbbbbbbbbb', 'g')",
        "SELECT levenshtein(repeat('a', 100000), repeat('b', 100000))", "SELECT jaro_similarity(repeat('a', 1000000), repeat('ab', 1000000))",
        "SELECT bit_count(repeat('1', 1000000000)::BIT)", "SELECT from_base64(repeat('QUFB', 500000000))", "SELECT format('{{:>2000000000}}', 'x')",
        "SELECT printf('%2000000000d', 1)", "SELECT string_split(repeat('a,', 300000000), ',')", "SELECT unnest(range(1000000000))",
        "SELECT list_transform(range(100000000), x -> list_sum(range(100)))", "SELECT list_reduce(range(100000000), (a, b) -> a + b)",
        "SELECT array_agg(d) FROM devices d, range(1000000) r", "SELECT map(range(100000000), range(100000000))", "SELECT histogram(range) FROM range(300000000)",
        "SELECT json_object('a', repeat('x', 1000000000))", "SELECT to_json(range(100000000))", "SELECT '[' || repeat('[', 1000000) AS j, j::JSON",
        "SELECT json_structure(repeat('[', 1000000))", "SELECT list_sort(range(300000000)) ", "SELECT md5(repeat('x', 2000000000))",
        "SELECT approx_quantile(range, 0.5) FROM range(10000000000)", "SELECT mode(range % 1000000007) FROM range(1000000000)",
    )  # fmt: skip
    yield "SELECT " + "(" * deep + "1" + ")" * deep
    yield "SELECT " + "abs(" * deep + "1" + ")" * deep
    yield "SELECT " + " + ".join(["1"] * 100_000)
    yield "SELECT " + "NOT " * 50_000 + "true"
    yield "SELECT " + ", ".join(f"{n} AS c{n}" for n in range(50_000))
    yield "SELECT * FROM " + "(SELECT * FROM " * 500 + "devices" + ")" * 500
    yield " UNION ALL ".join(["SELECT 1"] * 20_000)
    yield "SELECT CASE " + " ".join(f"WHEN range = {n} THEN {n}" for n in range(20_000)) + " END FROM range(10)"
    yield "SELECT * FROM " + ", ".join(f"devices d{n}" for n in range(60))
    yield "SELECT '" + "x" * 5_000_000 + "'"
    yield "SELECT [" * deep + "]" * deep
    yield "SELECT 1 IN (" + ",".join(map(str, range(300_000))) + ")"
    yield (
        "WITH "
        + ", ".join(f"c{n} AS (SELECT * FROM {'devices' if n == 0 else f'c{n - 1} a, c{n - 1} b'})" for n in range(30))
        + " SELECT 1 FROM c29"
    )
    yield "\x00SELECT 1"
    yield "SELECT '\udc80'"
    yield "SELECT \u202e1"


def statements() -> list[str]:
    """All statements, with {secret}, {folder}, {out} and {table} for places."""
    return [*_readers(), *_writers(), *_greedy()]


def study(out: Path, seconds: float, memory: str) -> None:
    """Run what ``out`` does not have yet, and print the figures."""
    done = {json.loads(line)["number"] for line in out.read_text().splitlines()} if out.exists() else set()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results = folder / "results"
        make_run(results, "one")
        secret = folder / "secret.csv"
        secret.write_text(f"a\n{SECRET}\n")
        os.environ["HOME_SECRET"] = SECRET
        places = {
            "secret": secret,
            "folder": folder,
            "out": folder / "out",
            "table": results / "run=one" / "devices-00000.parquet",
        }
        for number, sql in enumerate(statements()):
            if number not in done:
                for place, path in places.items():
                    sql = sql.replace(f"{{{place}}}", str(path))
                row = {"number": number, **_tried(sql, results, folder, seconds, memory)}
                with out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    show([json.loads(line) for line in out.read_text().splitlines()], seconds)


def _tried(sql: str, results: Path, folder: Path, seconds: float, memory: str) -> dict[str, Any]:
    before, started = _tree(folder), time.monotonic()
    made: list[Any] = []

    class Watched(queries.QueryProcess):
        def __init__(self) -> None:
            super().__init__()
            made.append(self)

    plain, queries.QueryProcess = queries.QueryProcess, Watched  # type: ignore[misc]
    try:
        answer = queries.answer(sql, results, timeout_s=seconds, memory_limit=memory, rows=1000).table
        leaked, outcome = (
            SECRET in str(answer.slice(0, 100).to_pylist()) or "root:" in str(answer.slice(0, 100).to_pylist()),
            "answered",
        )
    except GyroscreenError as error:
        leaked, outcome = SECRET in str(error) or "root:" in str(error), f"{type(error).__name__}: {error.what}"
    except Exception as error:
        leaked, outcome = False, f"UNTYPED {type(error).__name__}: {error}"
    finally:
        queries.QueryProcess = plain  # type: ignore[misc]
    return {
        "sql": sql[:100],
        "outcome": outcome[:200],
        "leaked": leaked,
        "written": _tree(folder) != before,
        "seconds": round(time.monotonic() - started, 2),
        "peak_mb": round(max((one.peak_bytes for one in made), default=0) / 1e6),
    }


def _tree(folder: Path) -> list[tuple[str, int, int]]:
    return [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(folder.rglob("*")) if p.is_file()]


def show(rows: list[dict[str, Any]], seconds: float) -> None:
    """Print the figures."""
    print(f"{len(rows)} statements; answered {sum(r['outcome'] == 'answered' for r in rows)}")
    for name in ("leaked", "written"):
        print(f"{name}: {sum(r[name] for r in rows)}")
    print(f"untyped errors: {sum(r['outcome'].startswith('UNTYPED') for r in rows)}")
    print(
        f"longest {max(r['seconds'] for r in rows):.1f} s (limit {seconds:g} s and the start), most {max(r['peak_mb'] for r in rows)} MB"
    )
    for row in sorted(rows, key=lambda r: -r["peak_mb"])[:5]:
        print(f"  {row['peak_mb']} MB {row['seconds']} s {row['outcome'][:60]} | {row['sql'][:60]}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--memory", default="2GB")
    given = parser.parse_args()
    study(given.out, given.seconds, given.memory)
