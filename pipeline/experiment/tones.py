"""Records in the frequency domain: the steady response of a device to single tones, row by row in the order of measurement.

    drive   v(t) = Re(V e^{i w t})            sense   s(t) = Re(Y e^{i w t}) + (other harmonics, which the detector rejects)

A stepped sweep of a lock-in amplifier has X + i Y = Y at the levels |V| of its drive; a row depends on those before it where
the device has several steady states, and where the detector had not settled.  A frequency response has unit drives, one
after the other, so that Y = H; it is linear, and its rows do not depend on each other.

Shapes: N rows, D drives, S senses.  Units: volts (amplitudes), seconds, hertz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..arrays import ComplexArray, FloatArray
from .envelopes import EnvelopeRecord
from .instrument import Instrument
from .record import Campaign, Role

ToneKind = Literal["sweep", "frf"]


@dataclass(frozen=True, eq=False, repr=False)
class ToneRecord:
    """Rows of one file that were measured one after the other.

    Parameters
    ----------
    name : file name, or the name that a simulation gives.
    kind : "sweep" (lock-in, free phase and offset, rows in time order) or "frf" (frequency response, linear).
    frequency_hz : (N,) of each tone [Hz].
    drive_v : (N, D) complex amplitude of each drive [V]; 1 for a frequency response.
    sense_v : (N, S) complex amplitude of each sense [V].
    time_s : (N,) when each row was read [s]; ``None`` where the file does not say.
    sd_v : (N, S) declared standard deviation of the real and of the imaginary part [V]; ``None`` where none is declared.
    role : "fit" or "validate".
    rate_dps, bias_v : declared conditions, as of a time record.
    file : of its [[record]] in campaign.toml.
    units : "drive<k>_V" or "sense<k>_V" -> SI unit where that is not volts.
    """

    name: str
    kind: ToneKind
    frequency_hz: FloatArray
    drive_v: ComplexArray
    sense_v: ComplexArray
    time_s: FloatArray | None = None
    sd_v: FloatArray | None = None
    role: Role | None = None
    rate_dps: float | None = None
    bias_v: float | None = None
    file: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        (rows, drives), senses = self.drive_v.shape, self.sense_v.shape[1]
        return f"<ToneRecord {self.name}, {self.role or 'no role'}: {self.kind}, {rows} rows, {drives} drives, {senses} senses>"

    @property
    def level_v(self) -> FloatArray:
        """(N,) largest drive amplitude of each row [V]."""
        return np.abs(self.drive_v).max(axis=1)


@dataclass(frozen=True, eq=False)
class ToneCampaign:
    """All frequency-domain records of one device, with its records in the time domain and its amplitudes of free decays, if any.

    The other fields are those of :class:`pipeline.experiment.record.Campaign`.
    """

    device_id: str
    records: tuple[ToneRecord, ...]
    instrument: Instrument
    angular_gain: float | None = None
    phase_error_deg: float = 0.0
    drive: Literal["f1", "f2"] = "f1"
    reference: dict[str, tuple[float, float]] = field(default_factory=dict)
    timed: Campaign | None = None
    envelopes: tuple[EnvelopeRecord, ...] = ()

    def with_role(self, role: Role) -> tuple[ToneRecord, ...]:
        """The records with this role, in order."""
        return tuple(record for record in self.records if record.role == role)

    @property
    def channels(self) -> tuple[int, int]:
        """Numbers of senses and drives of the device."""
        if self.records:
            return self.records[0].sense_v.shape[1], self.records[0].drive_v.shape[1]
        if self.timed is not None:
            return self.timed.records[0].sense_v.shape[1], self.timed.records[0].drive_v.shape[1]
        return self.envelopes[0].amplitude_v.shape[1], 0

    def with_fit_records(self) -> ToneCampaign:
        """The campaign; where no record has the role "fit", all have."""
        timed = () if self.timed is None else self.timed.with_role("fit")
        if self.with_role("fit") or timed or any(record.role != "validate" for record in self.envelopes):
            return self
        records = tuple(replace(record, role="fit") for record in self.records)
        return replace(self, records=records, envelopes=tuple(replace(one, role="fit") for one in self.envelopes))


@dataclass(frozen=True)
class SweepPass:
    """Rows ``first`` .. ``stop`` - 1 of a record, taken at one level and in one direction of the frequency.

    ``level`` is relative to the highest of the campaign; ``direction`` is "up", "down" or "flat"; ``drives`` names those that
    act.
    """

    record: int
    first: int
    stop: int
    level: float
    direction: str
    drives: str

    @property
    def rows(self) -> slice:
        """The rows of the pass in its record."""
        return slice(self.first, self.stop)


def passes_of(records: tuple[ToneRecord, ...]) -> tuple[SweepPass, ...]:
    """The passes of all ``records``, in order: maximal runs of rows of one drive level and one direction."""
    highest = max((float(record.level_v.max(initial=0.0)) for record in records), default=1.0) or 1.0
    found: list[SweepPass] = []
    for k, record in enumerate(records):
        level, f = record.level_v, record.frequency_hz
        same = np.abs(np.diff(level)) <= 1e-3 * np.maximum(level[1:], level[:-1])
        step = np.sign(np.diff(f))
        first = 0
        for i in range(1, f.size + 1):
            if i < f.size and same[i - 1] and (i - first < 2 or step[i - 1] == step[i - 2]):
                continue
            # A single row before a turn, such as the first of a level, belongs to what follows it.
            if i - first == 1 and i < f.size and same[i - 1]:
                continue
            found.append(_pass(record, k, first, i, highest))
            first = i
    return tuple(found)


def _pass(record: ToneRecord, k: int, first: int, stop: int, highest: float) -> SweepPass:
    rows = slice(first, stop)
    moved = float(np.median(np.diff(record.frequency_hz[rows]))) if stop - first > 1 else 0.0
    direction = "up" if moved > 0.0 else "down" if moved < 0.0 else "flat"
    amplitude = np.abs(record.drive_v[rows]).max(axis=0)
    active = [d + 1 for d in range(amplitude.size) if amplitude[d] > 1e-2 * amplitude.max(initial=0.0)]
    level = float(f"{record.level_v[rows].mean() / highest:.3g}")
    return SweepPass(k, first, stop, level, direction, "+".join(map(str, active)) or "none")
