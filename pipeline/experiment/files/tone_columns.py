"""Assemble a frequency-domain record from the columns of its files.

    frequency_hz                              of each row [Hz]
    time_s                                    when the row was read [s]; optional
    drive<k>_V                                amplitude of the drive [V]; 1 where there is none
    sense<k>_X_V, sense<k>_Y_V                in phase and in quadrature (lock-in), or
    sense<k>_R_V, sense<k>_phase_deg          amplitude and phase;   sense<k>_sd_V  sd of X and of Y; optional
    H_s<j>d<k>_re, _im                        response of sense j to drive k (frf), or
    H_s<j>d<k>_abs or _dB, _phase_deg         its magnitude and phase;   _sd or _coherence, optional

    sd = |H| sqrt((1 - c) / (2 n c))          of the real and of the imaginary part, from the coherence c of n averages
                                              (Bendat and Piersol, Random Data, section 9.1)

A ``quantity`` is turned into a response like that of a velocity pick-off, which a sum of modes describes:

    mobility, admittance: H      accelerance: H / (i w)      compliance: i w H      impedance: 1 / H
    S11: (1 - H) / (Z0 (1 + H))                              admittance of a one-port at the reference impedance Z0

Shapes: N rows, D drives, S senses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...arrays import ComplexArray, FloatArray
from ...errors import ConfigError, MeasurementError
from ..tones import ToneKind, ToneRecord
from .mapping import Source, as_table, column_of
from .units import UNITS, known_unit, split_unit

Quantity = Literal["response", "mobility", "admittance", "accelerance", "compliance", "impedance", "S11"]
_SENSE = re.compile(r"sense([1-9][0-9]*)_(X_V|Y_V|R_V|phase_deg|sd_V)")
_PATH = re.compile(r"H_s([1-9][0-9]*)d([1-9][0-9]*)_(re|im|abs|dB|phase_deg|sd|coherence)")
_DRIVE = re.compile(r"drive([1-9][0-9]*)_V")
_FEWEST = 8
_ALLOWED = "frequency_hz, time_s, drive<k>_V, sense<k>_X_V, _Y_V, _R_V, _phase_deg, _sd_V, H_s<j>d<k>_re, _im, .."

Columns = Mapping[str, NDArray[Any]]


def tone_record(
    name: str,
    kind: ToneKind,
    files: Sequence[Columns],
    mapping: Mapping[str, Source],
    start: int = 0,
    stop: int | None = None,
    quantity: Quantity = "response",
    reference_ohm: float = 50.0,
    averages: int = 1,
) -> tuple[ToneRecord, ...]:
    """The record in the columns of ``files``; a frequency response becomes one record per drive.

    Parameters
    ----------
    name, kind : of the record.
    files : name -> column (N,) as read, for each file.
    mapping : key at the head of this module -> its column.  Keys that are not mapped are the columns of these names.
    start, stop : the rows start <= n < stop are read.
    quantity, reference_ohm, averages : of a frequency response.

    Raises
    ------
    MeasurementError : a column is missing, not finite or of another length; too few rows.
    ConfigError : ``mapping`` has a wrong entry.
    """
    values = {key: column[start:stop] for key, column in values_of(name, files, mapping, _is_key, _ALLOWED).items()}
    if "frequency_hz" not in values:
        raise missing(name, "frequency_hz", files)
    counts = {key: column.size for key, column in values.items()}
    if len(set(counts.values())) != 1 or min(counts.values()) < _FEWEST:
        raise MeasurementError(
            f"{name}: the columns differ in length, or have too few rows",
            value=counts,
            allowed=f"one length of at least {_FEWEST} rows",
            next_step="export all columns over the same rows; correct start and stop of this [[record]]",
        )
    if np.any(values["frequency_hz"] <= 0.0):
        raise MeasurementError(
            f"{name}: a frequency is not positive",
            value=float(values["frequency_hz"].min()),
            allowed="frequencies above 0 Hz",
            next_step="leave the row out with start and stop",
        )
    if kind == "sweep":
        return (_sweep(name, values, files),)
    return _responses(name, values, files, quantity, reference_ohm, averages)


def values_of(
    name: str, files: Sequence[Columns], mapping: Mapping[str, Source], is_key: Callable[[str], bool], allowed: str
) -> dict[str, FloatArray]:
    """Key -> values (N,) in SI units (degrees for a phase) of the columns that are mapped or named by a key.

    ``allowed`` lists the keys for which ``is_key`` holds; raises as ``tone_record``.
    """
    found: dict[str, FloatArray] = {}
    for key, source in mapping.items():
        if not is_key(key):
            raise ConfigError(
                "[columns] has a key that is not a column of such a record",
                value=key,
                allowed=allowed,
                next_step='write, for example, sense1_X_V = "X" (the name in the file on the right)',
            )
        table = as_table(key, source)
        file, column = column_of(name, key, table, files, isinstance(source, str))
        unit = split_unit(column)[1] if table.unit is None else known_unit(table.unit)
        factor = _factor(key, unit)
        found[key] = factor * table.gain * _numbers(name, key, files[file][column]) - table.offset
    for columns in files:
        for column, numbers in columns.items():
            if is_key(column) and column not in found:
                found[column] = _numbers(name, column, numbers)
    return found


def _is_key(key: str) -> bool:
    return key in ("frequency_hz", "time_s") or any(p.fullmatch(key) for p in (_SENSE, _PATH, _DRIVE))


def _factor(key: str, unit: str | None) -> float:
    """Factor of a column in ``unit``; a phase is wanted in degrees."""
    if unit is None or unit == "deg":
        return 1.0
    if key.endswith("phase_deg"):
        return float(np.rad2deg(1.0)) if unit == "rad" else 1.0
    return UNITS[unit][1]


def _numbers(name: str, key: str, values: NDArray[Any]) -> FloatArray:
    if values.ndim == 1 and values.dtype.kind == "M":
        return np.asarray((values - values[0]) / np.timedelta64(1, "ns") * 1e-9, dtype=np.float64)
    numbers = np.asarray(values, dtype=np.float64) if values.ndim == 1 and values.dtype.kind in "fiub" else None
    if numbers is None or not np.all(np.isfinite(numbers)):
        raise MeasurementError(
            f"{name}: column {key} does not hold finite numbers",
            allowed="one number in every row",
            next_step="leave out the rows with start and stop, or map another column under [columns]",
        )
    return numbers


def missing(name: str, key: str, files: Sequence[Columns]) -> MeasurementError:
    """The error of a column that no file has."""
    return MeasurementError(
        f"{name}: no column {key}",
        value=[column for columns in files for column in columns][:12],
        allowed="a column of that name, or a mapping under [columns]",
        next_step=f'map it: [columns] {key} = "<column of the file>"',
    )


def _complex(name: str, values: Mapping[str, FloatArray], stem: str, files: Sequence[Columns]) -> ComplexArray:
    """X + i Y, re + i im, or the amplitude (linear or in dB) with its phase."""
    pairs = (("_X_V", "_Y_V"), ("_re", "_im"))
    for first, second in pairs:
        if stem + first in values and stem + second in values:
            return np.asarray(values[stem + first] + 1.0j * values[stem + second])
    size = next((values[stem + end] for end in ("_R_V", "_abs") if stem + end in values), None)
    if stem + "_dB" in values:
        size = 10.0 ** (values[stem + "_dB"] / 20.0)
    if size is None or stem + "_phase_deg" not in values:
        raise missing(
            name, f"{stem}_X_V and {stem}_Y_V" if stem.startswith("sense") else f"{stem}_re and {stem}_im", files
        )
    return np.asarray(size * np.exp(1.0j * np.deg2rad(values[stem + "_phase_deg"])))


def _sweep(name: str, values: Mapping[str, FloatArray], files: Sequence[Columns]) -> ToneRecord:
    senses = sorted({int(m[1]) for key in values if (m := _SENSE.fullmatch(key))})
    drives = sorted({int(m[1]) for key in values if (m := _DRIVE.fullmatch(key))})
    if senses != list(range(1, len(senses) + 1)) or not senses:
        raise missing(name, "sense1_X_V", files)
    if drives != list(range(1, len(drives) + 1)):
        raise missing(name, "drive1_V", files)
    rows = values["frequency_hz"].size
    drive = [values[f"drive{k}_V"] for k in drives] or [np.ones(rows)]
    sd = [values.get(f"sense{k}_sd_V") for k in senses]
    known = [one for one in sd if one is not None]
    return ToneRecord(
        name,
        "sweep",
        values["frequency_hz"],
        np.stack(drive, axis=1).astype(np.complex128),
        np.stack([_complex(name, values, f"sense{k}", files) for k in senses], axis=1),
        time_s=values.get("time_s"),
        sd_v=np.stack(known, axis=1) if len(known) == len(sd) else None,
    )


def _responses(
    name: str,
    values: Mapping[str, FloatArray],
    files: Sequence[Columns],
    quantity: Quantity,
    reference_ohm: float,
    averages: int,
) -> tuple[ToneRecord, ...]:
    paths = sorted({(int(m[1]), int(m[2])) for key in values if (m := _PATH.fullmatch(key))})
    senses, drives = (max((path[k] for path in paths), default=0) for k in (0, 1))
    if paths != [(s, d) for s in range(1, senses + 1) for d in range(1, drives + 1)] or not paths:
        raise missing(name, "H_s1d1_re", files)
    f = values["frequency_hz"]
    found = []
    for d in range(1, drives + 1):
        every = [
            _path(name, values, f"H_s{s}d{d}", files, quantity, reference_ohm, averages) for s in range(1, senses + 1)
        ]
        sd = [each for _, each in every if each is not None]
        drive = np.zeros((f.size, drives), dtype=np.complex128)
        drive[:, d - 1] = 1.0
        found.append(
            ToneRecord(
                name if drives == 1 else f"{name}, drive {d}",
                "frf",
                f,
                drive,
                np.stack([h for h, _ in every], axis=1),
                sd_v=np.stack(sd, axis=1) if len(sd) == senses else None,
            )
        )
    return tuple(found)


def _path(
    name: str,
    values: Mapping[str, FloatArray],
    stem: str,
    files: Sequence[Columns],
    quantity: Quantity,
    reference_ohm: float,
    averages: int,
) -> tuple[ComplexArray, FloatArray | None]:
    """H (N,) of one path and its sd (N,), as a response that a sum of modes describes."""
    h, sd = _complex(name, values, stem, files), values.get(f"{stem}_sd")
    coherence = values.get(f"{stem}_coherence")
    if sd is None and coherence is not None:
        inside = np.clip(coherence, 1e-6, 1.0 - 1e-12)
        sd = np.abs(h) * np.sqrt((1.0 - inside) / (2.0 * averages * inside))
    s = 2.0j * np.pi * values["frequency_hz"]
    with np.errstate(divide="ignore", invalid="ignore"):
        if quantity == "accelerance":
            turned, slope = h / s, 1.0 / np.abs(s)
        elif quantity == "compliance":
            turned, slope = h * s, np.abs(s)
        elif quantity == "impedance":
            turned, slope = 1.0 / h, 1.0 / np.abs(h) ** 2
        elif quantity == "S11":
            turned = (1.0 - h) / (reference_ohm * (1.0 + h))
            slope = 2.0 / (reference_ohm * np.abs(1.0 + h) ** 2)
        else:
            turned, slope = h, np.ones(h.size)
    if not np.all(np.isfinite(turned)):
        raise MeasurementError(
            f"{name}: the {quantity} cannot be turned into a response",
            allowed="an impedance other than 0, S11 other than -1",
            next_step="leave out the row with start and stop",
        )
    return np.asarray(turned), None if sd is None else np.asarray(sd * slope)
