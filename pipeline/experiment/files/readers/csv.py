"""CSV with one header line; fields separated by comma, semicolon or tab, with a decimal comma allowed for the latter two."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv

from ....errors import MeasurementError
from ....input_limits import CSV_BYTES_PER_VALUE, CSV_HEADER_BYTES, RECORD_VALUES
from .table import Columns, allow


def _dialect(path: Path) -> tuple[str, str]:
    """Delimiter and decimal mark, from the first two lines."""
    with path.open("rb") as file:
        header = file.readline(CSV_HEADER_BYTES).decode("utf-8-sig")
        first = file.readline(CSV_HEADER_BYTES).decode("utf-8")
    delimiter = max(",;\t", key=header.count)
    if header.count(delimiter) == 0:
        raise MeasurementError(
            "the first line is not a header with several columns",
            value=header[:80],
            allowed="column names such as time_s,drive1_V,sense1_V",
            next_step="write the column names on the first line",
        )
    return delimiter, "," if delimiter != "," and "," in first else "."


def read(path: Path) -> Columns:
    """All columns (N,); columns of text are kept, so that a message can name them.

    Raises
    ------
    MeasurementError : no header, a column name that occurs twice, or more values than the file can hold.
    """
    size = path.stat().st_size
    allow(size // CSV_BYTES_PER_VALUE, 2**62)
    delimiter, decimal = _dialect(path)
    table = pa_csv.read_csv(
        path,
        read_options=pa_csv.ReadOptions(use_threads=False),
        parse_options=pa_csv.ParseOptions(delimiter=delimiter),
        convert_options=pa_csv.ConvertOptions(decimal_point=decimal, strings_can_be_null=False),
    )
    if table.num_rows * table.num_columns > RECORD_VALUES:
        allow(table.num_rows * table.num_columns, size)
    if len(set(table.column_names)) != table.num_columns:
        raise MeasurementError(
            "a column name occurs twice",
            value=table.column_names,
            allowed="a different name for each column",
            next_step="rename or remove one of them",
        )
    return {name.strip(): table.column(name).to_numpy() for name in table.column_names}


def write(path: Path, columns: Columns) -> None:
    """Each number as the shortest text that reads back exactly."""
    pa_csv.write_csv(pa.table(dict(columns)), path)
