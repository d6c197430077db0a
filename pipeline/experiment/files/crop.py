"""start_s and stop_s of a [[record]]: the samples between two times, counted in seconds from the first sample of the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

from ...errors import ConfigError
from ..record import Record
from .clock import MIN_SAMPLES


def between(records: Sequence[Record], start_s: float | None, stop_s: float | None) -> tuple[Record, ...]:
    """The samples with start_s <= t < stop_s [s] of the pieces of a file; a piece that keeps too few is left out.

    Raises
    ------
    ConfigError : too few samples are left.
    """
    if start_s is None and stop_s is None:
        return tuple(records)
    first, kept = records[0], []
    origin = 0.0 if first.clock is None else first.clock.start_s
    end = 0.0
    for record in records:
        rate, samples = record.sample_rate_hz, record.sense_v.shape[0]
        offset = 0.0 if record.clock is None else record.clock.start_s - origin
        low = 0 if start_s is None else min(max(ceil((start_s - offset) * rate - 1e-6), 0), samples)
        high = samples if stop_s is None else min(max(ceil((stop_s - offset) * rate - 1e-6), 0), samples)
        end = offset + samples / rate
        if high - low >= MIN_SAMPLES:
            part = slice(low, high)
            at_rest = record.at_rest and low == 0
            kept.append(
                replace(
                    record,
                    drive_v=record.drive_v[part],
                    sense_v=record.sense_v[part],
                    at_rest=at_rest,
                    elapsed_s=record.elapsed_s + low / rate,
                )
            )
    if not kept:
        raise ConfigError(
            f"{first.name}: start_s and stop_s leave no samples",
            value=[start_s, stop_s],
            allowed=f"0 <= start_s < stop_s <= {end:.6g}, at least {MIN_SAMPLES} samples (seconds from the first sample)",
            next_step="correct start_s and stop_s of this [[record]]",
        )
    return tuple(kept)
