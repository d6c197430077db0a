"""Touchstone files (.s1p .. .s9p, version 1): network parameters of a device against frequency, as admittances.

    # GHz S MA R 50        unit of the frequency, kind (S, Y, Z), format (RI, MA, DB), reference resistance
    Y = (1 - S) (1 + S)^-1 / R,    Y = Z^-1                 H_s<j>d<k> is Y_jk: current into port j per volt at port k [S]

An admittance is a sum of modes for a piezoelectric or capacitive resonator, with a feedthrough capacitance; it is like the
response of a velocity pick-off.  Y and Z are normalised to R in version 1.  A line of a two-port holds 11, 21, 12, 22.
Source: Touchstone File Format Specification 1.1, EIA/IBIS Open Forum (2002).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....errors import MeasurementError
from .table import Columns, allow

_UNITS = {"HZ": 1.0, "KHZ": 1e3, "MHZ": 1e6, "GHZ": 1e9}
_FORMATS = ("RI", "MA", "DB")


def read(path: Path) -> Columns:
    """``frequency_hz`` and H_s<j>d<k>_re, _im of all ports."""
    ports = int(path.suffix[2:-1])
    unit, kind, form, resistance, numbers = 1e9, "S", "MA", 50.0, []
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            text = line.partition("!")[0].strip()
            if text.startswith("#"):
                unit, kind, form, resistance = _options(text[1:].upper().split())
            elif text.startswith("["):
                raise MeasurementError("a Touchstone file of version 2", value=text, allowed="version 1")
            elif text:
                numbers.append(np.array(text.split(), dtype=np.float64))
    rows = np.concatenate(numbers) if numbers else np.zeros(0)
    width = 1 + 2 * ports**2
    # Noise data of an amplifier follow with falling frequencies.
    rows = rows[: rows.size // width * width].reshape(-1, width)
    rising = np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)
    rows = rows[: rising[0] + 1] if rising.size else rows
    allow(rows.size, path.stat().st_size)
    matrix = _matrix(rows[:, 1::2], rows[:, 2::2], form).reshape(-1, ports, ports)
    if ports == 2:
        matrix = np.moveaxis(matrix, 1, 2)
    y = _admittance(matrix, kind, resistance)
    columns: Columns = {"frequency_hz": rows[:, 0] * unit}
    for j in range(ports):
        for k in range(ports):
            columns[f"H_s{j + 1}d{k + 1}_re"] = np.ascontiguousarray(y[:, j, k].real)
            columns[f"H_s{j + 1}d{k + 1}_im"] = np.ascontiguousarray(y[:, j, k].imag)
    return columns


def _options(words: list[str]) -> tuple[float, str, str, float]:
    unit = next((_UNITS[word] for word in words if word in _UNITS), 1e9)
    form = next((word for word in words if word in _FORMATS), "MA")
    kind = next((word for word in words if word in ("S", "Y", "Z", "G", "H")), "S")
    if kind not in ("S", "Y", "Z"):
        raise MeasurementError("hybrid parameters", value=kind, allowed="S, Y or Z", next_step="export S parameters")
    resistance = float(words[words.index("R") + 1]) if "R" in words[:-1] else 50.0
    return unit, kind, form, resistance


def _matrix(first: FloatArray, second: FloatArray, form: str) -> ComplexArray:
    if form == "RI":
        return np.asarray(first + 1.0j * second)
    size = 10.0 ** (first / 20.0) if form == "DB" else first
    return np.asarray(size * np.exp(1.0j * np.deg2rad(second)))


def _admittance(matrix: ComplexArray, kind: str, resistance: float) -> ComplexArray:
    """Y (N, P, P) [S]."""
    eye = np.eye(matrix.shape[1])
    if kind == "Y":
        return matrix / resistance
    if kind == "Z":
        return np.asarray(np.linalg.inv(matrix * resistance))
    return np.asarray(
        np.linalg.solve(np.swapaxes(eye + matrix, 1, 2), np.swapaxes(eye - matrix, 1, 2)).swapaxes(1, 2) / resistance
    )
