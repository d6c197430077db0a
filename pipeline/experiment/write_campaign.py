"""Write a campaign so that reading it returns the same numbers; the documented import is ``experiment.campaign``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from .. import toml_files as toml
from ..arrays import FloatArray
from ..errors import UsageError, unwritable
from .files.readers import write_columns
from .layout import rows_of
from .record import PAPER_FRAME, Campaign, Record
from .systematic import EXACT


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
            "" if campaign.frame == PAPER_FRAME else toml.table("[layout]", rows_of(campaign.frame)),
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
        raise unwritable("campaign.toml", folder, error) from error
