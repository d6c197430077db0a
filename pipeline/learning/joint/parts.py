"""The parts of a campaign, all with the same model of the device."""

from __future__ import annotations

from ...device.model import Model
from ...experiment.bad_samples import without_bad_samples
from ...experiment.noise.level import noise_level
from ...experiment.tones import ToneCampaign
from ...inference.general.effect_starts import with_effect_starts
from ...inference.general.scales import check_pickoff, scaled_to
from ...inference.general.starts import find_start
from ..envelopes.part import EnvelopePart
from ..timed.part import TimePart
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
    model = model.with_channels(*campaign.channels)
    found: list[Part] = []
    timed = campaign.timed
    if timed is not None and any(record.role in ("fit", "validate") for record in timed.records):
        timed = without_bad_samples(timed)
        level = noise_level(timed)
        model = scaled_to(model, timed)
        if any(effect.disturbance is not None for effect in model.ordered_effects()):
            start = find_start(model, timed.with_role("fit"), timed.instrument, level.sigma_v)
            model, _ = with_effect_starts(model, timed, level, {**start, **model.fixed}, {}, 1)
        found.append(TimePart(model, model, timed, level))
    if campaign.records:
        found.append(TonePart(model, model, campaign))
    if campaign.envelopes:
        found.append(EnvelopePart(model, model, campaign))
    full = model_with(model, tuple(dict.fromkeys(name for part in found for name in part.effects)))
    return tuple(part.with_full(full) for part in found)
