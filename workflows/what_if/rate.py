"""What all devices of a run declare about their operation: the settings of the rate biases and performance figures."""

from __future__ import annotations

from pipeline.errors import ConfigError
from pipeline.experiment.campaign_tables import CampaignTable
from pipeline.experiment.record import Campaign
from pipeline.inference.estimate import RateSettings
from pipeline.inference.systematic import rate_settings
from pipeline.toml_files import decode

from ..config import RunConfig
from ..screening.inputs import FILE as INPUTS
from ..screening.inputs import read_inputs
from ..screening.settings import population, rate_of, with_run_tables


def common_rate(config: RunConfig, inputs: bytes | None, run_id: str) -> RateSettings | None:
    """The settings that all devices share; ``None`` for campaigns that differ, or whose declarations were not stored.

    Parameters
    ----------
    config : of the run.
    inputs : inputs.json of the run, which holds a copy of each campaign.toml.
    run_id : names the run in messages.
    """
    if config.source.kind == "population":
        return rate_of(config, float(population(config).angular_gain))
    if inputs is None:
        return None
    stored = read_inputs(inputs, f"{INPUTS} of {run_id}")
    texts = {text for file in stored.of("campaign") if (text := stored.text(file)) is not None}
    found: RateSettings | None = None
    for text in texts:
        try:
            rate = rate_settings(with_run_tables(config, _declared(text)))
        except ConfigError:
            continue  # a campaign that could not be read has no draws either
        if found is not None and rate != found:
            return None
        found = rate
    return found


def _declared(text: str) -> Campaign:
    """What a campaign.toml declares, without its records; ConfigError if it cannot be used."""
    document = decode(text.encode(), CampaignTable, "campaign.toml")
    return Campaign(
        document.device.id,
        (),
        document.instrument.built(document.instrument.sample_rate_hz or 1.0).with_pickoff(document.device.pickoff),
        document.device.angular_gain,
        document.demodulation.phase_error_deg,
        document.demodulation.drive,
        systematic=document.systematic.built(),
        operation=document.operation.built(),
    )
