"""Records that one system answers together: few waveforms, played through the drives at several levels.

    v_r[:, d] = sum_j gain[r, d, j] b_j

A campaign repeats a chirp, turns it round, changes its level, leaves one drive out: the linear part of all its records is
made of the answers to one or two waveforms.

Shapes: R records, N samples, D drives, S senses, W waveforms.
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

#: Samples of two waveforms that are one differ by less, as a share of their peak.
_SAME = 1e-13


@dataclass(frozen=True, eq=False)
class DriveGroup:
    """Records of one clock and one set of conditions.

    Parameters
    ----------
    clock, conditions : of all of them.
    drives : R times (N, D) samples [V].
    waveforms : (W, N') at the clock's steps; gains (R, D, W).
    same_drive_as : for each record the first one with the same drive samples.
    threads : how many records are integrated at once.
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
        """Of the records, not of the clock's steps."""
        return 1.0 / (self.clock.step_s * self.clock.stride)


def highest_drive_energy(drives: Sequence[FloatArray]) -> int:
    """The record with the most drive energy a sample: it tells how strong nonlinear effects are."""
    return max(range(len(drives)), key=lambda r: float(np.mean(drives[r] ** 2)))


def waveforms_of(drives: Sequence[FloatArray], clock: SampleClock) -> tuple[FloatArray, FloatArray]:
    """Waveforms (W, N') at the clock's steps and gains (R, D, W) of drive samples, R times (N, D)."""
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
    """The play of records that share sample rate, length and conditions."""
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
    """One record of a play."""
    return replace(
        group, drives=(group.drives[record],), gains=group.gains[record : record + 1], same_drive_as=(0,), threads=1
    )


def drive_groups_of(
    records: Sequence[Record], instrument: Instrument, angular_gain: float | None, threads: int = 1
) -> tuple[tuple[tuple[int, ...], DriveGroup], ...]:
    """Plays that cover ``records``, each with the places of its records."""
    groups: dict[object, list[int]] = {}
    for i, record in enumerate(records):
        key = (record.drive_v.shape, record.sample_rate_hz, conditions_of(record, instrument, angular_gain))
        groups.setdefault(key, []).append(i)
    return tuple(
        (tuple(places), drive_group_of([records[i] for i in places], instrument, angular_gain, threads))
        for places in groups.values()
    )
