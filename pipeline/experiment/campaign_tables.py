"""The keys of campaign.toml, each with its type, range, default and meaning; :mod:`.campaign` reads and uses them."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from ..toml_keys import Meaning
from .files.common_tables import (
    ConditionsTable,
    DemodulationTable,
    DeviceTable,
    InstrumentTable,
    OperationTable,
    Positive,
    References,
    SystematicTable,
    Value,
)
from .files.mapping import Source
from .files.tone_columns import Quantity
from .record import Role
from .tones import ToneKind

Sign = Literal[-1, 1]
FileName = Annotated[str, Meta(min_length=1)]


class RecordTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[record]]``: a file or files, role, conditions [deg/s, V], and its samples ``start`` to ``stop`` (exclusive)."""

    file: Annotated[
        FileName | Annotated[list[FileName], Meta(min_length=1, max_length=8)],
        Meaning("file of the record, relative to campaign.toml; a list where its columns are in several files"),
    ]
    name: Annotated[str | None, Meaning("name of the record in answers; absent: the file")] = None
    role: Annotated[
        Role | None,
        Meaning(
            "noise: silent; fit: fitted; validate: held out. Absent everywhere: the last record validates, the others fit"
        ),
    ] = None
    rate_dps: Annotated[Value | None, Meaning("constant angular rate during the record; absent: unknown")] = None
    bias_v: Annotated[Value | None, Meaning("bias during the record; absent: that of [instrument]")] = None
    temperature_c: Annotated[
        Annotated[float, Meta(ge=-273.15, le=1000.0)] | None,
        Meaning("temperature of the device during the record; absent: unknown"),
    ] = None
    at_rest: Annotated[bool, Meaning("whether the device is at rest before the first sample")] = True
    start: Annotated[
        int, Meta(ge=0), Meaning("first sample, or first row of a sweep, that is used, counted from 0", "1")
    ] = 0
    stop: Annotated[
        Annotated[int, Meta(ge=1)] | None,
        Meaning("first sample or row that is no longer used; absent: all that follow", "1"),
    ] = None
    period_samples: Annotated[
        Annotated[int, Meta(ge=16)] | None,
        Meaning(
            "period of the drive; absent: found where the drive repeats exactly. Steady periods measure the noise",
            "samples",
        ),
    ] = None
    start_s: Annotated[
        Annotated[float, Meta(ge=0.0, le=1e9)] | None, Meaning("first time that is used, from the first sample")
    ] = None
    stop_s: Annotated[
        Annotated[float, Meta(gt=0.0, le=1e9)] | None,
        Meaning("first time that is no longer used; absent: all that follow"),
    ] = None
    kind: Annotated[
        ToneKind | Literal["time", "decay", "decay_amplitude"] | None,
        Meaning(
            "time: driven or silent; decay: free motion; decay_amplitude: its amplitude against time; sweep: stepped lock-in"
            " sweep; frf: frequency response. Absent: the kind of the campaign"
        ),
    ] = None
    quantity: Annotated[Quantity, Meaning("quantity that a frequency response states, per drive")] = "response"
    reference_ohm: Annotated[Positive, Meaning("reference impedance of S11, or of a power")] = 50.0
    averages: Annotated[int, Meta(ge=1), Meaning("averages behind a coherence, or behind the power of a row", "1")] = 1
    frequency_hz: Annotated[
        Positive | None, Meaning("of a decay_amplitude: reference of the lock-in amplifier, or centre of the analyzer")
    ] = None
    amplitude: Annotated[
        Literal["peak", "rms"], Meaning("of a decay_amplitude in volts: whether the columns are peak or rms values")
    ] = "peak"
    time_constant_s: Annotated[Positive | None, Meaning("time constant of the detector; absent: fast")] = None
    filter_poles: Annotated[
        Annotated[int, Meta(ge=1, le=8)] | None,
        Meaning("poles of the filter of the detector; absent: 1, or 4 for an analyzer", "1"),
    ] = None
    resolution_bandwidth_hz: Annotated[
        Positive | None, Meaning("resolution bandwidth of the analyzer, in place of time_constant_s")
    ] = None
    columns: Annotated[dict[str, Source] | None, Meaning("columns of this record, in place of those in [columns]")] = (
        None
    )


class ChannelsTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[channels]``: corrections of the files, in the units of :class:`pipeline.experiment.record.Channels`."""

    sense_polarity: Annotated[
        tuple[Sign, ...] | None, Meaning("factor of each sense column: 1, or -1 where the wires are exchanged", "1")
    ] = None
    drive_polarity: Annotated[tuple[Sign, ...] | None, Meaning("factor of each drive column", "1")] = None
    sense_order: Annotated[
        tuple[Annotated[int, Meta(ge=1)], ...] | None,
        Meaning("column of the files for sense 1, 2, ..; [2, 1] exchanges two", "1"),
    ] = None
    drive_order: Annotated[
        tuple[Annotated[int, Meta(ge=1)], ...] | None, Meaning("column of the files for drive 1, 2, ..", "1")
    ] = None
    drive_offset_v: Annotated[
        tuple[Value, ...] | None, Meaning("subtracted from each drive column, for files that contain the bias")
    ] = None
    lag_samples: Annotated[
        int,
        Meaning("delay of the senses against the drives: drive sample n belongs to sense sample n + lag", "samples"),
    ] = 0


class LayoutTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[layout]``: a row (x, y) or (x, y, z) for each sense column and each drive column (:mod:`pipeline.experiment.layout`)."""

    senses: Annotated[
        Annotated[list[list[Value]], Meta(min_length=2, max_length=64)] | None,
        Meaning(
            "what each sense column measures: its share of the rocking about x and y, and of the motion along z", "1"
        ),
    ] = None
    drives: Annotated[
        Annotated[list[list[Value]], Meta(min_length=2, max_length=64)] | None,
        Meaning("what each drive column does: its torque about x and y, and its force along z", "1"),
    ] = None


class CampaignTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A campaign.toml."""

    record: Annotated[list[RecordTable], Meta(min_length=1), Meaning("the records, one table each")]
    kind: Annotated[
        ToneKind | Literal["campaign", "decay_amplitude"], Meaning("kind of all records that state none")
    ] = "campaign"
    device: Annotated[DeviceTable, Meaning("the device")] = DeviceTable()
    conditions: Annotated[ConditionsTable, Meaning("who measured what when")] = ConditionsTable()
    demodulation: Annotated[DemodulationTable, Meaning("how the rate signal is demodulated")] = DemodulationTable()
    instrument: Annotated[InstrumentTable, Meaning("hold, bias, filter and converter")] = InstrumentTable()
    systematic: Annotated[SystematicTable, Meaning("errors that all devices of a tester share")] = SystematicTable()
    operation: Annotated[OperationTable, Meaning("how the gyro is operated")] = OperationTable()
    reference: References = {}
    columns: Annotated[
        dict[str, Source], Meaning("channel = column of the files: a name, a number from 1, or a table")
    ] = {}
    channels: Annotated[ChannelsTable, Meaning("corrections of the files; gyroscreen check prints them")] = (
        ChannelsTable()
    )
    layout: Annotated[LayoutTable | None, Meaning("electrodes that are not the paper's; absent: the paper's")] = None
