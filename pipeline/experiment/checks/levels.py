"""Levels of each channel, from the samples alone: offset, noise floor, converter, clipping, silence, drive.

    floor   sigma^2 = median |DFT of the Hann-windowed samples|^2 / (ln 2 sum w^2), since most bins hold noise
    clip    runs of 3 or more samples at one extreme that are entered by a step no smooth top has
    LSB     the smallest step between values, if all values lie on its multiples

Units: volts, samples.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from ...arrays import BoolArray, FloatArray
from ..instrument import Adc, Instrument
from ..record import Campaign, Channels, Record
from .finding import Correction, Finding, channel_correction

#: A drive that varies by less than this [V rms] is silent.
_SILENT_V = 1e-9
#: Fewest flat tops that are called clipping.
_MIN_TOPS = 3


@dataclass(frozen=True)
class Level:
    """Level of one sense channel in one record [V]; ``lsb_v`` is ``None`` where values lie on no grid."""

    record: str
    channel: str
    offset_v: float
    rms_v: float
    peak_v: float
    floor_v: float
    lsb_v: float | None


def is_driven(record: Record) -> bool:
    """Some drive varies."""
    return bool(np.any(np.std(record.drive_v, axis=0) > _SILENT_V))


def floor_v(y: FloatArray) -> float:
    """sigma [V] of the noise in y (N,), robust against signals that fill less than half the bins."""
    window = np.hanning(y.size)
    power = np.abs(rfft((y - y.mean()) * window)[2:]) ** 2
    return math.sqrt(float(np.median(power)) / (math.log(2.0) * float(np.sum(window**2))))


def lsb_of(y: FloatArray) -> float | None:
    """Smallest step of y (N,) if all values lie on its multiples, else ``None``."""
    values = np.unique(y)
    if values.size < 3:
        return None
    step = float(np.min(np.diff(values)))
    steps = (values - values[0]) / step
    span = float(steps[-1])
    # With nearly as many values as samples, the smallest difference is an accident of the noise.
    if span > 2.0**32 or step <= 4.0 * float(np.spacing(np.abs(values).max())):
        return None
    # The mean step is better known than the smallest, which rounding of the numbers moves.
    step = float(values[-1] - values[0]) / round(span)
    steps = (values - values[0]) / step
    return step if float(np.max(np.abs(steps - np.rint(steps)))) < 0.02 else None


def _flat_tops(y: FloatArray, tolerance: float) -> int:
    """Number of flat tops at the maximum of y (N,)."""
    top = y >= y.max() - tolerance
    edges = np.diff(np.concatenate([[0], top.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    long = (stops - starts >= 3) & (starts > 0) & (stops < y.size)
    starts, stops = starts[long], stops[long]
    # A parabola with three samples within ``tolerance`` of its top rises by less than 6 tolerances before
    # them.
    below = y.max() - 7.0 * tolerance
    return int(np.sum((y[starts - 1] < below) & (y[stops] < below)))


def level(record: Record, channel: int) -> Level:
    """Level of sense ``channel`` (from 0)."""
    y = record.sense_v[:, channel]
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
    """Flat tops at one level: the converter's full scale, or anything in front of it."""
    y = record.sense_v[:, int(found.channel.removeprefix("sense")) - 1]
    tolerance = max(4.0 * found.floor_v, 1.5 * (found.lsb_v or 0.0), 1e-9 * found.peak_v)
    # Noise as large as the signal hides flat tops, and its own tops are none.
    if found.rms_v < 20.0 * tolerance:
        return []
    tops = [_flat_tops(y, tolerance), _flat_tops(-y, tolerance)]
    if max(tops) < _MIN_TOPS:
        return []
    at = float(y.max() if tops[0] >= tops[1] else y.min())
    full = adc is not None and abs(at) >= adc.full_scale_v - 2.0 * adc.lsb_v
    cause = "the converter's full scale" if full else "a stage before the converter, or one not declared"
    text = (
        f"{sum(tops)} flat tops at {at:.4g} V ({cause}): measure again at a lower level, or add the effect"
        " adc_saturation to the model"
    )
    return [Finding("clipping", "fault", text, record.name, found.channel, at, None, "V")]


def dead(record: Record, found: Level, others: float) -> list[Finding]:
    """A sense channel that is constant, or hears nothing while the others do."""
    if found.rms_v == 0.0:
        text = "is constant: not connected, or the wrong column"
    elif is_driven(record) and found.rms_v < 1.5 * found.floor_v and others > 20.0 * found.rms_v:
        text = "holds noise alone while another channel responds: not connected"
    else:
        return []
    return [Finding("dead", "fault", f"{found.channel} {text}", record.name, found.channel, found.rms_v, None, "V")]


def offset(record: Record, found: Level) -> list[Finding]:
    """A sense offset, which every fit takes as a free nuisance."""
    sd = found.floor_v / math.sqrt(record.sense_v.shape[0])
    if abs(found.offset_v) < 10.0 * sd or abs(found.offset_v) < max(found.floor_v, 1e-3 * found.rms_v):
        return []
    text = f"{found.channel} has an offset of {found.offset_v:.4g} V, which fits leave free"
    return [Finding("offset", "note", text, record.name, found.channel, found.offset_v, sd, "V")]


def _holds_bias(mean_v: FloatArray, instrument: Instrument) -> BoolArray:
    """Drive columns whose mean is the bias, more or less."""
    bias = abs(instrument.bias_v)
    return (np.abs(mean_v - instrument.bias_v) < 0.3 * bias) if bias else np.zeros(mean_v.shape, dtype=bool)


def without_bias(record: Record, instrument: Instrument) -> Record:
    """The record with the bias taken off the drives that hold it."""
    mean = record.drive_v.mean(axis=0)
    return dataclasses.replace(record, drive_v=record.drive_v - np.where(_holds_bias(mean, instrument), mean, 0.0))


def drive_offsets(campaign: Campaign) -> list[Finding]:
    """The bias in the drive columns, which are to hold the commanded samples without it."""
    drives, senses = campaign.records[0].drive_v.shape[1], campaign.records[0].sense_v.shape[1]
    means = np.array([record.drive_v.mean(axis=0) for record in campaign.records])
    swing = np.max([record.drive_v.std(axis=0) for record in campaign.records], axis=0)
    typical = np.median(means, axis=0)
    is_bias = _holds_bias(typical, campaign.instrument)
    if np.any(is_bias):
        amounts = tuple(float(f"{v:.6g}") if b else 0.0 for v, b in zip(typical, is_bias))
        correct = channel_correction(campaign.channels, Channels(drive_offset_v=amounts), drives, senses)
        text = f"the drive columns contain the bias ({', '.join(f'{v:.4g} V' for v in typical)})"
        return [Finding("drive_offset", "fault", text, None, None, float(typical[0]), None, "V", correct)]
    return [
        Finding(
            "drive_offset",
            "note",
            f"drive{k + 1} has a mean of {typical[k]:.4g} V beside {swing[k]:.4g} V rms",
            None,
            f"drive{k + 1}",
            float(typical[k]),
            None,
            "V",
        )
        for k in range(drives)
        if abs(typical[k]) > max(0.1 * swing[k], 1e-6)
    ]


def roles(campaign: Campaign) -> list[Finding]:
    """Silent records that are driven, driven ones that are silent, and drives that never move."""
    found = []
    for record in campaign.records:
        if record.role == "noise" and is_driven(record):
            correct = Correction(record={record.file or record.name: {"role": "fit"}})
            found.append(
                Finding("silence", "fault", 'is declared "noise" but is driven', record.name, correction=correct)
            )
        elif record.role != "noise" and not is_driven(record):
            correct = Correction(record={record.file or record.name: {"role": "noise"}})
            found.append(
                Finding("silence", "fault", "no drive moves: the record is silent", record.name, correction=correct)
            )
        elif record.role == "noise":
            parts = np.array_split(record.sense_v - record.sense_v.mean(axis=0), 5)
            first, last = parts[0].std(axis=0), parts[-1].std(axis=0)
            for k in np.flatnonzero(first > 1.5 * last):
                text = f"silence fades from {first[k]:.3g} to {last[k]:.3g} V rms: it rings; wait longer"
                ratio = float(first[k] / max(last[k], 1e-300))
                found.append(Finding("silence", "fault", text, record.name, f"sense{k + 1}", ratio))
    driven = np.array([record.drive_v.std(axis=0) > _SILENT_V for record in campaign.records])
    if np.any(driven):
        for k in np.flatnonzero(~np.any(driven, axis=0)):
            text = f"drive{k + 1} moves in no record: what it does to the device cannot be learnt"
            found.append(Finding("drive", "fault", text, None, f"drive{k + 1}", 0.0, None, "V"))
    if not any(record.role == "noise" for record in campaign.records):
        text = "there is no silent record: the noise level comes from repeats or a local fit"
        found.append(Finding("silence", "note", text))
    return found


def converter(campaign: Campaign, levels: list[Level]) -> list[Finding]:
    """The declared LSB against the steps in the data."""
    steps = [found.lsb_v for found in levels if found.lsb_v is not None and found.rms_v > 3.0 * found.lsb_v]
    adc = campaign.instrument.adc
    floor = min((found.floor_v for found in levels if found.floor_v > 0.0), default=0.0)
    peak = max(found.peak_v for found in levels)
    if not steps:
        if adc is None or adc.lsb_v < 0.1 * floor:
            return []
        text = f"the values lie on no grid, but an LSB of {adc.lsb_v:.4g} V is declared"
        return [Finding("converter", "note", text, None, None, None, None, "V")]
    # Few values can miss codes, so the smallest step found is the best.
    lsb = min(steps)
    if adc is not None and abs(lsb / adc.lsb_v - 1.0) < 1e-3:
        return []
    if adc is None and lsb**2 / 12.0 < 0.01 * floor**2:
        return []
    bits, full = (16, lsb * 2.0**15) if adc is None else (adc.bits, adc.full_scale_v)
    # Of bits and full scale, the step fixes one: that which makes the other a whole number of bits.
    fitting = math.log2(2.0 * full / lsb)
    if abs(fitting - round(fitting)) < 1e-3 and 1 <= round(fitting) <= 64:
        bits = round(fitting)
    else:
        full = lsb * 2.0 ** (bits - 1)
    while full < peak and bits < 64:
        bits, full = bits + 1, 2.0 * full
    declared = "none is declared" if adc is None else f"{adc.lsb_v:.4g} V is declared"
    correct = Correction(instrument={"adc": {"bits": bits, "full_scale_v": float(f"{full:.9g}")}})
    text = f"the values step by {lsb:.6g} V, {declared}"
    return [Finding("converter", "warning", text, None, None, lsb, None, "V", correct)]


def clocks(campaign: Campaign) -> list[Finding]:
    """Time stamps that wander within what the reader tolerates."""
    found = []
    for record in campaign.records:
        if record.clock is None:
            continue
        relative = record.clock.sample_rate_hz / record.sample_rate_hz - 1.0
        # Rounded time stamps know the rate no better than this.
        resolution = 2.0 * record.clock.jitter_samples / record.sense_v.shape[0]
        if record.clock.jitter_samples > 0.01:
            jitter = record.clock.jitter_samples
            text = f"time stamps lie up to {jitter:.2g} samples off a uniform grid: few digits, or jitter"
            found.append(Finding("clock", "warning", text, record.name, "time_s", jitter, None, "samples"))
        if abs(relative) > max(1e-6, 3.0 * resolution):
            rate = float(f"{record.clock.sample_rate_hz:.9g}")
            text = f"time_s says {rate} Hz against {record.sample_rate_hz} Hz ({relative * 1e6:+.1f} ppm)"
            correct = Correction(instrument={"sample_rate_hz": rate})
            sd = resolution * rate
            found.append(Finding("clock", "warning", text, record.name, "time_s", rate, sd, "Hz", correct))
    return found
