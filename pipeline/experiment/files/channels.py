"""Apply [channels] of campaign.toml to a record: offsets, polarity, order and lag.

Shapes: N samples, D drives, S senses.  Units: volts, samples.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ...arrays import FloatArray
from ...errors import ConfigError
from ..record import Channels, Record
from .clock import MIN_SAMPLES


def _per_channel(
    values: tuple[float, ...] | None, count: int, what: str, *, permutation: bool = False
) -> FloatArray | None:
    if values is None:
        return None
    wanted = f"a permutation of 1..{count}" if permutation else f"one value per column of the files ({count})"
    if len(values) != count or (permutation and sorted(values) != list(range(1, count + 1))):
        raise ConfigError(
            f"[channels] {what} does not match the columns of the records",
            value=list(values),
            allowed=wanted,
            next_step=f"correct {what} in campaign.toml",
        )
    return np.array(values)


def correct(record: Record, channels: Channels) -> Record:
    """``record`` with ``channels`` applied, in the order that :class:`Channels` states.

    A lag shortens the record by its number of samples.

    Raises
    ------
    ConfigError : ``channels`` is for another number of channels, or the lag leaves too few samples.
    """
    drive, sense = record.drive_v, record.sense_v
    if (offset := _per_channel(channels.drive_offset_v, drive.shape[1], "drive_offset_v")) is not None:
        drive = drive - offset
    if (sign := _per_channel(channels.drive_polarity, drive.shape[1], "drive_polarity")) is not None:
        drive = drive * sign
    if (sign := _per_channel(channels.sense_polarity, sense.shape[1], "sense_polarity")) is not None:
        sense = sense * sign
    if (order := _per_channel(channels.drive_order, drive.shape[1], "drive_order", permutation=True)) is not None:
        drive = drive[:, order.astype(np.int64) - 1]
    if (order := _per_channel(channels.sense_order, sense.shape[1], "sense_order", permutation=True)) is not None:
        sense = sense[:, order.astype(np.int64) - 1]
    lag, at_rest = channels.lag_samples, record.at_rest
    if lag:
        count = drive.shape[0] - abs(lag)
        if count < MIN_SAMPLES:
            raise ConfigError(
                f"[channels] lag_samples leaves fewer than {MIN_SAMPLES} samples of {record.name}",
                value=lag,
                allowed=f"at most {drive.shape[0] - MIN_SAMPLES} in absolute value",
                next_step="correct lag_samples in campaign.toml",
            )
        # A negative lag drops the first drive samples; unless they were zero, the device already moves at the new start.
        at_rest = at_rest and (lag > 0 or not np.any(drive[:-lag]))
        drive, sense = (drive[:count], sense[lag:]) if lag > 0 else (drive[-lag:], sense[:count])
    return dataclasses.replace(record, drive_v=drive, sense_v=sense, at_rest=at_rest)
