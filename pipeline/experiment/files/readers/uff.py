"""Universal files, data set 58 (.uff, .unv): functions at degrees of freedom, text (58) and binary (58b).

    frequency response (type 4)   ->  frequency_hz, H_s<j>d<k>_re, _im      per response j and reference k, in order of appearance
    coherence (type 6)            ->  H_s<j>d<k>_coherence
    time response (type 1)        ->  time_s and one column per response, with its unit

Responses to a force are read as mobility: accelerations are divided by i w, displacements multiplied by it, as the header
states the kind of the ordinate (8 displacement, 11 velocity, 12 acceleration).
Source: Universal File Dataset 58, University of Cincinnati SDRL (2007).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....errors import MeasurementError
from ....input_limits import RECORD_VALUES
from .table import Columns, allow

_TIME, _FRF, _COHERENCE = (0, 1), 4, 6
_DISPLACEMENT, _ACCELERATION = 8, 12
#: Lines of the header of a data set.
_HEADER = 11
_NUMBER = re.compile(rb"[+-]?\d*\.?\d+(?:[EeDd][+-]?\d+)?")


@dataclass(frozen=True, eq=False)
class UniversalFunction:
    """One data set 58: type, response and reference (node, direction), abscissa, values (N,), ordinate and its unit."""

    kind: int
    response: tuple[str, str]
    reference: tuple[str, str]
    abscissa: FloatArray
    values: ComplexArray
    ordinate: int
    unit: str


def read(path: Path) -> Columns:
    """The columns of all functions that share the abscissa of the first."""
    found = [_function(head, body) for head, body in _sets(path.read_bytes())]
    found = [one for one in found if one.kind in (*_TIME, _FRF, _COHERENCE)]
    if not found:
        raise MeasurementError("no function of data set 58", allowed="time responses or frequency responses")
    first = found[0]
    allow(sum(one.values.size for one in found), path.stat().st_size)
    own = [one for one in found if one.abscissa.size == first.abscissa.size]
    if first.kind in _TIME:
        columns: Columns = {"time_s": first.abscissa}
        for k, one in enumerate(own, 1):
            unit = f" [{one.unit}]" if one.unit else ""
            columns[f"node {one.response[0]} {one.response[1]} ({k}){unit}"] = one.values.real.copy()
        return columns
    keep = first.abscissa > 0.0
    columns = {"frequency_hz": first.abscissa[keep]}
    senses = list(dict.fromkeys(one.response for one in own))
    drives = list(dict.fromkeys(one.reference for one in own))
    for one in own:
        stem = f"H_s{senses.index(one.response) + 1}d{drives.index(one.reference) + 1}"
        if one.kind == _COHERENCE:
            columns[f"{stem}_coherence"] = one.values.real[keep]
            continue
        s = 2.0j * np.pi * one.abscissa[keep]
        power = {_ACCELERATION: -1, _DISPLACEMENT: 1}.get(one.ordinate, 0)
        h = one.values[keep] * s**power
        columns[f"{stem}_re"], columns[f"{stem}_im"] = h.real.copy(), h.imag.copy()
    return columns


def _sets(text: bytes) -> list[tuple[bytes, bytes]]:
    """First line and rest of each data set 58."""
    found, at = [], 0
    mark = re.compile(rb"^ {4}-1[ \t]*\r?$", re.MULTILINE)
    while (begin := mark.search(text, at)) is not None:
        start = begin.end() + 1
        line_end = text.find(b"\n", start)
        head = text[start:line_end]
        size = 0
        if re.match(rb"\s*58b", head):
            lines = line_end
            for _ in range(_HEADER):
                lines = text.find(b"\n", lines + 1)
            size = lines + 1 + int(head.split()[4]) - line_end
        # Binary values may end without a new line.
        end = (re.compile(rb" {4}-1[ \t]*\r?(?:\n|$)") if size else mark).search(text, line_end + size)
        stop = len(text) if end is None else end.start()
        if re.match(rb"\s*58b?\b", head):
            found.append((head, text[line_end + 1 : stop]))
        at = stop if end is None else end.end()
    return found


def _function(head: bytes, body: bytes) -> UniversalFunction:
    lines = body.split(b"\n", _HEADER)
    text = [line.decode("ascii", "replace").rstrip("\r") for line in lines[:_HEADER]]
    kind = int(text[5][:5])
    response, reference = (
        (text[5][41:51].strip(), text[5][51:55].strip()),
        (text[5][66:76].strip(), text[5][76:80].strip()),
    )
    kinds = text[6].split()
    ordinate_kind, count, even = int(kinds[0]), int(kinds[1]), int(kinds[2]) == 1
    low, step = float(kinds[3]), float(kinds[4])
    if not 0 < count <= RECORD_VALUES:
        raise MeasurementError(
            "a function has an impossible number of values", value=count, allowed=f"1 to {RECORD_VALUES}"
        )
    is_complex, double = ordinate_kind in (5, 6), ordinate_kind in (4, 6)
    per = (2 if is_complex else 1) + (0 if even else 1)
    if b"58b" in head:
        order = "<" if int(head.split()[1]) == 1 else ">"
        numbers = np.frombuffer(lines[_HEADER], dtype=f"{order}f{8 if double else 4}", count=count * per).astype(
            np.float64
        )
    else:
        numbers = np.array(
            [float(one.replace(b"D", b"E")) for one in _NUMBER.findall(lines[_HEADER])], dtype=np.float64
        )
    rows = numbers[: count * per].reshape(count, per)
    abscissa = np.asarray(low + step * np.arange(count) if even else rows[:, 0], dtype=np.float64)
    imaginary = rows[:, -1] if is_complex else np.zeros(count)
    values = np.asarray(rows[:, -2 if is_complex else -1] + 1.0j * imaginary, dtype=np.complex128)
    unit = text[8][47:67].strip()
    return UniversalFunction(
        kind, response, reference, abscissa, values, int(text[8][:10]), "" if unit == "NONE" else unit
    )
