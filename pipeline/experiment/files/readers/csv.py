"""Text tables: separated by comma, semicolon, tab or white space, with or without names, below any preamble (``text_layout``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from ....errors import MeasurementError
from ....input_limits import CSV_BYTES_PER_VALUE, RECORD_VALUES
from .table import Columns, allow
from .text_layout import TextLayout, text_layout


def read(path: Path) -> Columns:
    """All columns (N,); columns of text are kept, so that a message can name them.

    Units that the file states stand in brackets behind the names.  A sample interval in the preamble becomes ``time_s`` where no
    column is named so.

    Raises
    ------
    MeasurementError : no table, a column name that occurs twice, or more values than the file can hold.
    """
    size = path.stat().st_size
    allow(size // CSV_BYTES_PER_VALUE, 2**62)
    layout = text_layout(path)
    names = layout.names
    if len(set(names)) != len(names):
        raise MeasurementError(
            "a column name occurs twice",
            value=list(names),
            allowed="a different name for each column",
            next_step="rename or remove one of them",
        )
    columns = table_of(path, layout)
    # A delimiter behind the last value of each line makes a column that has neither a name nor values.
    empty = [f"column{k + 1}" for k, name in enumerate(names) if name == f"column{k + 1}"]
    columns = {
        n: v for n, v in columns.items() if n not in empty or v.dtype.kind != "O" or any(x is not None for x in v)
    }
    count = len(next(iter(columns.values())))
    if count * len(names) > RECORD_VALUES:
        allow(count * len(names), size)
    if layout.step_s is not None and not any(name.lower().startswith(("time", "t [", "x_value")) for name in names):
        columns["time_s"] = np.arange(count) * layout.step_s
    return columns


def table_of(path: Path, layout: TextLayout) -> Columns:
    """The columns (N,) of the table in ``path`` that has this ``layout``."""
    return _by_white_space(path, layout) if layout.delimiter == " " else _delimited(path, layout)


def _delimited(path: Path, layout: TextLayout) -> Columns:
    table = pa_csv.read_csv(
        path,
        read_options=pa_csv.ReadOptions(
            use_threads=False, encoding=layout.encoding, skip_rows=layout.skip, column_names=list(layout.names)
        ),
        parse_options=pa_csv.ParseOptions(delimiter=layout.delimiter),
        convert_options=pa_csv.ConvertOptions(decimal_point=layout.decimal, strings_can_be_null=False),
    )
    return {name: table.column(name).to_numpy() for name in layout.names}


def _by_white_space(path: Path, layout: TextLayout) -> Columns:
    # Only pandas splits at any white space in compiled code; it takes a quarter of a second to import.
    import pandas as pd

    table = pd.read_csv(
        path,
        sep=r"\s+",
        header=None,
        names=list(layout.names),
        skiprows=layout.skip,
        encoding=layout.encoding,
        decimal=layout.decimal,
        index_col=False,
    )
    return {name: table[name].to_numpy() for name in layout.names}


def write(path: Path, columns: Columns) -> None:
    """Each number as the shortest text that reads back exactly."""
    pa_csv.write_csv(pa.table(dict(columns)), path)
