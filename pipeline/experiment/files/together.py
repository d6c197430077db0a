"""Records of one campaign, made to fit together: drives, channels, sample rate, declared temperatures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...errors import MeasurementError
from ..record import Record, Role


def with_all_drives(records: Sequence[Record], free: bool = False) -> list[Record]:
    """The records, with zeros as the drives of those whose files have no drive columns.

    ``free`` : some are free decays; if nothing is driven at all, no record has a drive.
    """
    if free and not any(np.any(record.drive_v) for record in records):
        return [dataclasses.replace(record, drive_v=record.drive_v[:, :0]) for record in records]
    drives = max((record.drive_v.shape[1] for record in records), default=0) or 1
    return [
        dataclasses.replace(record, drive_v=np.zeros((record.sense_v.shape[0], drives)))
        if record.drive_v.shape[1] == 0
        else record
        for record in records
    ]


def from_first_sample(records: Sequence[Record]) -> list[Record]:
    """The records with the times of their first samples counted from the first sample of their file that is used.

    Records cut from one file are one run, so that a drift goes on from one to the next.
    """
    first: dict[str | None, float] = {}
    for record in records:
        first[record.file] = min(first.get(record.file, record.elapsed_s), record.elapsed_s)
    return [dataclasses.replace(record, elapsed_s=record.elapsed_s - first[record.file]) for record in records]


def at_temperatures(records: Sequence[Record], tcf_ppm_per_c: float) -> tuple[Record, ...]:
    """The records with the frequency shifts of their declared temperatures, 1e-6 TCF (T - mean of T over the fit records)."""
    fitted = [r.temperature_c for r in records if r.role == "fit" and r.temperature_c is not None]
    if not fitted:
        return tuple(records)
    mean = sum(fitted) / len(fitted)
    return tuple(
        r
        if r.temperature_c is None
        else dataclasses.replace(r, frequency_shift=1e-6 * tcf_ppm_per_c * (r.temperature_c - mean))
        for r in records
    )


def check_same_shape(records: Sequence[Record]) -> None:
    """Raise MeasurementError unless all records have the same channels and sample rate."""
    first = records[0]
    for record in records[1:]:
        found = (record.drive_v.shape[1], record.sense_v.shape[1])
        wanted = (first.drive_v.shape[1], first.sense_v.shape[1])
        if found != wanted:
            raise MeasurementError(
                f"{record.name} has different channels from {first.name}",
                value=f"{found[0]} drives, {found[1]} senses",
                allowed=f"{wanted[0]} drives, {wanted[1]} senses, as in the first record",
                next_step="put records with different channels into a separate campaign",
            )
        if record.sample_rate_hz != first.sample_rate_hz:
            raise MeasurementError(
                f"{record.name} has a different sample rate from {first.name}",
                value=record.sample_rate_hz,
                allowed=f"{first.sample_rate_hz} Hz, as in the first record",
                next_step="state sample_rate_hz under [instrument]",
            )


def roles_of(declared: Sequence[Role | None]) -> list[Role]:
    """The roles of records, those that are not declared filled in: the last validates if none does, the others fit."""
    undeclared = [k for k, role in enumerate(declared) if role is None]
    others_fit = len(undeclared) > 1 or "fit" in declared
    last = undeclared[-1] if undeclared and others_fit and "validate" not in declared else None
    return [role if role is not None else "validate" if k == last else "fit" for k, role in enumerate(declared)]
