"""LabVIEW measurement text (.lvm): a header of keys, then a table; times follow from X_Value or from Delta_X.

    LabVIEW Measurement .. ***End_of_Header***      keys of the file: Separator, Decimal_Separator, X_Columns
    Y_Unit_Label, Delta_X, .. ***End_of_Header***   keys of the channels, one value for each
    X_Value  name  name  ..  Comment
    numbers

Source: NI, Specification for the LabVIEW Measurement File (.lvm).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....errors import MeasurementError
from ....input_limits import CSV_BYTES_PER_VALUE, CSV_HEADER_BYTES
from ..units import with_unit
from . import csv
from .table import Columns, allow
from .text_layout import TextLayout, encoding_of

_END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ","}


def read(path: Path) -> Columns:
    """Channels (N,) by name with their units, and ``X_Value [s]``.

    Channels that are shorter than the longest, such as results that LabVIEW states once for a block, are left out.

    Raises
    ------
    MeasurementError : not this format, several tables in one file, or more values than the file can hold.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(CSV_HEADER_BYTES)
    encoding = encoding_of(head)
    lines = [line.rstrip("\r") for line in head.decode(encoding, errors="replace").split("\n")]
    ends = [k for k, line in enumerate(lines) if line.startswith(_END)]
    if not lines[0].startswith("LabVIEW Measurement") or len(ends) < 2 or ends[1] + 2 >= len(lines):
        raise MeasurementError(
            "the file is not a LabVIEW measurement with a header for the file and one for its channels",
            value=lines[0][:80],
            allowed="LabVIEW Measurement, keys, ***End_of_Header***, twice, and a table",
            next_step="export it again, or rename it to .txt if it is a plain table",
        )
    mark = _mark(lines)
    general = {key: rest for key, _, rest in (line.partition(mark) for line in lines[: ends[0]])}
    if general.get("Multi_Headings", "No").strip().startswith("Yes") and _tables(path) > 2:
        raise MeasurementError(
            "the file holds several tables",
            allowed="one table per file (Multi_Headings No)",
            next_step="write one header only, or one file per segment",
        )
    keys = {line.split(mark)[0]: line.split(mark)[1:] for line in lines[ends[0] + 1 : ends[1]]}
    names = [name.strip() for name in lines[ends[1] + 1].split(mark)]
    units = [unit.strip() for unit in keys.get("Y_Unit_Label", [])]
    width = len(lines[ends[1] + 2].split(mark))
    names = [name or f"column{k + 1}" for k, name in enumerate([*names, *[""] * width][:width])]
    names[1:] = [with_unit(name, unit) for name, unit in zip(names[1:], [*units, *[""] * width])]
    names[0] = "X_Value [s]"
    allow(size // CSV_BYTES_PER_VALUE, 2**62)
    decimal = general.get("Decimal_Separator", ".").strip()[:1] or "."
    table = csv.table_of(path, TextLayout(encoding, mark, decimal, ends[1] + 2, tuple(names)))
    whole = {
        name: values
        for name, values in table.items()
        if values.dtype.kind in "fiu" and np.isfinite(values[1:]).all() and name != "Comment"
    }
    if general.get("X_Columns", "One").strip().startswith("No"):
        step = float(keys["Delta_X"][0])
        whole["X_Value [s]"] = np.arange(len(next(iter(table.values())))) * step
    return whole


def _mark(lines: list[str]) -> str:
    for line in lines:
        if line.startswith("Separator"):
            return _SEPARATORS.get(line[len("Separator") :].strip(), "\t")
    return "\t"


def _tables(path: Path) -> int:
    """Number of header ends in the file."""
    with path.open("rb") as file:
        return sum(line.startswith(_END.encode()) for line in file)
