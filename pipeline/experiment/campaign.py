"""Campaigns: a folder of records of one device with a campaign.toml, read and written.

    [device]         id, angular_gain = I_p / I_0p, pickoff = "velocity" | "displacement"; lot, wafer, package, die_x_mm, die_y_mm
    [conditions]     part, tester, session: of several campaigns of one device in a run (gauge R&R)
    [demodulation]   phase_error_deg, drive = "f1" | "f2"
    [instrument]     sample_rate_hz, hold, bias_v, antialias = {..}, adc = {..}
    [[record]]       file, role, rate_dps, bias_v, temperature_c, at_rest; name; start, stop (start <= n < stop of the file);
                     start_s, stop_s (the same in seconds from the first sample)
                     period_samples (of the drive; found where it repeats exactly): steady periods measure the noise
                     columns = {..}: as [columns] and in its place, where the files of records differ
                     kind = "decay": free motion from any initial state, without a drive (``decays.pieces``);
                     kind = "decay_amplitude": amplitude or power of a free decay against time (``files.envelope_columns``);
                     frequency_hz, amplitude = "peak" | "rms", time_constant_s, filter_poles, resolution_bandwidth_hz
                     kind = "sweep" | "frf" (also at the top, for all records); quantity, reference_ohm, averages: see
                     ``files.tone_columns``
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
    [layout]         electrodes that are not the paper's, after [channels]: what each sense column measures, what each drive turns
                     senses = [[1, 0], [0, 1]]    a pair per axis: rows (x, y), or (x, y, z) with its share of the up-down motion
                     drives = [[1, 0], [0, 1]]    torque about (x, y), or (x, y, z) with its force along z

Roles that are not stated: if no record validates, the last one does and the others fit; else all fit.  A single record fits.
A wrong campaign.toml is a :class:`ConfigError`, a file that is not a record a :class:`MeasurementError`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import msgspec

from .. import toml_files as toml
from ..errors import UsageError
from .campaign_tables import CampaignTable, RecordTable
from .decays.pieces import decay_pieces
from .envelope_campaign import envelope_of
from .files.channels import correct
from .files.columns import assemble
from .files.common_tables import (
    check_phase,
    references,
)
from .files.crop import between
from .files.mapping import Source
from .files.modal_record import ModalRecord, decode_modal_record
from .files.readers import existing, read_columns, read_records
from .files.together import at_temperatures, check_same_shape, from_first_sample, roles_of, with_all_drives
from .instrument import Instrument
from .layout import layout_of
from .record import PAPER_FRAME, Campaign, Channels, Record, Role
from .tone_campaign import tone_campaign, tone_records, with_drives
from .tones import ToneCampaign, ToneKind, ToneRecord
from .write_campaign import write_campaign

__all__ = ["read_campaign", "read_measurement", "write_campaign"]


def _records_of(
    folder: Path, entry: RecordTable, role: Role, rate: float | None, document: CampaignTable
) -> list[Record]:
    """The record of an entry; more than one where samples are missing."""
    names = [entry.file] if isinstance(entry.file, str) else entry.file
    files = [read_columns(existing(folder / name)) for name in names]
    found = assemble(names[0], files, rate, _columns(entry, document), entry.start, entry.stop)
    found = between(found, entry.start_s, entry.stop_s)
    name = entry.name if entry.name is not None else names[0]
    records = [
        dataclasses.replace(
            record,
            name=name + record.name.removeprefix(names[0]),
            role=role,
            at_rest=record.at_rest and entry.at_rest,
            rate_dps=entry.rate_dps,
            bias_v=entry.bias_v,
            temperature_c=entry.temperature_c,
            file=names[0],
            period_samples=entry.period_samples,
        )
        for record in found
    ]
    if entry.kind == "decay":
        return [piece for record in records for piece in decay_pieces(record, entry.role)]
    return records


def _columns(entry: RecordTable, document: CampaignTable) -> dict[str, Source]:
    """The mapping of an entry: its own, else [columns]."""
    return document.columns if entry.columns is None else entry.columns


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
    document = _document(file, text)
    if tones := [entry for entry in document.record if _kind(entry, document) != "time"]:
        raise UsageError(
            "this needs records in the time domain",
            value=f'{file.name}: {tones[0].file} has kind = "{_kind(tones[0], document)}"',
            allowed="compare, diagnose, refine and check take sweeps and frequency responses",
            next_step=f"gyroscreen refine {path}",
        )
    return _timed(file, document)


def _document(file: Path, text: bytes | None = None) -> CampaignTable:
    document = toml.decode(toml.read_bytes(existing(file)) if text is None else text, CampaignTable, file.name)
    check_phase(document.demodulation, document.systematic, file.name)
    return document


def _kind(entry: RecordTable, document: CampaignTable) -> ToneKind | Literal["time", "decay_amplitude"]:
    """The domain of a record: that of its own kind, else of the campaign."""
    if entry.kind == "decay":
        return "time"
    return entry.kind or ("time" if document.kind == "campaign" else document.kind)


def _timed(file: Path, document: CampaignTable) -> Campaign:
    """The campaign of the records of ``document``, all in the time domain."""
    rate = document.instrument.sample_rate_hz
    records: list[Record] = []
    for entry, role in zip(document.record, roles_of([entry.role for entry in document.record])):
        known = rate if rate is not None or not records else records[0].sample_rate_hz
        records += _records_of(file.parent, entry, role, known, document)
    channels = Channels(**msgspec.structs.asdict(document.channels))
    free = any(entry.kind == "decay" for entry in document.record)
    records = [correct(record, channels) for record in with_all_drives(from_first_sample(records), free)]
    frame = PAPER_FRAME
    if document.layout is not None:
        layout = layout_of(document.layout.senses, document.layout.drives)
        frame, records = layout.frame, [layout.applied(record) for record in records]
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
        channels=channels,
        systematic=systematic,
        frame=frame,
        operation=document.operation.built(),
    )


def _toned(file: Path, document: CampaignTable) -> ToneCampaign:
    """The sweeps and frequency responses of ``document``, with its time records beside them."""
    timed, envelopes, own = (
        [entry for entry in document.record if of(_kind(entry, document))]
        for of in (lambda k: k == "time", lambda k: k == "decay_amplitude", lambda k: k in ("sweep", "frf"))
    )
    records: list[ToneRecord] = []
    for entry, role in zip(own, roles_of([entry.role for entry in own])):
        kind: ToneKind = "frf" if _kind(entry, document) == "frf" else "sweep"
        records += tone_records(file.parent, entry, role, kind, _columns(entry, document))
    whole = _timed(file, msgspec.structs.replace(document, record=timed, kind="campaign")) if timed else None
    if whole is not None:
        whole = with_drives(whole, max((record.drive_v.shape[1] for record in records), default=0))
    decays = tuple(envelope_of(file.parent, entry, entry.role, _columns(entry, document)) for entry in envelopes)
    device, name = document.device, document.device.id or file.absolute().parent.name
    instrument = document.instrument.built(1.0).with_pickoff(device.pickoff)
    return tone_campaign(
        name,
        records,
        instrument,
        device,
        document.demodulation,
        references(document.reference, file.name),
        whole,
        decays,
    )


def read_measurement(path: Path) -> Campaign | ModalRecord | ToneCampaign:
    """The measurement at ``path``: a campaign (folder or campaign.toml), a modal record, or a single record.

    A single record becomes a campaign of one record, with the default instrument at the sample rate of its time column.

    Raises
    ------
    ConfigError, MeasurementError : as :func:`read_campaign` and :func:`read_modal_record`.
    """
    existing(path)
    if path.is_dir() or path.suffix.lower() == ".toml":
        modal = None if path.is_dir() else decode_modal_record(toml.read_bytes(path), path)
        if modal is not None:
            return modal
        file = path / "campaign.toml" if path.is_dir() else path
        document = _document(file)
        if any(_kind(entry, document) != "time" for entry in document.record):
            return _toned(file, document)
        return _timed(file, document)
    found = [dataclasses.replace(record, role="fit") for record in read_records(path, None)]
    records = tuple(with_all_drives(found))
    return Campaign(device_id=path.stem, records=records, instrument=Instrument(records[0].sample_rate_hz))
