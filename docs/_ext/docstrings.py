"""Docstrings of this project as reStructuredText: "Parameters", "Raises" and "Example" with a line of dashes below.

A section of parameters has one entry per line, ``names : meaning``, continued by indented lines; the types are in the signature.
"""

import re
from collections.abc import Iterator
from typing import Any

from sphinx.application import Sphinx

#: An array in a signature, which autodoc writes out in full.
_ARRAY = re.compile(
    r"(?:[\w.~]*\.|~)?ndarray\[(?:[\w.~]*\.|~)?tuple\[(?:[\w.~]*\.|~)?Any, \.\.\.\], "
    r"(?:[\w.~]*\.|~)?dtype\[(?:[\w.~]*\.|~)?(float64|complex128|int64|bool)\]\]"
)
_ARRAYS = {"float64": "FloatArray", "complex128": "ComplexArray", "int64": "IntArray", "bool": "BoolArray"}
_LISTS = ("Parameters", "Raises", "Attributes")


def _entries(lines: list[str]) -> Iterator[tuple[str, str]]:
    """(names, meaning) of each entry of a section."""
    names, meaning = "", []
    for line in [*lines, "end : end"]:
        start = None if line.startswith((" ", "\t")) else re.match(r"(\S.*?)\s+:\s+(.*)", line)
        if start is None:
            meaning.append(line.strip())
            continue
        if names:
            yield names, " ".join(meaning).strip()
        names, meaning = start[1], [start[2]]


def _sections(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    title, body = "", []
    k = 0
    while k < len(lines):
        underlined = k + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[k + 1].strip()) and lines[k].strip()
        if underlined:
            yield title, body
            title, body, k = lines[k].strip(), [], k + 2
            continue
        body.append(lines[k])
        k += 1
    yield title, body


def as_rst(lines: list[str]) -> list[str]:
    """The lines of a docstring as reStructuredText."""
    out: list[str] = []
    for title, body in _sections(lines):
        if title:
            out += ["", f".. rubric:: {title}", ""]
        if title in _LISTS:
            for names, meaning in _entries(body):
                out += [", ".join(f"``{name.strip()}``" for name in names.split(",")), f"    {meaning}", ""]
        else:
            out += body
    return out


def _process(app: Sphinx, what: str, name: str, found: Any, options: Any, lines: list[str]) -> None:
    # What a role names may be internal, without a place in the manual.
    lines[:] = as_rst([re.sub(r":[a-z:]+:`~?([^`]*)`", r"``\1``", line) for line in lines])


def short_arrays(text: str | None) -> str | None:
    """A signature, or its return type, with arrays by their names in `pipeline.arrays`."""
    return None if text is None else _ARRAY.sub(lambda found: _ARRAYS[found[1]], text)


def _signature(
    app: Sphinx, what: str, name: str, found: Any, options: Any, arguments: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    return short_arrays(arguments), short_arrays(returned)


def setup(app: Sphinx) -> dict[str, Any]:
    """Convert every docstring that autodoc reads."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-process-signature", _signature)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
