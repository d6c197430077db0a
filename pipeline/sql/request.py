"""What is said to the process of a query, and what it answers; see process.py."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, BinaryIO

import pyarrow as pa

from .. import errors

#: The first byte of an answer: the process is about to begin with the statement.
READY = b"\n"
#: Tables that follow a request: files, devices, posterior and irregularities (empty, for their schemas), runs, columns.
TABLES = 6


@dataclass(frozen=True)
class Question:
    """A statement and its limits: memory of the process and size of the answer [bytes], rows to send (``None``: all)."""

    sql: str
    memory_bytes: int
    answer_bytes: int
    rows: int | None = None

    def line(self) -> bytes:
        """The first line of stdin."""
        return json.dumps(asdict(self)).encode() + b"\n"


def file_schema() -> pa.Schema:
    """Schema of the table of files: their view, run, path and the hashes that are accepted."""
    text = pa.string()
    return pa.schema([("view", text), ("run_id", text), ("path", text), ("sha256", pa.list_(text))])


def write_table(sink: BinaryIO, table: pa.Table) -> None:
    """Write one Arrow stream."""
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)


def error_of(parts: list[Any]) -> errors.GyroscreenError:
    """The error that the process reported."""
    name, what, value, allowed, next_step = parts
    kind: type[errors.GyroscreenError] = getattr(errors, name)
    return kind(what, value=value, allowed=allowed, next_step=next_step)


def too_much_memory(sql: str) -> errors.UsageError:
    """The error of a query that reached its limit of memory."""
    return errors.UsageError(
        "the query needs more memory than it may take",
        value=sql,
        next_step="request less: fewer columns, one run, no cross join; aggregate where that is enough",
    )
