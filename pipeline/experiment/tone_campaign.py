"""Campaigns of sweeps and frequency responses, from the entries of campaign.toml."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import MeasurementError
from .envelopes import EnvelopeRecord
from .files.common_tables import DemodulationTable, DeviceTable
from .files.mapping import Source
from .files.readers import existing, read_columns
from .files.tone_columns import Quantity, tone_record
from .instrument import Instrument
from .record import Campaign, Role
from .tones import ToneCampaign, ToneKind, ToneRecord


class ToneEntry(Protocol):
    """What a [[record]] states about a sweep or a frequency response."""

    @property
    def file(self) -> str | list[str]:
        """Its file or files."""

    @property
    def name(self) -> str | None:
        """Its name; by default that of its first file."""

    @property
    def start(self) -> int:
        """First row."""

    @property
    def stop(self) -> int | None:
        """Row behind the last."""

    @property
    def rate_dps(self) -> float | None:
        """Declared angular rate [deg/s]."""

    @property
    def bias_v(self) -> float | None:
        """Declared bias [V]."""

    @property
    def quantity(self) -> Quantity:
        """What a frequency response is the ratio of."""

    @property
    def reference_ohm(self) -> float:
        """Reference impedance of S11 [ohm]."""

    @property
    def averages(self) -> int:
        """Averages of a coherence."""


def tone_records(
    folder: Path, entry: ToneEntry, role: Role, kind: ToneKind, columns: Mapping[str, Source]
) -> tuple[ToneRecord, ...]:
    """The record of an entry, a frequency response as one for each drive; its files are in ``folder``.

    Raises
    ------
    ConfigError, MeasurementError : as of ``files.tone_columns.tone_record``; a silent sweep.
    """
    names = [entry.file] if isinstance(entry.file, str) else entry.file
    if role == "noise":
        raise MeasurementError(
            f'{names[0]}: a {kind} cannot have role = "noise"',
            allowed="fit or validate",
            next_step="declare its noise (sense1_sd_V or H_s1d1_sd under [columns]), or leave the record out",
        )
    found = tone_record(
        entry.name or Path(names[0]).name,
        kind,
        [read_columns(existing(folder / name)) for name in names],
        columns,
        entry.start,
        entry.stop,
        entry.quantity,
        entry.reference_ohm,
        entry.averages,
    )
    return tuple(
        dataclasses.replace(record, role=role, rate_dps=entry.rate_dps, bias_v=entry.bias_v, file=names[0])
        for record in found
    )


def with_drives(timed: Campaign, drives: int) -> Campaign:
    """Free decays without drive columns as records of a device with ``drives`` drives, which are at rest."""
    if any(record.drive_v.shape[1] for record in timed.records):
        return timed
    silent = (
        dataclasses.replace(record, drive_v=np.zeros((record.sense_v.shape[0], drives))) for record in timed.records
    )
    return dataclasses.replace(timed, records=tuple(silent))


def tone_campaign(
    name: str,
    records: Sequence[ToneRecord],
    instrument: Instrument,
    device: DeviceTable,
    demodulation: DemodulationTable,
    reference: dict[str, tuple[float, float]],
    timed: Campaign | None,
    envelopes: tuple[EnvelopeRecord, ...] = (),
) -> ToneCampaign:
    """The campaign of ``records``; ``timed`` are its records in the time domain, ``envelopes`` amplitudes of free decays.

    Raises
    ------
    MeasurementError : the records have different channels.
    """
    shapes = {(record.sense_v.shape[1], record.drive_v.shape[1]) for record in records}
    if timed is not None:
        shapes |= {(record.sense_v.shape[1], record.drive_v.shape[1]) for record in timed.records}
    senses_seen = {senses for senses, _ in shapes} | {one.amplitude_v.shape[1] for one in envelopes}
    if len(shapes) > 1 or len(senses_seen) != 1:
        raise MeasurementError(
            "the records of a campaign have different channels",
            value=[
                *(f"{senses} senses, {drives} drives" for senses, drives in sorted(shapes)),
                *(f"{one.name}: {one.amplitude_v.shape[1]} senses" for one in envelopes),
            ],
            allowed="the same senses and drives in every record",
            next_step="put them into campaigns of their own",
        )
    return ToneCampaign(
        device_id=name,
        records=tuple(records),
        instrument=instrument,
        angular_gain=device.angular_gain,
        phase_error_deg=demodulation.phase_error_deg,
        drive=demodulation.drive,
        reference=reference,
        timed=timed,
        envelopes=envelopes,
    )
