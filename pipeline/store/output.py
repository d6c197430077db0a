"""Output of tables as fixed-width text, CSV, JSON or Parquet."""

from __future__ import annotations

import io
import json
import math
from datetime import date, datetime, time
from decimal import Decimal
from pathlib import Path
from typing import Any, BinaryIO, Literal, get_args

import pyarrow as pa
import pyarrow.csv as pacsv

from ..errors import UsageError, printable
from .files import replace_file
from .parquet import encode_table

Format = Literal["table", "csv", "json", "parquet"]
FORMATS: tuple[str, ...] = get_args(Format)


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
    data = {"table": _text, "csv": _csv, "json": _json, "parquet": _parquet}[format](table)
    if not isinstance(out, Path):
        out.write(data)
        return
    try:
        replace_file(out.absolute().parent, out.name, data)
    except OSError as error:
        raise UsageError(f"cannot write the file ({error.strerror})", value=str(out)) from None


def _text(table: pa.Table) -> bytes:
    """Header with names and units, a rule, then the rows; numbers right-aligned, text left-aligned."""
    columns: list[list[str]] = []
    for field in table.schema:
        unit = (field.metadata or {}).get(b"unit", b"").decode()
        cells = [_cell(value) for value in table.column(len(columns)).to_pylist()]
        number = pa.types.is_floating(field.type) or pa.types.is_integer(field.type) or pa.types.is_decimal(field.type)
        heads = [printable(field.name), f"[{unit}]" if unit not in ("", "1") else ""]
        width = max(len(word) for word in (*heads, *cells))
        align = str.rjust if number else str.ljust
        columns.append([*(align(head, width) for head in heads), "-" * width, *(align(cell, width) for cell in cells)])
    lines = ["  ".join(row).rstrip() for row in zip(*columns)]
    if len(lines) > 1 and not lines[1]:
        del lines[1]
    return ("\n".join(lines) + f"\n({table.num_rows} row{'' if table.num_rows == 1 else 's'})\n").encode()


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.8g}"
    return printable(value if isinstance(value, str) else str(_plain(value)))


def _csv(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    flat = [
        column
        if not (pa.types.is_nested(column.type) or pa.types.is_binary(column.type) or pa.types.is_interval(column.type))
        else pa.array([None if v is None else json.dumps(_plain(v)) for v in column.to_pylist()], pa.string())
        for column in table.columns
    ]
    pacsv.write_csv(pa.table(flat, names=table.schema.names), sink)
    return sink.getvalue()


def _json(table: pa.Table) -> bytes:
    rows = ",\n".join(json.dumps(_plain(row), ensure_ascii=False, allow_nan=False) for row in table.to_pylist())
    return f"[\n{rows}\n]\n".encode()


def _parquet(table: pa.Table) -> bytes:
    try:
        return encode_table(table).to_pybytes()
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
