"""Drive groups: records of equal sample rate, length and conditions whose drives are scaled copies of few waveforms.

    v_r[:, d] = sum_j gain[r, d, j] b_j

A campaign repeats a chirp, swaps it between the drives, changes its level or leaves one drive out.  The linear part of all
its records then follows from the responses to one or two waveforms.

Shapes: R records, N samples, N' steps of the clock, D drives, S senses, W waveforms.  Drives and waveforms in volts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ..instrument import Instrument
from ..record import Record
from .linear import SampleClock, clock_of, interpolated
from .system import Conditions, conditions_of

#: Two drives are scaled copies of each other if their samples differ by less than this share of the peak.
_SAME = 1e-13


@dataclass(frozen=True, eq=False)
class DriveGroup:
    """Records that share one clock and one set of conditions.

    Parameters
    ----------
    clock, conditions : of all records.
    drives : R arrays (N, D) of drive samples [V].
    waveforms : (W, N') [V] at the steps of the clock.
    gains : (R, D, W), the share of each waveform in each drive of each record.
    same_drive_as : (R,) index of the first record with the same drive samples.
    threads : number of records that are integrated at the same time.
    """

    clock: SampleClock
    conditions: Conditions
    drives: tuple[FloatArray, ...]
    waveforms: FloatArray
    gains: FloatArray
    same_drive_as: tuple[int, ...]
    threads: int = 1

    @property
    def sample_rate_hz(self) -> float:
        """Sample rate of the records [Hz]; the clock may step faster."""
        return 1.0 / (self.clock.step_s * self.clock.stride)


def highest_drive_energy(drives: Sequence[FloatArray]) -> int:
    """Index of the record with the highest mean squared drive, where nonlinear effects are strongest; drives (N, D) [V].

    Of records without a drive it is the first: the earliest piece of a decay moves most.
    """
    return max(range(len(drives)), key=lambda r: float(np.sum(drives[r] ** 2)) / drives[r].shape[0])


def waveforms_of(drives: Sequence[FloatArray], clock: SampleClock) -> tuple[FloatArray, FloatArray]:
    """Waveforms (W, N') [V] at the steps of the clock, and gains (R, D, W), of R arrays (N, D) of drive samples [V]."""
    found: list[FloatArray] = []
    entries: list[tuple[int, int, int, float]] = []
    for r, drive in enumerate(drives):
        for d in range(drive.shape[1]):
            v = np.ascontiguousarray(drive[:, d])
            peak = int(np.argmax(np.abs(v)))
            if v[peak] == 0.0:
                continue
            for w, b in enumerate(found):
                gain = v[peak] / b[peak] if b[peak] != 0.0 else 0.0
                if gain != 0.0 and float(np.max(np.abs(v - gain * b))) <= _SAME * abs(v[peak]):
                    entries.append((r, d, w, float(gain)))
                    break
            else:
                entries.append((r, d, len(found), 1.0))
                found.append(v)
    gains = np.zeros((len(drives), drives[0].shape[1], len(found)))
    for r, d, w, gain in entries:
        gains[r, d, w] = gain
    samples = drives[0].shape[0]
    if not found:
        return np.zeros((0, samples * clock.stride)), gains
    return np.ascontiguousarray(interpolated(np.array(found).T, clock).T), gains


def drive_group_of(
    records: Sequence[Record], instrument: Instrument, angular_gain: float | None, threads: int = 1
) -> DriveGroup:
    """The drive group of records that share sample rate, length and conditions; arguments as in ``forward``."""
    clock = clock_of(records[0].sample_rate_hz, instrument.hold)
    drives = tuple(record.drive_v for record in records)
    waveforms, gains = waveforms_of(drives, clock)
    first: list[int] = []
    for r, drive in enumerate(drives):
        same = (k for k in range(r) if first[k] == k and np.array_equal(drives[k], drive))
        first.append(next(same, r))
    return DriveGroup(
        clock,
        conditions_of(records[0], instrument, angular_gain),
        drives,
        waveforms,
        gains,
        tuple(first),
        threads,
    )


def single_record_group(group: DriveGroup, record: int) -> DriveGroup:
    """A drive group that holds one record (by index) of ``group``."""
    return replace(
        group, drives=(group.drives[record],), gains=group.gains[record : record + 1], same_drive_as=(0,), threads=1
    )


def drive_groups_of(
    records: Sequence[Record], instrument: Instrument, angular_gain: float | None, threads: int = 1
) -> tuple[tuple[tuple[int, ...], DriveGroup], ...]:
    """Drive groups that cover ``records``, each with the indices of its records."""
    members: dict[object, list[int]] = {}
    for i, record in enumerate(records):
        key = (record.drive_v.shape, record.sample_rate_hz, conditions_of(record, instrument, angular_gain))
        members.setdefault(key, []).append(i)
    return tuple(
        (tuple(places), drive_group_of([records[i] for i in places], instrument, angular_gain, threads))
        for places in members.values()
    )
