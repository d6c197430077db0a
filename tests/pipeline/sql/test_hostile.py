"""A query reads results and nothing else, whatever its SQL says."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from pipeline.errors import GyroscreenError
from pipeline.sql import locked

HOSTILE = [
    "COPY devices TO '{out}'",
    "COPY (SELECT 1) TO '{out}' (FORMAT parquet)",
    "EXPORT DATABASE '{out}'",
    "ATTACH '{out}'",
    "CREATE TABLE t AS SELECT 1",
    "CREATE VIEW devices AS SELECT 1",
    "INSERT INTO devices SELECT * FROM devices",
    "DROP VIEW devices",
    "INSTALL httpfs",
    "LOAD httpfs",
    "SET enable_external_access = true",
    "SET lock_configuration = false",
    "PRAGMA database_list",
    "CALL pragma_version()",
    "EXPLAIN ANALYZE SELECT 1",
    "PREPARE p AS SELECT 1",
    "SELECT * FROM read_csv('{secret}')",
    "SELECT * FROM read_text('{secret}')",
    "SELECT * FROM read_blob('{secret}')",
    "SELECT * FROM read_parquet('{secret}')",
    "SELECT * FROM '{secret}'",
    "SELECT * FROM glob('{secret}*')",
    "SELECT * FROM parquet_metadata('{secret}')",
    "SELECT * FROM read_csv('https://example.org/a.csv')",
    "SELECT * FROM query('COPY devices TO ''{out}''')",
    "WITH x AS (INSERT INTO runs VALUES (1)) SELECT 1",
    "SELECT * FROM python_variable",
]


def answered(sql: str) -> pa.Table:
    """The answer in this process."""
    with locked.connection({"runs": pa.table({"a": [1]})}, 1 << 28) as opened:
        try:
            return locked.batches(opened, sql).read_all()
        except Exception as error:
            raise locked.refused(error, sql) from None


@pytest.mark.parametrize("sql", HOSTILE)
def test_a_query_reads_results_and_nothing_else(tmp_path: Path, sql: str) -> None:
    python_variable = pa.table({"a": [1]})
    secret, out = tmp_path / "secret.csv", tmp_path / "out"
    secret.write_text("a\n1\n")
    with pytest.raises(GyroscreenError):
        answered(sql.format(secret=secret, out=out))
    assert not out.exists()
    assert python_variable.num_rows == 1
