"""Level of each sense channel, from its samples: offset, noise floor, ADC step, clipping, dead channels.

    floor   sigma^2 = median |DFT of the Hann-windowed samples|^2 / (ln 2 sum w^2), because most bins hold only noise
    clip    runs of 3 or more samples at one extreme, entered by a step too large for a smooth maximum; equal samples: ``flat``
    LSB     the smallest difference between values, if all values are multiples of it apart

Shapes: y (N,) samples of one channel [V].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray
from ..instrument import Adc
from ..record import Campaign, Record
from .drives import is_driven
from .finding import Correction, Finding
from .flat import flat_extreme

#: Fewest flat tops that count as clipping.
_MIN_TOPS = 3
#: Samples of a long record that are looked at together; bounds the memory.
_PART = 2**18


@dataclass(frozen=True)
class Level:
    """Level of one sense channel in one record [V]; ``lsb_v`` is ``None`` where the values lie on no grid."""

    record: str
    channel: str
    offset_v: float
    rms_v: float
    peak_v: float
    floor_v: float
    lsb_v: float | None


def floor_v(y: FloatArray) -> float:
    """sigma [V] of the noise in y (N,), robust against signals that fill fewer than half of the bins."""
    parts = max(1, y.size // _PART)
    size = y.size if parts == 1 else y.size // parts // 4096 * 4096  # a length that is quickly transformed
    rows = y[: size * parts].reshape(parts, size)
    window = np.hanning(rows.shape[1])
    power = np.concatenate([np.abs(rfft((row - row.mean()) * window)[2:]) ** 2 for row in rows])
    return math.sqrt(float(np.median(power)) / (math.log(2.0) * float(np.sum(window**2))))


def lsb_of(y: FloatArray) -> float | None:
    """Step [V] of the grid on which all values of y (N,) lie; ``None`` if there is no grid."""
    few = np.unique(y[:: max(1, y.size // _PART)])
    if few.size >= 3 and _step_of(few) is None:
        return None
    parts = [np.unique(y[at : at + _PART]) for at in range(0, y.size, _PART)]
    return _step_of(np.unique(np.concatenate(parts)))


def _step_of(values: FloatArray) -> float | None:
    """Step [V] of the grid of ``values``, sorted and different; ``None`` if there is no grid."""
    if values.size < 3:
        return None
    step = float(np.min(np.diff(values)))
    steps = (values - values[0]) / step
    span = float(steps[-1])
    # Where nearly every sample has a value of its own, the smallest difference is due to noise.
    if span > 2.0**32 or step <= 4.0 * float(np.spacing(np.abs(values).max())):
        return None
    # The mean step is more accurate than the smallest one, which the rounding of the numbers shifts.
    step = float(values[-1] - values[0]) / round(span)
    steps = (values - values[0]) / step
    return step if float(np.max(np.abs(steps - np.rint(steps)))) < 0.02 else None


def _flat_tops(y: FloatArray, tolerance: float) -> int:
    """Number of flat tops at the maximum of y (N,); ``tolerance`` in volts."""
    top = y >= y.max() - tolerance
    at = np.flatnonzero(top[1:] != top[:-1]) + 1
    at = np.concatenate([np.zeros(int(top[0]), dtype=np.int64), at, np.full(int(top[-1]), y.size)])
    starts, stops = at[::2], at[1::2]
    long = (stops - starts >= 3) & (starts > 0) & (stops < y.size)
    starts, stops = starts[long], stops[long]
    # A parabola with three samples within ``tolerance`` of its top rises by less than 6 tolerances just before them.
    below = y.max() - 7.0 * tolerance
    return int(np.sum((y[starts - 1] < below) & (y[stops] < below)))


def level(record: Record, channel: int) -> Level:
    """Level of sense ``channel`` (counted from 0)."""
    y = np.ascontiguousarray(record.sense_v[:, channel])
    offset = float(y.mean())
    return Level(
        record.name,
        f"sense{channel + 1}",
        offset,
        float(y.std()),
        float(np.max(np.abs(y))),
        floor_v(y),
        lsb_of(y),
    )


def clipping(record: Record, found: Level, adc: Adc | None) -> list[Finding]:
    """Flat tops at one level: the full scale of the ADC, or the limit of an earlier stage."""
    y = record.sense_v[:, int(found.channel.removeprefix("sense")) - 1]
    tolerance = max(4.0 * found.floor_v, 1.5 * (found.lsb_v or 0.0), 1e-9 * found.peak_v)
    # Noise as large as the signal hides flat tops, unless the samples are equal.
    tops = [_flat_tops(y, tolerance), _flat_tops(-y, tolerance)] if found.rms_v >= 20.0 * tolerance else [0, 0]
    if max(tops) >= _MIN_TOPS:
        count, at = sum(tops), float(y.max() if tops[0] >= tops[1] else y.min())
    elif (flat := flat_extreme(y, found.lsb_v)) is not None:
        count, at = flat.runs, flat.level
    else:
        return []
    if adc is None:
        cause = "no ADC is declared, so either the ADC or an earlier stage saturates"
    elif abs(at) >= adc.full_scale_v - 2.0 * adc.lsb_v:
        cause = f"this is the full scale of the declared ADC, {adc.full_scale_v:g} V"
    else:
        cause = f"the declared ADC reaches {adc.full_scale_v:g} V, so an earlier stage saturates"
    text = (
        f"{found.channel} clips: {count} flat tops at {at:.4g} V ({cause}). Measure again at a lower drive level, or"
        " add the effect adc_saturation to the model (gyroscreen model add adc_saturation MODEL.toml)."
    )
    return [Finding("clipping", "fault", text, record.name, found.channel, at, None, "V")]


def drive_clipping(record: Record) -> list[Finding]:
    """Drive columns that stay at an extreme value, as behind a limiter."""
    findings = []
    for k in range(record.drive_v.shape[1]):
        v = np.ascontiguousarray(record.drive_v[:, k])
        flat = flat_extreme(v, lsb_of(v))
        if flat is not None:
            text = (
                f"drive{k + 1} is clipped: {flat.samples} samples in {flat.runs} flat tops at {flat.level:.4g} V. The fits take"
                " the column as the drive of the device, which is right where it was recorded behind the limiter; otherwise"
                " measure again at a lower level."
            )
            findings.append(Finding("clipping", "warning", text, record.name, f"drive{k + 1}", flat.level, None, "V"))
    return findings


def dead(record: Record, found: Level, others: float) -> list[Finding]:
    """A sense channel that is constant, or holds only noise although another channel has ``others`` V rms."""
    if found.rms_v == 0.0:
        text = f"is constant at {found.offset_v:.4g} V"
    elif is_driven(record) and found.rms_v < 1.5 * found.floor_v and others > 20.0 * found.rms_v:
        text = (
            f"holds only noise ({found.rms_v:.3g} V rms, noise floor {found.floor_v:.3g} V), while another channel"
            f" responds with {others:.3g} V rms"
        )
    else:
        return []
    text = f"{found.channel} {text}. Check its cable, and that [columns] names the right column of the file."
    return [Finding("dead", "fault", text, record.name, found.channel, found.rms_v, None, "V")]


def offset(record: Record, found: Level) -> list[Finding]:
    """A significant sense offset; every fit estimates it."""
    sd = found.floor_v / math.sqrt(record.sense_v.shape[0])
    if (
        found.rms_v == 0.0
        or abs(found.offset_v) < 10.0 * sd
        or abs(found.offset_v) < max(found.floor_v, 1e-3 * found.rms_v)
    ):
        return []
    text = (
        f"{found.channel} has an offset of {found.offset_v:.4g} +- {sd:.2g} V. Every fit estimates the offset of each"
        " channel and record, so nothing needs to be corrected."
    )
    return [Finding("offset", "note", text, record.name, found.channel, found.offset_v, sd, "V")]


def converter(campaign: Campaign, levels: list[Level]) -> list[Finding]:
    """The declared LSB against the grid of the sense values."""
    steps = [found.lsb_v for found in levels if found.lsb_v is not None and found.rms_v > 3.0 * found.lsb_v]
    adc = campaign.instrument.adc
    floor = min((found.floor_v for found in levels if found.floor_v > 0.0), default=0.0)
    peak = max(found.peak_v for found in levels)
    if not steps:
        if adc is None or adc.lsb_v < 0.1 * floor:
            return []
        text = (
            f"An ADC with an LSB of {adc.lsb_v:.4g} V is declared, but the sense values lie on no grid (noise floor"
            f" {floor:.3g} V). If the samples were filtered or rescaled after the ADC, remove adc from [instrument];"
            " otherwise check its bits and full_scale_v."
        )
        return [Finding("converter", "note", text, None, None, None, None, "V")]
    # A record with few values can miss codes, so the smallest step of all records is the best estimate.
    lsb = min(steps)
    if adc is not None and abs(lsb / adc.lsb_v - 1.0) < 1e-3:
        return []
    if adc is None and lsb**2 / 12.0 < 0.01 * floor**2:
        return []
    bits, full = (16, lsb * 2.0**15) if adc is None else (adc.bits, adc.full_scale_v)
    # The step fixes the full scale for given bits, or the bits for a given full scale if they come out whole.
    fitting = math.log2(2.0 * full / lsb)
    if abs(fitting - round(fitting)) < 1e-3 and 1 <= round(fitting) <= 64:
        bits = round(fitting)
    else:
        full = lsb * 2.0 ** (bits - 1)
    while full < peak and bits < 64:
        bits, full = bits + 1, 2.0 * full
    declared = "no ADC is declared" if adc is None else f"the declared ADC has an LSB of {adc.lsb_v:.6g} V"
    correction = Correction(instrument={"adc": {"bits": bits, "full_scale_v": float(f"{full:.9g}")}})
    text = (
        f"The sense values are multiples of {lsb:.6g} V apart, but {declared}. The step fixes only the ratio of full"
        f" scale to the number of codes: check both in the data sheet of the ADC, then {correction.advice}."
    )
    return [Finding("converter", "warning", text, None, None, lsb, None, "V", correction)]
