"""Assemble the amplitude of a free decay against time from the columns of its files.

    time_s                                    of each row [s]
    sense<k>_R_V                              amplitude: peak, or rms where the record states amplitude = "rms"
    sense<k>_X_V, sense<k>_Y_V                in phase and in quadrature, likewise
    sense<k>_dBV, sense<k>_W, sense<k>_dBm    level in dB above 1 V rms; power at the reference impedance Z0, in W or dBm
    sense<k>_phase_deg                        phase relative to the reference; optional
    frequency_hz                              of a counter or phase-locked loop; the reference, where all rows are equal; optional
    sense<k>_sd_V                             sd of the amplitude; optional

    A = sqrt(2 Z0 P)      peak amplitude of a power P

A resolution bandwidth B (3 dB) is that of four poles in series: T = sqrt(2^(1/4) - 1) / (pi B).  Source: Rauscher, Fundamentals
of Spectrum Analysis (2001), section 4.4.

Shapes: N rows, S senses.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...errors import ConfigError, MeasurementError
from ..envelopes import EnvelopeRecord, rows_of
from .mapping import Source
from .tone_columns import Columns, missing, values_of

_SENSE = re.compile(r"sense([1-9][0-9]*)_(R_V|X_V|Y_V|dBV|W|dBm|phase_deg|sd_V)")
_ALLOWED = "time_s, sense<k>_R_V, _X_V, _Y_V, _dBV, _W, _dBm, _phase_deg, _sd_V, frequency_hz"
_FEWEST = 40
#: Poles of the filter that a resolution bandwidth stands for.
_POLES = 4


def is_envelope_key(key: str) -> bool:
    """Whether a key of [columns] is one of an amplitude against time."""
    return key in ("time_s", "frequency_hz") or _SENSE.fullmatch(key) is not None


def envelope_record(
    name: str,
    files: Sequence[Columns],
    mapping: Mapping[str, Source],
    rows: slice,
    span_s: tuple[float, float],
    rms: bool,
    reference_ohm: float,
    tuned_hz: float | None,
) -> EnvelopeRecord:
    """The record in the columns of ``files``, in volts (peak).

    Parameters
    ----------
    name : of the record.
    files : name -> column (N,) as read, for each file.
    mapping : key at the head of this module -> its column.  Keys that are not mapped are the columns of these names.
    rows, span_s : the rows that are read, and of these those in a span from the first one [s].
    rms : whether amplitudes in volts are rms.
    reference_ohm : Z0 [ohm].
    tuned_hz : frequency of the reference or centre of the analyzer [Hz].

    Raises
    ------
    MeasurementError : a column is missing or not finite, time does not rise, an amplitude is not positive, too few rows, or
        nothing states the frequency.
    ConfigError : ``mapping`` has a wrong entry.
    """
    values = {key: column[rows] for key, column in values_of(name, files, mapping, is_envelope_key, _ALLOWED).items()}
    if "time_s" not in values:
        raise missing(name, "time_s", files)
    senses = sorted({int(m[1]) for key in values if (m := _SENSE.fullmatch(key))})
    if not senses or senses != list(range(1, len(senses) + 1)):
        raise missing(name, "sense1_R_V", files)
    amplitudes = [_amplitude(name, values, f"sense{k}", rms, reference_ohm, files) for k in senses]
    phases = [phase for _, phase in amplitudes if phase is not None]
    frequency = values.get("frequency_hz")
    if frequency is not None and np.ptp(frequency) == 0.0:
        # A lock-in amplifier lists its reference in every row.
        tuned_hz, frequency = tuned_hz or float(frequency[0]), None
    sd = [values[f"sense{k}_sd_V"] for k in senses if f"sense{k}_sd_V" in values]
    record = EnvelopeRecord(
        name,
        values["time_s"],
        np.stack([a for a, _ in amplitudes], axis=1),
        np.stack(phases, axis=1) if len(phases) == len(senses) and tuned_hz is not None else None,
        frequency,
        tuned_hz,
        np.stack(sd, axis=1) * (np.sqrt(2.0) if rms else 1.0) if len(sd) == len(senses) else None,
    )
    return _checked(_within(record, span_s))


def time_constant(
    time_constant_s: float | None, poles: int | None, resolution_bandwidth_hz: float | None
) -> tuple[float, int]:
    """T [s] and the number of poles of the filter of the detector; ConfigError where both it and a bandwidth are stated."""
    if time_constant_s is not None and resolution_bandwidth_hz is not None:
        raise ConfigError(
            "a record states both time_constant_s and resolution_bandwidth_hz",
            value=[time_constant_s, resolution_bandwidth_hz],
            allowed="one of them",
            next_step="keep time_constant_s for a lock-in amplifier, resolution_bandwidth_hz for a spectrum analyzer",
        )
    if resolution_bandwidth_hz is not None:
        count = poles or _POLES
        return float(np.sqrt(2.0 ** (1.0 / count) - 1.0) / (np.pi * resolution_bandwidth_hz)), count
    return time_constant_s or 0.0, poles or 1


def _amplitude(
    name: str, values: Mapping[str, FloatArray], stem: str, rms: bool, reference_ohm: float, files: Sequence[Columns]
) -> tuple[FloatArray, FloatArray | None]:
    """Peak amplitude (N,) [V], and the phase (N,) [rad] where there is one."""
    phase = np.unwrap(np.deg2rad(values[f"{stem}_phase_deg"])) if f"{stem}_phase_deg" in values else None
    peak = np.sqrt(2.0)
    if f"{stem}_X_V" in values and f"{stem}_Y_V" in values:
        z = values[f"{stem}_X_V"] + 1.0j * values[f"{stem}_Y_V"]
        return np.abs(z) * (peak if rms else 1.0), np.unwrap(np.angle(z))
    if f"{stem}_R_V" in values:
        return values[f"{stem}_R_V"] * (peak if rms else 1.0), phase
    if f"{stem}_dBV" in values:
        return peak * 10.0 ** (values[f"{stem}_dBV"] / 20.0), phase
    if f"{stem}_dBm" in values:
        return peak * np.sqrt(reference_ohm * 1e-3) * 10.0 ** (values[f"{stem}_dBm"] / 20.0), phase
    if f"{stem}_W" in values:
        if np.any(values[f"{stem}_W"] < 0.0):
            raise MeasurementError(
                f"{name}: a power is negative",
                value=float(values[f"{stem}_W"].min()),
                allowed="0 W and more",
                next_step=f"map {stem}_dBm where the column is a level",
            )
        return peak * np.sqrt(reference_ohm * values[f"{stem}_W"]), phase
    raise missing(name, f"{stem}_R_V (or _dBV, _W, _dBm, _X_V and _Y_V)", files)


def _within(record: EnvelopeRecord, span_s: tuple[float, float]) -> EnvelopeRecord:
    t = record.time_s - record.time_s[:1]
    return rows_of(record, np.flatnonzero((t >= span_s[0]) & (t < span_s[1])))


def _checked(record: EnvelopeRecord) -> EnvelopeRecord:
    if record.time_s.size < _FEWEST:
        raise MeasurementError(
            f"{record.name}: too few rows for a decay",
            value=record.time_s.size,
            allowed=f"at least {_FEWEST}",
            next_step="record more often, or correct start and stop of this [[record]]",
        )
    if not np.all(np.diff(record.time_s) > 0.0):
        raise MeasurementError(
            f"{record.name}: time_s does not rise from row to row",
            value=float(np.diff(record.time_s).min()),
            allowed="rising times",
            next_step="map the column of times to time_s under [columns]",
        )
    if np.any(record.amplitude_v < 0.0) or not np.all(record.amplitude_v.max(axis=0) > 0.0):
        raise MeasurementError(
            f"{record.name}: an amplitude is negative, or always 0",
            value=float(record.amplitude_v.min()),
            allowed="amplitudes of 0 V and more",
            next_step="map sense1_dBV or sense1_dBm where the column is a level in decibels",
        )
    if record.frequency_hz is None and record.tuned_hz is None:
        raise MeasurementError(
            f"{record.name}: nothing states the frequency of the mode",
            allowed="frequency_hz in the [[record]] (reference of the lock-in, centre of the analyzer), or as a column",
            next_step="write frequency_hz = .. in this [[record]]",
        )
    known = record.tuned_hz if record.frequency_hz is None else float(record.frequency_hz.min())
    if not (known is not None and known > 0.0):
        raise MeasurementError(
            f"{record.name}: the frequency of the mode is not positive",
            value=known,
            allowed="a frequency above 0 Hz",
            next_step="correct frequency_hz in this [[record]], or map another column to frequency_hz",
        )
    return record if record.phase_rad is None else replace(record, phase_rad=record.phase_rad - record.phase_rad[:1])
