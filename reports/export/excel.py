"""A workbook for Excel: sheets with a header of names and units that stays in view; numbers are numbers, text is text.

Rows are written one after the other, so that a large run needs no more memory than a small one.
Limits: Microsoft, "Excel specifications and limits": 1,048,576 rows, 16,384 columns, 32,767 characters a cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

from pipeline.errors import ConfigError, UsageError

MOST_ROWS = 1_048_576 - 2
_TEXT = 32_767
#: Width of a column [characters].
_NARROW, _WIDE = 11, 40


@dataclass(frozen=True, eq=False)
class Sheet:
    """A sheet: names and units of its columns, and ``rows`` of numbers, texts and ``None`` (an empty cell), read once."""

    name: str
    columns: Sequence[str]
    units: Sequence[str]
    rows: Iterable[Sequence[Any]]
    number: int


def write_workbook(sheets: Sequence[Sheet], out: BinaryIO) -> None:
    """Write the sheets; infinities become text, because Excel has none.

    Raises
    ------
    ConfigError : XlsxWriter is not installed.
    UsageError : more rows than a sheet can hold.
    """
    try:
        from xlsxwriter import Workbook
    except ImportError:
        raise ConfigError(
            "Excel files need the package XlsxWriter, which is not installed",
            allowed="the extra [excel]",
            next_step='pip install "gyroscreen[excel]", or export as csv',
        ) from None
    for sheet in sheets:
        if sheet.number > MOST_ROWS:
            raise UsageError(
                f"the sheet {sheet.name} would have too many rows",
                value=sheet.number,
                allowed=f"at most {MOST_ROWS}",
                next_step="export as csv",
            )
    with Workbook(out, {"constant_memory": True, "strings_to_formulas": False, "strings_to_urls": False}) as book:
        bold, grey = book.add_format({"bold": True}), book.add_format({"italic": True, "font_color": "#66727f"})
        for sheet in sheets:
            page = book.add_worksheet(sheet.name)
            page.freeze_panes(2, 1)
            page.set_column(0, len(sheet.columns) - 1, _NARROW)
            for k, name in enumerate(sheet.columns):
                page.write_string(0, k, name, bold)
                if name == "meaning":
                    page.set_column(k, k, _WIDE)
            for k, unit in enumerate(sheet.units):
                page.write_string(1, k, "" if unit == "1" else unit, grey)
            for i, row in enumerate(sheet.rows, 2):
                for k, value in enumerate(row):
                    _write(page, i, k, value)


def _write(page: Any, i: int, k: int, value: Any) -> None:
    if value is None or value == "":
        return
    if isinstance(value, str):
        page.write_string(i, k, value[:_TEXT])
    elif isinstance(value, float) and not math.isfinite(value):
        if not math.isnan(value):
            page.write_string(i, k, str(value))
    else:
        page.write_number(i, k, value)
