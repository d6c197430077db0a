"""What a run configuration means for one device: population, identification settings, rate settings, random streams.

Random streams: SeedSequence(seed, spawn_key=(stream, n)) for device n, so a result depends neither on the worker nor on
the block.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

import populations
from pipeline.experiment.record import Campaign
from pipeline.experiment.systematic import Systematic
from pipeline.inference.estimate import RateSettings
from pipeline.inference.screening.device import IdentificationSettings
from populations.spec import PopulationSpec, load_spec

from ..config import RunConfig

NOISE_STREAM, POSTERIOR_STREAM, CAMPAIGN_STREAM, TRIM_STREAM, EFFECT_STREAM = 101, 102, 103, 107, 108


def device_seed(config: RunConfig, stream: int, n: int) -> np.random.SeedSequence:
    """Random stream ``stream`` of device ``n``."""
    return np.random.SeedSequence(config.run.seed, spawn_key=(stream, n))


@lru_cache(maxsize=4)
def _population(spec: str, values: tuple[tuple[str, float], ...]) -> PopulationSpec:
    path = Path(spec)
    if path.suffix != ".toml":
        path = Path(populations.__file__).parent / "specs" / f"{spec}.toml"
    found = load_spec(path)
    return found.with_values(dict(values)) if values else found


def population(config: RunConfig) -> PopulationSpec:
    """The population that [source] names, with its assumptions set.

    Raises
    ------
    ConfigError : the population cannot be read.
    """
    return _population(config.source.spec, tuple(sorted(config.source.values.items())))


def settings_of(config: RunConfig) -> IdentificationSettings:
    """Identification settings of a configuration: ARX order, window [s], band [Hz] and hum line [Hz]."""
    i = config.identification
    return IdentificationSettings(i.order, i.window_s, i.low_hz, i.high_hz, config.line_hz())


def rate_of(config: RunConfig, angular_gain: float | None) -> RateSettings:
    """Settings of the rate biases [deg/s] and common errors of the tester; ``angular_gain`` is I_p / I_0p."""
    demodulation = config.demodulation
    return RateSettings(angular_gain, demodulation.phase_error_deg, demodulation.drive, _systematic(config))


def _systematic(config: RunConfig) -> Systematic:
    """Common errors of the run; the temperature coefficient is that of the population if the run states none."""
    if config.source.kind == "population" and config.systematic.temperature_sd_c > 0.0:
        temperature = population(config).irregularity.get("temperature", {})
        if "tcf_ppm_per_k" in temperature:
            return config.systematic.built(temperature["tcf_ppm_per_k"])
    return config.systematic.built()


def with_systematic(config: RunConfig, campaign: Campaign) -> Campaign:
    """``campaign`` with the common errors of the run, unless it declares its own."""
    return replace(campaign, systematic=_systematic(config)) if campaign.systematic.exact else campaign
