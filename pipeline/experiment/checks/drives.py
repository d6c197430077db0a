"""Drive columns and roles of the records, against what campaign.toml declares.

Shapes: drive samples (N, D) [V].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...arrays import BoolArray, FloatArray
from ..instrument import Instrument
from ..record import Campaign, Channels, Record
from .finding import Correction, Finding, channel_correction

#: A drive that varies by less than this [V rms] is silent.
_SILENT_V = 1e-9


def is_driven(record: Record) -> bool:
    """Whether any drive varies."""
    return bool(np.any(np.std(record.drive_v, axis=0) > _SILENT_V))


def unused_drives(records: Sequence[Record]) -> list[int]:
    """Drives (counted from 0) that vary in none of ``records``."""
    varies = np.array([record.drive_v.std(axis=0) > _SILENT_V for record in records])
    return [int(k) for k in np.flatnonzero(~np.any(varies, axis=0))]


def _contains_bias(mean_v: FloatArray, instrument: Instrument) -> BoolArray:
    """Drive columns (D,) whose mean is within 30 % of the declared bias."""
    bias = abs(instrument.bias_v)
    return (np.abs(mean_v - instrument.bias_v) < 0.3 * bias) if bias else np.zeros(mean_v.shape, dtype=bool)


def without_bias(record: Record, instrument: Instrument) -> Record:
    """``record`` with the mean removed from the drive columns that contain the bias."""
    mean = record.drive_v.mean(axis=0)
    return dataclasses.replace(record, drive_v=record.drive_v - np.where(_contains_bias(mean, instrument), mean, 0.0))


def drive_offsets(campaign: Campaign) -> list[Finding]:
    """Drive columns that contain the bias (they must hold the commanded samples without it) or another mean."""
    drives, senses = campaign.records[0].drive_v.shape[1], campaign.records[0].sense_v.shape[1]
    means = np.array([record.drive_v.mean(axis=0) for record in campaign.records])
    swing = np.max([record.drive_v.std(axis=0) for record in campaign.records], axis=0)
    typical = np.median(means, axis=0)
    is_bias = _contains_bias(typical, campaign.instrument)
    if np.any(is_bias):
        amounts = tuple(float(f"{v:.6g}") if b else 0.0 for v, b in zip(typical, is_bias))
        correction = channel_correction(campaign.channels, Channels(drive_offset_v=amounts), drives, senses)
        text = (
            f"The drive columns have means of {', '.join(f'{v:.4g} V' for v in typical)}, close to the declared bias of"
            f" {campaign.instrument.bias_v:g} V. Drive columns must hold the commanded samples without the bias:"
            f" {correction.advice}."
        )
        return [Finding("drive_offset", "fault", text, None, None, float(typical[0]), None, "V", correction)]
    return [
        Finding(
            "drive_offset",
            "note",
            f"drive{k + 1} has a mean of {typical[k]:.4g} V and varies by {swing[k]:.4g} V rms. If this mean was not"
            " applied to the electrode, subtract it with drive_offset_v under [channels].",
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
    """Roles that contradict the drives, silent records that are not silent, and drives that are never used."""
    found = []
    for record in campaign.records:
        file = record.file or record.name
        if record.role == "noise" and is_driven(record):
            correction = Correction(record={file: {"role": "fit"}})
            rms = float(np.max(record.drive_v.std(axis=0)))
            text = f'The record has the role "noise", but a drive varies by {rms:.3g} V rms: {correction.advice}.'
            found.append(Finding("silence", "fault", text, record.name, correction=correction))
        elif record.role != "noise" and record.drive_v.shape[1] and not is_driven(record):
            correction = Correction(record={file: {"role": "noise"}})
            text = (
                f'No drive of the record varies, but its role is not "noise". If it was meant to be silent,'
                f' {correction.advice}; if it is a free decay, write kind = "decay" there; otherwise check which columns the'
                " drives are read from."
            )
            found.append(Finding("silence", "fault", text, record.name, correction=correction))
        elif record.role == "noise":
            parts = np.array_split(record.sense_v - record.sense_v.mean(axis=0), 5)
            first, last = parts[0].std(axis=0), parts[-1].std(axis=0)
            for k in np.flatnonzero(first > 1.5 * last):
                text = (
                    f"sense{k + 1} falls from {first[k]:.3g} V rms in the first fifth of this silent record to"
                    f" {last[k]:.3g} V rms in the last fifth: the device was still ringing. Wait longer before a silent"
                    " record, or cut its beginning with start in its [[record]]."
                )
                ratio = float(first[k] / max(last[k], 1e-300))
                found.append(Finding("silence", "fault", text, record.name, f"sense{k + 1}", ratio))
    if any(is_driven(record) for record in campaign.records):
        for unused in unused_drives(campaign.records):
            text = (
                f"drive{unused + 1} is silent in every record, so its effect on the device cannot be identified. Add a record"
                f" in which drive{unused + 1} is active, or check which column it is read from."
            )
            found.append(Finding("drive", "fault", text, None, f"drive{unused + 1}", 0.0, None, "V"))
    if not any(record.role == "noise" for record in campaign.records):
        text = (
            "There is no silent record, so the noise level is estimated from repeated records or, without repeats, from"
            ' a local fit of the response. Add a record with all drives at zero and role = "noise".'
        )
        found.append(Finding("silence", "note", text))
    return found
