"""Campaigns: a folder of records of one device with a campaign.toml, read and written.

    [device]         id, angular_gain = I_p / I_0p, pickoff = "velocity" | "displacement"
    [demodulation]   phase_error_deg, drive = "f1" | "f2"
    [instrument]     sample_rate_hz, hold, bias_v, antialias = {..}, adc = {..}
    [[record]]       file, role, rate_dps, bias_v, temperature_c, at_rest; name; start, stop (start <= n < stop of the file)
    [systematic]     sds of errors that the devices of a tester share: phase_error_sd_deg, angular_gain_sd, gain_sd (relative),
                     clock_sd_ppm, temperature_sd_c with tcf_ppm_per_c
    [operation]      how the gyro is operated, for performance figures (``performance.operating_point``): drive_amplitude_v, ..
    [reference]      quantity = [value, sd]
    [columns]        drive1_V = "V1"      column of the files by name, number or table with unit, gain, offset (``files.mapping``)
    [channels]       corrections of the files (``check`` prints these lines), applied in this order:
                     drive_offset_v = [5.0, 5.0]  subtracted from the drive columns of the files
                     sense_polarity = [1, -1]     factor of each sense column; drive_polarity likewise
                     sense_order = [2, 1]         sense1 of the record is sense2 of the files; drive_order likewise
                     lag_samples = 3              sense is 3 samples late: drive[n] is paired with sense[n + 3]

Roles that are not stated: if no record validates, the last one does and the others fit; else all fit.  A single record fits.
A wrong campaign.toml is a :class:`ConfigError`, a file that is not a record a :class:`MeasurementError`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from .. import toml_files as toml
from ..arrays import FloatArray
from ..errors import UsageError
from .files.channels import correct
from .files.columns import assemble
from .files.common_tables import (
    DemodulationTable,
    DeviceTable,
    InstrumentTable,
    OperationTable,
    References,
    SystematicTable,
    Value,
    check_phase,
    references,
)
from .files.mapping import Source
from .files.modal_record import ModalRecord, decode_modal_record
from .files.readers import existing, read_columns, read_records, write_columns
from .files.together import at_temperatures, check_same_shape, with_all_drives
from .instrument import Instrument
from .record import Campaign, Channels, Record, Role
from .systematic import EXACT

Sign = Literal[-1, 1]
FileName = Annotated[str, Meta(min_length=1)]


class RecordTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[record]]``: a file or files, role, conditions [deg/s, V], and its samples ``start`` to ``stop`` (exclusive)."""

    file: FileName | Annotated[list[FileName], Meta(min_length=1, max_length=8)]
    name: str | None = None
    role: Role | None = None
    rate_dps: Value | None = None
    bias_v: Value | None = None
    temperature_c: Annotated[float, Meta(ge=-273.15, le=1000.0)] | None = None
    at_rest: bool = True
    start: Annotated[int, Meta(ge=0)] = 0
    stop: Annotated[int, Meta(ge=1)] | None = None


class ChannelsTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[channels]``: corrections of the files, in the units of :class:`pipeline.experiment.record.Channels`."""

    sense_polarity: tuple[Sign, ...] | None = None
    drive_polarity: tuple[Sign, ...] | None = None
    sense_order: tuple[Annotated[int, Meta(ge=1)], ...] | None = None
    drive_order: tuple[Annotated[int, Meta(ge=1)], ...] | None = None
    drive_offset_v: tuple[Value, ...] | None = None
    lag_samples: int = 0


class CampaignTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A campaign.toml."""

    record: Annotated[list[RecordTable], Meta(min_length=1)]
    kind: Literal["campaign"] = "campaign"
    device: DeviceTable = DeviceTable()
    demodulation: DemodulationTable = DemodulationTable()
    instrument: InstrumentTable = InstrumentTable()
    systematic: SystematicTable = SystematicTable()
    operation: OperationTable = OperationTable()
    reference: References = {}
    columns: dict[str, Source] = {}
    channels: ChannelsTable = ChannelsTable()


def _roles(declared: Sequence[Role | None]) -> list[Role]:
    undeclared = [k for k, role in enumerate(declared) if role is None]
    others_fit = len(undeclared) > 1 or "fit" in declared
    last = undeclared[-1] if undeclared and others_fit and "validate" not in declared else None
    return [role if role is not None else "validate" if k == last else "fit" for k, role in enumerate(declared)]


def _records_of(
    folder: Path, entry: RecordTable, role: Role, rate: float | None, document: CampaignTable
) -> list[Record]:
    """The record of an entry; more than one where samples are missing."""
    names = [entry.file] if isinstance(entry.file, str) else entry.file
    files = [read_columns(existing(folder / name)) for name in names]
    found = assemble(names[0], files, rate, document.columns, entry.start, entry.stop)
    name = entry.name if entry.name is not None else names[0]
    return [
        dataclasses.replace(
            record,
            name=name + record.name.removeprefix(names[0]),
            role=role,
            at_rest=record.at_rest and entry.at_rest,
            rate_dps=entry.rate_dps,
            bias_v=entry.bias_v,
            temperature_c=entry.temperature_c,
            file=names[0],
        )
        for record in found
    ]


def _channels(table: ChannelsTable) -> Channels:
    return Channels(**msgspec.structs.asdict(table))


def read_campaign(path: Path, text: bytes | None = None) -> Campaign:
    """All records of a campaign, corrected as [channels] states, with their roles.

    ``path`` is the folder or its campaign.toml; file names are relative to that folder.  ``text`` is used in place of the content
    of campaign.toml.  If ``sample_rate_hz`` is not stated, the time column of the first record determines it for all.

    Raises
    ------
    ConfigError : a wrong key or value in campaign.toml.
    MeasurementError : a file is missing or is not a record.
    """
    file = path / "campaign.toml" if path.is_dir() else path
    document = toml.decode(toml.read_bytes(existing(file)) if text is None else text, CampaignTable, file.name)
    check_phase(document.demodulation, document.systematic, file.name)
    rate = document.instrument.sample_rate_hz
    records: list[Record] = []
    for entry, role in zip(document.record, _roles([entry.role for entry in document.record])):
        known = rate if rate is not None or not records else records[0].sample_rate_hz
        records += _records_of(file.parent, entry, role, known, document)
    records = [correct(record, _channels(document.channels)) for record in with_all_drives(records)]
    check_same_shape(records)
    systematic = document.systematic.built()
    return Campaign(
        device_id=document.device.id or file.absolute().parent.name,
        records=at_temperatures(records, systematic.tcf_ppm_per_c),
        instrument=document.instrument.built(records[0].sample_rate_hz).with_pickoff(document.device.pickoff),
        angular_gain=document.device.angular_gain,
        phase_error_deg=document.demodulation.phase_error_deg,
        drive=document.demodulation.drive,
        reference=references(document.reference, file.name),
        channels=_channels(document.channels),
        systematic=systematic,
        operation=document.operation.built(),
    )


def read_measurement(path: Path) -> Campaign | ModalRecord:
    """The measurement at ``path``: a campaign (folder or campaign.toml), a modal record, or a single record.

    A single record becomes a campaign of one record, with the default instrument at the sample rate of its time column.

    Raises
    ------
    ConfigError, MeasurementError : as :func:`read_campaign` and :func:`read_modal_record`.
    """
    existing(path)
    if path.is_dir():
        return read_campaign(path)
    if path.suffix.lower() == ".toml":
        modal = decode_modal_record(toml.read_bytes(path), path)
        return modal if modal is not None else read_campaign(path)
    found = [dataclasses.replace(record, role="fit") for record in read_records(path, None)]
    records = tuple(with_all_drives(found))
    return Campaign(device_id=path.stem, records=records, instrument=Instrument(records[0].sample_rate_hz))


def _vectors(record: Record) -> dict[str, FloatArray]:
    count = record.drive_v.shape[0]
    columns = {"time_s": np.arange(count) / record.sample_rate_hz}
    columns |= {f"drive{k + 1}_V": np.ascontiguousarray(v) for k, v in enumerate(record.drive_v.T)}
    columns |= {f"sense{k + 1}_V": np.ascontiguousarray(v) for k, v in enumerate(record.sense_v.T)}
    return columns


def write_campaign(campaign: Campaign, folder: Path, *, format: str = "parquet") -> None:
    """Write ``campaign`` so that :func:`read_campaign` returns the same numbers.

    The records are written with their corrections applied, so ``channels`` is not written.  campaign.toml is written last: a
    folder that contains it is complete.

    Raises
    ------
    UsageError : the sample rate of a record differs from that of the instrument, or the folder cannot be written.
    """
    entries = []
    for k, record in enumerate(campaign.records, start=1):
        if record.sample_rate_hz != campaign.instrument.sample_rate_hz:
            raise UsageError(
                f"{record.name} has a different sample rate from the instrument",
                value=record.sample_rate_hz,
                allowed=f"{campaign.instrument.sample_rate_hz} Hz",
                next_step="resample it, or write it to a separate campaign",
            )
        file = write_columns(folder, f"record-{k}", _vectors(record), format).name
        conditions = {
            "role": record.role,
            "rate_dps": record.rate_dps,
            "bias_v": record.bias_v,
            "temperature_c": record.temperature_c,
        }
        name = record.name if record.name != file else None
        at_rest = None if record.at_rest else False
        entries.append(toml.table("[[record]]", {"file": file, "name": name, **conditions, "at_rest": at_rest}))
    instrument = campaign.instrument
    filter_ = instrument.with_pickoff("velocity").antialias
    pickoff = {} if instrument.pickoff == "velocity" else {"pickoff": instrument.pickoff}
    text = "\n".join(
        part
        for part in [
            toml.table(
                "[device]", {"id": campaign.device_id or None, "angular_gain": campaign.angular_gain, **pickoff}
            ),
            toml.table("[demodulation]", {"phase_error_deg": campaign.phase_error_deg, "drive": campaign.drive}),
            toml.table(
                "[instrument]",
                {
                    "sample_rate_hz": instrument.sample_rate_hz,
                    "hold": instrument.hold,
                    "bias_v": instrument.bias_v,
                    "antialias": None if filter_ is None else filter_.table,
                    "adc": None if instrument.adc is None else dataclasses.asdict(instrument.adc),
                },
            ),
            "" if campaign.systematic == EXACT else toml.table("[systematic]", dataclasses.asdict(campaign.systematic)),
            toml.table("[operation]", dataclasses.asdict(campaign.operation)),
            *entries,
            toml.table("[reference]", {name: list(pair) for name, pair in campaign.reference.items()}),
        ]
        if part
    )
    try:
        staged = folder / ".campaign.toml.part"
        staged.write_text(text, encoding="utf-8")
        staged.replace(folder / "campaign.toml")
    except OSError as error:
        raise UsageError(
            "campaign.toml cannot be written",
            value=f"{folder}: {error}",
            next_step="choose another folder",
        ) from error
