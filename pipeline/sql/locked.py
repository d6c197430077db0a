"""DuckDB without access to files, network, Python variables or its own settings; it accepts exactly one SELECT."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import duckdb
import pyarrow as pa

from ..errors import GyroscreenError, IntegrityError, UsageError
from .request import too_much_memory

_LOCKS = (
    "python_enable_replacements = false",
    "autoinstall_known_extensions = false",
    "autoload_known_extensions = false",
    "allow_community_extensions = false",
    "enable_external_access = false",
)
_COLUMNS_QUERY = "`SELECT name, unit, meaning FROM columns` lists all columns"


@contextmanager
def connection(views: Mapping[str, Any], memory_bytes: int) -> Iterator[duckdb.DuckDBPyConnection]:
    """A locked connection with these views, each a pyarrow table or dataset."""
    # No spilling to disk: the temporary folder cannot be set once external access is off.
    opened = duckdb.connect(":memory:", config={"temp_directory": ""})
    try:
        opened.execute(f"SET memory_limit = '{memory_bytes}B'")
        for setting in _LOCKS:
            opened.execute(f"SET {setting}")
        for name, view in views.items():
            opened.register(name, view)
        opened.execute("SET lock_configuration = true")
        yield opened
    finally:
        opened.close()


def batches(opened: duckdb.DuckDBPyConnection, sql: str) -> pa.RecordBatchReader:
    """The answer to one SELECT, computed while it is read; errors as :func:`refused` makes them are raised by both."""
    return pa.RecordBatchReader.from_stream(opened.sql(_one_select(opened, sql).query))


def _one_select(opened: duckdb.DuckDBPyConnection, sql: str) -> duckdb.Statement:
    statements = opened.extract_statements(sql)
    if len(statements) != 1:
        raise UsageError(
            f"found {len(statements)} SQL statements",
            value=sql,
            allowed="one",
            next_step="run one statement at a time",
        )
    if statements[0].type != duckdb.StatementType.SELECT:
        raise UsageError(
            f"queries only read results, but this is a statement of type {statements[0].type.name}",
            value=sql,
            allowed="one SELECT",
            next_step="to save a result use --format csv, json or parquet; PIVOT needs its IN list",
        )
    return statements[0]


def refused(error: BaseException, sql: str) -> GyroscreenError:
    """The typed error for any exception of DuckDB, the Arrow scan or a limit of the process, with DuckDB's own hint."""
    if isinstance(error, GyroscreenError):
        return error
    if isinstance(error, (duckdb.OutOfMemoryException, MemoryError)) or _of_memory(str(error)):
        return too_much_memory(sql)
    message = " ".join(line.strip() for line in str(error).split("\n\nLINE ")[0].splitlines() if line.strip())
    if isinstance(error, (pa.ArrowException, OSError)) or "checksum" in message or "CRC" in message:
        return IntegrityError(f"results cannot be read ({message})", next_step="run `gyroscreen verify`")
    if isinstance(error, duckdb.PermissionException):
        return UsageError(
            f"a query can read stored results only ({message})",
            value=sql,
            allowed="the views devices, posterior, irregularities, runs, columns",
        )
    return UsageError(
        message,
        value=sql,
        allowed="one SELECT on devices, posterior, irregularities, runs, columns",
        next_step=_COLUMNS_QUERY,
    )


def _of_memory(message: str) -> bool:
    """Whether an exception says that an allocation failed; DuckDB passes on several of these as other types."""
    return any(words in message for words in ("Out of Memory", "bad_alloc", "malloc of size", "Failed to allocate"))
