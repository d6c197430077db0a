"""The parts of a campaign, all with the same model of the device."""

from __future__ import annotations

from ...device.model import Model
from ...experiment.tones import ToneCampaign
from ...inference.general.scales import check_pickoff
from ..tones.part import TonePart
from .part import Part, model_with


def parts_of(campaign: ToneCampaign, model: Model) -> tuple[Part, ...]:
    """The part of each domain in which the campaign has records, that of time first.

    Raises
    ------
    ConfigError : the plant does not have the channels of the records.
    MeasurementError : a noise level cannot be measured.
    """
    check_pickoff(model, campaign.instrument)
    first = campaign.records[0]
    model = model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1])
    plain = TonePart(model, model, campaign)
    full = model_with(model, plain.effects)
    return (TonePart(model, full, campaign),)
