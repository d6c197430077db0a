"""The measurement of a device by its path, with the campaign that a single record belongs to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.files.readers import existing
from pipeline.experiment.record import Campaign
from pipeline.experiment.tones import ToneCampaign

Measured = Campaign | ModalRecord | ToneCampaign


def with_its_campaign(measurement: Path) -> Measured:
    """The measurement; a single record is read with the campaign that lists it, if there is one.

    The campaign.toml in the folder of the record then gives the instrument and the silent records.

    Raises
    ------
    ConfigError, MeasurementError : the measurement cannot be read.
    """
    existing(measurement)
    beside = measurement.parent / "campaign.toml"
    if measurement.suffix != ".toml" and measurement.is_file() and beside.is_file():
        campaign = read_measurement(beside)
        if not isinstance(campaign, Campaign):
            return campaign if measurement.name in _files(campaign) else read_measurement(measurement)
        listed = [r for r in campaign.records if r.file is not None and Path(r.file).name == measurement.name]
        if listed:
            silent = tuple(r for r in campaign.with_role("noise") if r is not listed[0])
            return replace(campaign, records=(*silent, replace(listed[0], role="fit")))
    return read_measurement(measurement)


def _files(campaign: ModalRecord | ToneCampaign) -> set[str]:
    """Names of the files of a campaign of sweeps and frequency responses."""
    records = campaign.records if isinstance(campaign, ToneCampaign) else ()
    return {Path(record.file).name for record in records if record.file is not None}


def with_fit_records(measured: Measured) -> Measured:
    """The measurement; where no record of a campaign has the role "fit", all have."""
    if not isinstance(measured, Campaign) or measured.with_role("fit"):
        return measured
    return replace(measured, records=tuple(replace(record, role="fit") for record in measured.records))
