"""Records and campaigns: one run of an experiment, and all records of one device.

Shapes: N samples, D drives, S senses.  Units: volts, seconds, hertz; rates in deg/s as on a rate table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..performance.operating_point import UNDECLARED, DeclaredOperation
from .instrument import Instrument
from .systematic import EXACT, Systematic

Role = Literal["noise", "fit", "validate"]
BadReason = Literal["spike", "stuck", "dropout", "full_scale"]


@dataclass(frozen=True)
class Clock:
    """Sample rate and jitter of the time column of a record.

    Parameters
    ----------
    sample_rate_hz : (N - 1) / (t[N-1] - t[0]) [Hz].
    jitter_samples : largest distance of a time stamp from the uniform grid, in samples.
    start_s : time stamp of the first sample [s].
    """

    sample_rate_hz: float
    jitter_samples: float
    start_s: float = 0.0


@dataclass(frozen=True)
class Channels:
    """Corrections that turn the columns of the files into the channels of the records; the defaults change nothing.

    They are applied in this order: ``drive_offset_v[k-1]`` [V] is subtracted from drive column k; column k is multiplied by
    ``*_polarity[k-1]`` (+1 or -1); channel k of the record becomes column ``*_order[k-1]``; sense sample n + ``lag_samples``
    is paired with drive sample n.
    """

    sense_polarity: tuple[int, ...] | None = None
    drive_polarity: tuple[int, ...] | None = None
    sense_order: tuple[int, ...] | None = None
    drive_order: tuple[int, ...] | None = None
    drive_offset_v: tuple[float, ...] | None = None
    lag_samples: int = 0


@dataclass(frozen=True)
class BadStretch:
    """Bad samples ``first`` .. ``stop`` - 1 of a sense channel (counted from 0), and why they are bad."""

    channel: int
    first: int
    stop: int
    reason: BadReason

    def seconds(self, sample_rate_hz: float) -> dict[str, Any]:
        """Its ends ``time_s`` [s], number of ``samples`` and ``reason``, as the JSON answers state them."""
        ends = (self.first / sample_rate_hz, self.stop / sample_rate_hz)
        return {"time_s": ends, "samples": self.stop - self.first, "reason": self.reason}


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """One uniformly sampled run of an experiment.

    Parameters
    ----------
    name : file name, or the name that a simulation gives.
    sample_rate_hz : f_s [Hz].
    drive_v : (N, D) commanded drive samples without the bias [V].
    sense_v : (N, S) sense samples [V].
    role : "noise" (silent), "fit" or "validate"; ``None`` where none was declared.
    at_rest : whether the device was at rest before the first sample.
    rate_dps : declared angular rate [deg/s]; ``None`` means unknown.
    bias_v : bias during this record [V]; ``None`` means the bias of the instrument.
    temperature_c : declared temperature [deg C]; ``None`` means unknown.
    frequency_shift : relative shift of all natural frequencies [1] that follows from the declared temperature.
    clock : sample rate and jitter of its time column; ``None`` where there was no time column.
    file : file of its [[record]] in campaign.toml; ``None`` where it was not read from a campaign.
    units : "drive<k>_V" or "sense<k>_V" -> the SI unit of its samples where that is not volts.
    bad : bad samples, which every fit leaves out; ``None`` where they were not sought (see ``experiment.bad_samples``).
    period_samples : declared period of the drive; ``None`` means that of a drive that repeats exactly, if it does.
    elapsed_s : time from the start of the run to the first sample [s]; a piece of a run begins later than the run.
    """

    name: str
    sample_rate_hz: float
    drive_v: FloatArray
    sense_v: FloatArray
    role: Role | None = None
    at_rest: bool = True
    rate_dps: float | None = None
    bias_v: float | None = None
    temperature_c: float | None = None
    frequency_shift: float = 0.0
    clock: Clock | None = None
    file: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    bad: tuple[BadStretch, ...] | None = None
    elapsed_s: float = 0.0
    period_samples: int | None = None

    def __repr__(self) -> str:
        (samples, drives), senses = self.drive_v.shape, self.sense_v.shape[1]
        what = f"{samples} samples at {self.sample_rate_hz:g} Hz, {drives} drives, {senses} senses"
        return f"<Record {self.name}, {self.role or 'no role'}: {what}>"

    @property
    def good(self) -> BoolArray | None:
        """(N, S) whether each sense sample is good; ``None`` where all are."""
        if not self.bad:
            return None
        good = np.ones(self.sense_v.shape, dtype=bool)
        for one in self.bad:
            good[one.first : one.stop, one.channel] = False
        return good

    @property
    def duration_s(self) -> float:
        """N / f_s [s]."""
        return self.drive_v.shape[0] / self.sample_rate_hz


@dataclass(frozen=True)
class Frame:
    """Angles [deg] of the paper's sense and drive electrodes in the frame of theta; whether they see an up-down mode."""

    angles_deg: tuple[float, float] = (0.0, 0.0)
    updown: bool = True


PAPER_FRAME = Frame()


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """All records of one device.

    Parameters
    ----------
    device_id : name of the device.
    records : in the order of ``campaign.toml``, roles filled in.
    instrument : shared by the records.
    angular_gain : kappa = I_p / I_0p, or ``None`` (then no rate bias can be computed).
    phase_error_deg : phase error of the demodulation [deg].
    drive : the mode whose frequency is omega_0 of the drive loop.
    reference : quantity -> (value, sd) from another instrument, in the units of the results columns.
    channels : corrections that were applied when the files were read.
    systematic : standard deviations of the errors of the tester, which its devices share.
    frame : of the electrodes, which are those of the paper or were made from others (:mod:`pipeline.experiment.layout`).
    operation : how the gyro is operated, as far as declared.
    """

    device_id: str
    records: tuple[Record, ...]
    instrument: Instrument
    angular_gain: float | None = None
    phase_error_deg: float = 0.0
    drive: Literal["f1", "f2"] = "f1"
    reference: dict[str, tuple[float, float]] = field(default_factory=dict)
    channels: Channels = field(default_factory=Channels)
    systematic: Systematic = EXACT
    frame: Frame = PAPER_FRAME
    operation: DeclaredOperation = UNDECLARED

    def __repr__(self) -> str:
        return "\n  ".join([f"<Campaign {self.device_id}: {len(self.records)} records>", *map(repr, self.records)])

    def with_role(self, role: Role) -> tuple[Record, ...]:
        """The records with this role, in order."""
        return tuple(record for record in self.records if record.role == role)
