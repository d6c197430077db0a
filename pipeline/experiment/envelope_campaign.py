"""Amplitudes of free decays, from the entries of campaign.toml."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Protocol

from ..errors import MeasurementError
from .envelopes import EnvelopeRecord
from .files.envelope_columns import envelope_record, time_constant
from .files.mapping import Source
from .files.readers import existing, read_columns
from .record import Role


class EnvelopeEntry(Protocol):
    """What a [[record]] states about the amplitude of a free decay."""

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
    def start_s(self) -> float | None:
        """First time [s]."""

    @property
    def stop_s(self) -> float | None:
        """End [s]."""

    @property
    def rate_dps(self) -> float | None:
        """Declared angular rate [deg/s]."""

    @property
    def bias_v(self) -> float | None:
        """Declared bias [V]."""

    @property
    def frequency_hz(self) -> float | None:
        """Frequency of the reference, or centre of the analyzer [Hz]."""

    @property
    def amplitude(self) -> Literal["peak", "rms"]:
        """What an amplitude in volts is."""

    @property
    def reference_ohm(self) -> float:
        """Reference impedance of a power [ohm]."""

    @property
    def averages(self) -> int:
        """Powers averaged in a row."""

    @property
    def time_constant_s(self) -> float | None:
        """Time constant of the detector [s]."""

    @property
    def filter_poles(self) -> int | None:
        """Poles of its filter."""

    @property
    def resolution_bandwidth_hz(self) -> float | None:
        """Resolution bandwidth of the analyzer [Hz]."""


def envelope_of(folder: Path, entry: EnvelopeEntry, role: Role | None, columns: Mapping[str, Source]) -> EnvelopeRecord:
    """The record of an entry; its files are in ``folder``.

    Raises
    ------
    ConfigError, MeasurementError : as of ``files.envelope_columns.envelope_record``; a silent record.
    """
    names = [entry.file] if isinstance(entry.file, str) else entry.file
    if role == "noise":
        raise MeasurementError(
            f'{names[0]}: a decay_amplitude cannot have role = "noise"',
            allowed="fit or validate; without a role every third stretch is held out",
            next_step="remove role: the end of the decay shows the noise",
        )
    wait, poles = time_constant(entry.time_constant_s, entry.filter_poles, entry.resolution_bandwidth_hz)
    found = envelope_record(
        entry.name or Path(names[0]).name,
        [read_columns(existing(folder / name)) for name in names],
        columns,
        slice(entry.start, entry.stop),
        (entry.start_s or 0.0, entry.stop_s or float("inf")),
        entry.amplitude == "rms",
        entry.reference_ohm,
        entry.frequency_hz,
    )
    return dataclasses.replace(
        found,
        time_constant_s=wait,
        poles=poles,
        averages=entry.averages,
        role=role,
        rate_dps=entry.rate_dps,
        bias_v=entry.bias_v,
        file=names[0],
    )
