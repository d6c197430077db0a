"""Find the layout of a text table: lines before the data, names and units of the columns, delimiter, decimal mark, encoding.

    preamble     any lines: notes of the instrument, comments; key-value lines may state the sample rate
    names        the line above the data with as many fields, if there is one; it may begin with a comment mark
    units        a line between names and data in which every field is a unit
    data         lines with the same number of fields, most of them numbers

The delimiter is the one of tab, semicolon, comma and white space that splits the most lines at the head of the file into the
same number of fields, most of them numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ....errors import MeasurementError
from ....input_limits import CSV_HEADER_BYTES
from ..units import is_unit, of_any_case, with_unit

#: Lines that must look alike for a table to begin; fewer where the file ends before.
_ALIKE = 5
_COMMENT = "#%!;/*'\""
_SAMPLE = re.compile(
    r"(?P<what>(sampl(e|ing)[ _-]*)(rate|frequency|interval|period|time)|delta[_ ]?[xt]|x[ _-]?increment)"
    r"\W{1,12}?(?P<number>[-+]?[0-9.]+([eE][-+]?\d+)?) *(?P<field>[,;\t]?)\s*(?P<unit>[a-zA-Zµ/]*)",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class TextLayout:
    """Layout of a text table.

    Parameters
    ----------
    encoding : "utf-8", "utf-16" or "latin-1".
    delimiter : ",", ";", tab, or " " for any white space.
    decimal : "." or ",".
    skip : number of lines before the data.
    names : of the columns, with their units in brackets; "column1", "column2", .. where the file names none.
    step_s : sample interval that the preamble states [s], or ``None``.
    """

    encoding: str
    delimiter: str
    decimal: str
    skip: int
    names: tuple[str, ...]
    step_s: float | None = None


def fields_of(line: str, delimiter: str) -> list[str]:
    """The fields of a line, without quotation marks and white space around them."""
    parts = line.split() if delimiter == " " else line.split(delimiter)
    return [part.strip().strip('"') for part in parts]


def is_number(field: str, decimal: str) -> bool:
    """Whether a field is a number with this decimal mark."""
    try:
        float(field if decimal == "." else field.replace(",", "."))
    except ValueError:
        return False
    return "_" not in field


def encoding_of(head: bytes) -> str:
    """Encoding of a text by its first bytes; latin-1 where it is not UTF-8, as old instruments write degree and micro signs."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4:  # not a character that the end of the head cuts
            return "latin-1"
    return "utf-8"


def text_layout(path: Path) -> TextLayout:
    """The layout of the table in a text file.

    Raises
    ------
    MeasurementError : no table of numbers at the head of the file.
    """
    with path.open("rb") as file:
        head = file.read(CSV_HEADER_BYTES)
    encoding = encoding_of(head)
    lines = head.decode(encoding, errors="replace").lstrip("\ufeff").split("\n")
    lines = [line.rstrip("\r") for line in (lines[:-1] if len(head) == CSV_HEADER_BYTES else lines)]
    best: tuple[int, int, str, str] | None = None
    for delimiter in ("\t", ";", ",", " "):
        for decimal in (".", ",") if delimiter != "," else (".",):
            start = _start(lines, delimiter, decimal)
            if start is None:
                continue
            fields = fields_of(lines[start], delimiter)
            score = sum(is_number(field, decimal) for field in fields)
            if best is None or score > best[0] or (score == best[0] and start < best[1]):
                best = (score, start, delimiter, decimal)
    if best is None:
        raise MeasurementError(
            "there is no table of numbers at the head of the file, nor a header with several columns",
            value=next((line[:80] for line in lines if line.strip()), ""),
            allowed="lines of numbers with the same number of columns, below a line of names such as time_s,drive1_V,sense1_V",
            next_step="export the samples as a table",
        )
    _, start, delimiter, decimal = best
    count = len(fields_of(lines[start], delimiter))
    return TextLayout(
        encoding, delimiter, decimal, start, _names(lines[:start], delimiter, decimal, count), _step(lines[:start])
    )


def _start(lines: Sequence[str], delimiter: str, decimal: str) -> int | None:
    """Number of the first line of the table with this delimiter and decimal mark."""
    kept = [k for k, line in enumerate(lines) if line.strip()]
    counts = {k: len(fields_of(lines[k], delimiter)) for k in kept}
    for at, k in enumerate(kept):
        if (counts[k] == 1 and delimiter != " ") or not _mostly_numbers(lines[k], delimiter, decimal):
            continue
        # Below a line of names one line is enough: the parser then states which line differs.
        named = at > 0 and _header(lines[kept[at - 1]], delimiter, decimal, counts[k]) is not None and counts[k] > 1
        block = kept[at : at + (1 if named else _ALIKE)]
        if (named or len(block) > 1 or at == 0) and all(
            counts[b] == counts[k] and _mostly_numbers(lines[b], delimiter, decimal) for b in block
        ):
            return k
    return None


def _mostly_numbers(line: str, delimiter: str, decimal: str) -> bool:
    fields = [field for field in fields_of(line, delimiter) if field]
    return 2 * sum(is_number(field, decimal) for field in fields) > len(fields)


def _names(above: Sequence[str], delimiter: str, decimal: str, count: int) -> tuple[str, ...]:
    """Names of ``count`` columns from the lines above the data."""
    named = [line for line in above if line.strip()][-2:]
    rows = [_header(line, delimiter, decimal, count) for line in reversed(named)]
    names = rows[0] if rows else None
    if names is not None and len(rows) > 1 and rows[1] is not None and all(is_unit(n) for n in names if n):
        names = tuple(with_unit(name, unit) for name, unit in zip(rows[1], names))
    if names is None:
        return tuple(f"column{k + 1}" for k in range(count))
    return tuple(name or f"column{k + 1}" for k, name in enumerate(names))


def _header(line: str, delimiter: str, decimal: str, count: int) -> tuple[str, ...] | None:
    """The fields of ``line`` if they can be names or units of ``count`` columns."""
    for text in (line, line.lstrip(_COMMENT + " \t")):
        for mark in dict.fromkeys((delimiter, "\t", ";", ",", " ")):
            fields = fields_of(text, mark)
            # A trailing delimiter in the data gives one more, empty, column.
            fields += [""] * (count - len(fields) if count - len(fields) == 1 else 0)
            if len(fields) == count and not any(is_number(field, decimal) for field in fields if field):
                return tuple(field.lstrip(_COMMENT).strip() if k == 0 else field for k, field in enumerate(fields))
    return None


def _step(above: Sequence[str]) -> float | None:
    """Sample interval [s] from a line such as "Sample Rate: 1000 Hz" or "Delta_X 0.001"."""
    for line in above:
        if match := _SAMPLE.search(line):
            rate = "rate" in match["what"].lower() or "frequency" in match["what"].lower()
            unit = of_any_case(match["unit"])
            if not match["unit"] or (match["field"] and unit is None):
                unit = ("Hz" if rate else "s"), 1.0
            si, factor = unit or ("", 0.0)
            value = factor * (float(match["number"]) if is_number(match["number"], ".") else 0.0)
            if value > 0.0 and si in ("Hz", "s"):
                return 1.0 / value if si == "Hz" else value
    return None
