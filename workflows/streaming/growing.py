"""A record as blocks of samples: from a growing file, from standard input, or from a complete file.

The header names the columns: time_s, drive1_V, drive2_V, sense1_V, sense2_V in any order; others are ignored.  Only whole
lines are read, so a writer may be interrupted at any byte.
"""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import MeasurementError
from pipeline.experiment.files.clock import MIN_SAMPLES
from pipeline.experiment.files.columns import assemble, only
from pipeline.experiment.files.readers import FORMATS, existing, read_record
from pipeline.experiment.record import Record

BLOCK = 512
_TEXT = (".csv", ".txt")
_POLL_S = 0.05


@dataclass(frozen=True)
class _Table:
    """Source of the lines, their column names, separator and decimal point, and the number of lines read."""

    name: str
    columns: tuple[str, ...]
    delimiter: str
    decimal: str
    rows: int = 0


def record_blocks(source: Path | TextIO, sample_rate_hz: float | None, patience_s: float) -> Iterator[Record]:
    """Blocks of a record, in order, each a :class:`Record` of its own.

    Parameters
    ----------
    source : file (CSV may grow; other formats are whole) or an open text stream, read until it closes.
    sample_rate_hz : declared f_s; ``None`` takes it from the time stamps of the first block.
    patience_s : a file that has not grown for this time has ended [s].

    Raises
    ------
    MeasurementError : a line that is not a sample, a gap in time, or missing columns.
    """
    if isinstance(source, Path) and existing(source).suffix.lower() not in _TEXT:
        if source.suffix.lower() not in FORMATS:
            raise MeasurementError(
                "not a record of a known format", value=str(source), allowed=", ".join(FORMATS), next_step="convert it"
            )
        yield from _cut(read_record(source, sample_rate_hz))
        return
    lines = _growing(source, patience_s) if isinstance(source, Path) else iter(source.readline, "")
    table, held = _header(lines, source.name if isinstance(source, Path) else "standard input")
    rate, last_time = sample_rate_hz, None
    for rows in _batched(held, lines):
        block, end = _block(table, rows, rate, last_time)
        rate, last_time = float(f"{block.sample_rate_hz:.6g}") if rate is None else rate, end
        table = replace(table, rows=table.rows + len(rows))
        yield replace(block, sample_rate_hz=rate)


def _cut(record: Record) -> Iterator[Record]:
    for first in range(0, record.drive_v.shape[0], BLOCK):
        part = slice(first, first + BLOCK)
        yield replace(record, drive_v=record.drive_v[part], sense_v=record.sense_v[part])


def _growing(path: Path, patience_s: float) -> Iterator[str]:
    """Complete lines of a file as they are written; the file has ended after ``patience_s`` without growth."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rest, waited = "", 0.0
            while waited <= patience_s:
                text = file.read(1 << 16)
                if not text:
                    time.sleep(_POLL_S)
                    waited += _POLL_S
                    continue
                waited = 0.0
                whole, newline, rest = (rest + text).rpartition("\n")
                if newline:
                    yield from io.StringIO(whole + newline)
            if rest.strip():
                yield rest
    except (OSError, UnicodeDecodeError) as error:
        raise MeasurementError(
            f"{path.name}: cannot be read as text",
            value=f"{type(error).__name__}: {error}"[:120],
            allowed="CSV with the columns time_s, drive1_V, drive2_V, sense1_V, sense2_V",
            next_step="check the file and its permissions",
        ) from error


def _header(lines: Iterator[str], name: str) -> tuple[_Table, list[str]]:
    header = next(lines, "").strip().lstrip("\ufeff")
    first = next(lines, "")
    delimiter = max(",;\t", key=header.count)
    columns = tuple(column.strip() for column in header.split(delimiter))
    if "time_s" not in columns or len(set(columns)) != len(columns):
        raise MeasurementError(
            f"{name}: the first line does not name the columns of a record",
            value=header[:80],
            allowed="time_s,drive1_V,drive2_V,sense1_V,sense2_V, each once",
            next_step="write the column names on the first line",
        )
    decimal = "," if delimiter != "," and "," in first else "."
    return _Table(name, columns, delimiter, decimal), [first] if first.strip() else []


def _batched(held: list[str], lines: Iterator[str]) -> Iterator[list[str]]:
    """Lists of BLOCK lines; the last may be longer, so that no block is too short for a record."""
    waiting, rows = list[str](), held
    for line in lines:
        if not line.strip():
            continue
        rows.append(line)
        if len(rows) == BLOCK:
            if waiting:
                yield waiting
            waiting, rows = rows, []
    if len(rows) < MIN_SAMPLES and waiting:
        yield waiting + rows
        return
    yield from (part for part in (waiting, rows) if part)


def _block(
    table: _Table, rows: list[str], sample_rate_hz: float | None, last_time: float | None
) -> tuple[Record, float]:
    """The rows as a record, and its last time stamp."""
    where = f"{table.name}, lines {table.rows + 2} to {table.rows + 1 + len(rows)}"
    numbers = np.empty((len(rows), len(table.columns)))
    for i, row in enumerate(rows):
        try:
            text = row.replace(table.decimal, ".") if table.decimal != "." else row
            numbers[i] = np.array(text.split(table.delimiter), dtype=np.float64)
        except ValueError:
            raise MeasurementError(
                f"{table.name}: line {table.rows + 2 + i} is not a sample",
                value=row.strip()[:80],
                allowed=f"{len(table.columns)} numbers: {', '.join(table.columns)}",
                next_step="correct the line, or stop the record before it",
            ) from None
    columns: dict[str, FloatArray] = {c: np.ascontiguousarray(numbers[:, k]) for k, c in enumerate(table.columns)}
    record = only(assemble(where, [columns], sample_rate_hz))
    first, last = float(columns["time_s"][0]), float(columns["time_s"][-1])
    if last_time is not None and abs((first - last_time) * record.sample_rate_hz - 1.0) > 0.1:
        raise MeasurementError(
            f"{table.name}: time jumps before line {table.rows + 2}",
            value=f"{first - last_time:.6g} s",
            allowed=f"{1.0 / record.sample_rate_hz:.6g} s",
            next_step="stop the record before the gap: gaps cannot be filled",
        )
    return record, last
