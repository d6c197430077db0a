"""Output of tables as fixed-width text, CSV, JSON or Parquet."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Sequence
from datetime import date, datetime, time
from decimal import Decimal
from pathlib import Path
from typing import Any, BinaryIO, Literal, get_args

import pyarrow as pa
import pyarrow.csv as pacsv

from ..errors import UsageError, printable, unwritable
from .files import replacing
from .parquet import encode_table

Format = Literal["table", "csv", "json", "parquet"]
FORMATS: tuple[str, ...] = get_args(Format)
#: Rows that are Python objects at a time.
_ROWS = 10_000


def write_table(table: pa.Table, format: str, out: BinaryIO | Path) -> None:
    """Write a table.

    Parameters
    ----------
    table : the result of a query.
    format : "table", fixed-width text with the units under the names and 8 significant digits; "csv" and
        "json" (a list of objects), at full precision; "parquet", with units in the field metadata.
        A null is written as ``-``, an empty field or ``null``.  Infinities in JSON are the texts "inf", "-inf".
    out : a binary stream, or a file, which is then replaced as a whole.

    Raises
    ------
    UsageError : an unknown format, or the file cannot be written.
    """
    if format not in FORMATS:
        raise UsageError("unknown format", value=format, allowed=", ".join(FORMATS))
    write = {"table": _text, "csv": _csv, "json": _json, "parquet": _parquet}[format]
    if not isinstance(out, Path):
        write(table, out)
        return
    try:
        with replacing(out.absolute().parent, out.name) as file:
            write(table, file)
    except OSError as error:
        raise unwritable("the file", out, error) from None


def _parts(table: pa.Table) -> Iterator[pa.Table]:
    """The table in parts that are small as Python objects."""
    return (table.slice(first, _ROWS) for first in range(0, table.num_rows, _ROWS))


def _text(table: pa.Table, sink: BinaryIO) -> None:
    """Header with names and units, a rule, then the rows; numbers right-aligned, text left-aligned."""
    units = [(field.metadata or {}).get(b"unit", b"").decode() for field in table.schema]
    heads = [
        [printable(field.name) for field in table.schema],
        [f"[{unit}]" if unit not in ("", "1") else "" for unit in units],
    ]
    widths = [max(map(len, column)) for column in zip(*heads)]
    for part in _parts(table):
        widths = [max(width, *map(len, cells)) for width, cells in zip(widths, _cells(part))]
    align = [str.rjust if _is_number(field.type) else str.ljust for field in table.schema]

    def line(cells: Sequence[str]) -> bytes:
        return ("  ".join(one(cell, width) for one, cell, width in zip(align, cells, widths)).rstrip() + "\n").encode()

    rule = ["-" * width for width in widths]
    for row in (heads[0], *([heads[1]] if any(heads[1]) else []), rule):
        sink.write(line(row))
    for part in _parts(table):
        sink.writelines(line(row) for row in zip(*_cells(part)))
    sink.write(f"({table.num_rows} row{'' if table.num_rows == 1 else 's'})\n".encode())


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind))


def _cells(table: pa.Table) -> list[list[str]]:
    """The cells of each column as text."""
    return [[_cell(value) for value in column.to_pylist()] for column in table.columns]


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.8g}"
    return printable(value if isinstance(value, str) else str(_plain(value)))


def _csv(table: pa.Table, sink: BinaryIO) -> None:
    for first, part in enumerate(_parts(table)) if table.num_rows else ((0, table),):
        flat = [
            column
            if not (
                pa.types.is_nested(column.type) or pa.types.is_binary(column.type) or pa.types.is_interval(column.type)
            )
            else pa.array([None if v is None else json.dumps(_plain(v)) for v in column.to_pylist()], pa.string())
            for column in part.columns
        ]
        options = pacsv.WriteOptions(include_header=first == 0)
        buffer = io.BytesIO()
        pacsv.write_csv(pa.table(flat, names=table.schema.names), buffer, options)
        sink.write(buffer.getbuffer())


def _json(table: pa.Table, sink: BinaryIO) -> None:
    before = "[\n"
    for part in _parts(table):
        for row in part.to_pylist():
            sink.write((before + json.dumps(_plain(row), ensure_ascii=False, allow_nan=False)).encode())
            before = ",\n"
    sink.write(b"\n]\n" if table.num_rows else b"[\n\n]\n")


def _parquet(table: pa.Table, sink: BinaryIO) -> None:
    try:
        sink.write(memoryview(encode_table(table)))
    except pa.ArrowException as error:
        raise UsageError(
            f"Parquet cannot hold this answer ({error})", next_step="cast the column, or use csv"
        ) from None


def _plain(value: Any) -> Any:
    """Value as JSON without loss: NaN becomes null, infinity a string, an integral decimal an integer."""
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return value if math.isfinite(value) else str(value)
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, (datetime, date, time)):
        return value.isoformat()
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value if isinstance(value, (str, int, bool, type(None))) else str(value)
