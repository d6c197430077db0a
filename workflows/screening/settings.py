"""What a run configuration means for one device: population, identification settings, rate settings, random streams.

Random streams: SeedSequence(seed, spawn_key=(stream, n)) for device n, so a result depends neither on the worker nor on
the block.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

import populations
from pipeline.experiment.record import Campaign
from pipeline.experiment.systematic import Systematic
from pipeline.inference.estimate import RateSettings
from pipeline.inference.screening.device import IdentificationSettings
from pipeline.inference.screening.mismatch import BROAD, MismatchPrior, prior_from
from pipeline.performance.operating_point import DeclaredOperation
from populations.draw import draw
from populations.spec import PopulationSpec, load_spec, spec_from_toml

from ..config import RunConfig
from ..config_tables import SourceTable

#: The effects that the mismatches of the nightly model describe.
MISMATCHES = ("electrode_mismatch", "updown_tilt")
#: Devices from which the prior is taken: its sd is then known to 7 %, and the records are a hundred times as precise as it.
_PRIOR_DEVICES, _PRIOR_SEED = 100, 20260101
#: Noise of virtual records where the configuration states none [V].
DEFAULT_SIGMA_V = 0.001
NOISE_STREAM, POSTERIOR_STREAM, CAMPAIGN_STREAM, TRIM_STREAM, EFFECT_STREAM = 101, 102, 103, 107, 108


def device_seed(config: RunConfig, stream: int, n: int) -> np.random.SeedSequence:
    """Random stream ``stream`` of device ``n``."""
    return np.random.SeedSequence(config.run.seed, spawn_key=(stream, n))


#: What identifies a population: spec, spec_toml and values of [source].
_Key = tuple[str, str | None, tuple[tuple[str, float], ...]]


def spec_path(source: SourceTable) -> Path:
    """The file that ``spec`` of [source] names: a shipped one or the user's."""
    path = Path(source.spec)
    return path if path.suffix == ".toml" else Path(populations.__file__).parent / "specs" / f"{source.spec}.toml"


def spec_text(source: SourceTable) -> str:
    """The text of the population without ``values``, as a run stores it; raises as :func:`population`."""
    return load_spec(spec_path(source)).to_toml() if source.spec_toml is None else source.spec_toml


def _key(source: SourceTable) -> _Key:
    return str(spec_path(source)), source.spec_toml, tuple(sorted(source.values.items()))


@lru_cache(maxsize=4)
def _population(key: _Key) -> PopulationSpec:
    path, text, values = key
    found = (
        load_spec(Path(path)) if text is None else spec_from_toml(text, f"population of the run ({Path(path).name})")
    )
    return found.with_values(dict(values)) if values else found


def population(config: RunConfig) -> PopulationSpec:
    """The population that [source] names, with its assumptions set.

    Raises
    ------
    ConfigError : the population cannot be read.
    """
    return _population(_key(config.source))


def lot_source(config: RunConfig) -> SourceTable:
    """The population that [lot_origin] names, as a [source] table."""
    return SourceTable(spec=config.lot_origin.population, spec_toml=config.lot_origin.population_toml)


def lot_population(config: RunConfig) -> PopulationSpec:
    """The population that [lot_origin] names: what measured lots are compared with.

    Raises
    ------
    ConfigError : the population cannot be read.
    """
    return _population(_key(lot_source(config)))


@lru_cache(maxsize=4)
def _mismatch_prior(key: _Key, effects: frozenset[str]) -> MismatchPrior:
    drawn = draw(_population(key), _PRIOR_SEED, 0, _PRIOR_DEVICES).effects
    nothing = np.zeros(_PRIOR_DEVICES)
    mismatch = drawn.get("electrode_mismatch", {}) if "electrode_mismatch" in effects else {}
    tilt = drawn.get("updown_tilt", {}) if "updown_tilt" in effects else {}
    pair = np.stack([mismatch.get("m_D", nothing), mismatch.get("m_S", nothing)], axis=1)
    return prior_from(pair, tilt.get("t_x", nothing))


def mismatch_prior(config: RunConfig) -> MismatchPrior | None:
    """Prior of the electrode mismatches: broad for measured campaigns, the population's for virtual devices.

    ``None`` where the virtual devices of the run have neither a mismatch nor a tilt.
    """
    if config.source.kind == "campaigns":
        return BROAD
    effects = frozenset(MISMATCHES) & frozenset((*config.experiment.effects, *config.effects))
    if not effects:
        return None
    if not effects <= set(config.experiment.effects):
        return BROAD
    return _mismatch_prior(_key(config.source), effects)


def settings_of(config: RunConfig) -> IdentificationSettings:
    """Identification settings of a configuration: ARX order, window [s], band [Hz], hum line [Hz], prior of mismatches."""
    i = config.identification
    return IdentificationSettings(i.order, i.window_s, i.low_hz, i.high_hz, config.line_hz(), mismatch_prior(config))


def rate_of(config: RunConfig, angular_gain: float | None) -> RateSettings:
    """Settings of the rate biases [deg/s], common errors of the tester and operation; ``angular_gain`` is I_p / I_0p."""
    demodulation, operation = config.demodulation, config.operation.built()
    if operation.temperature_c is None and config.source.kind == "population":
        operation = replace(operation, temperature_c=population(config).operating.temperature_c)
    return RateSettings(
        angular_gain,
        demodulation.phase_error_deg,
        demodulation.drive,
        _systematic(config),
        operation,
        config.instrument.bias_v,
    )


def with_true_noise(config: RunConfig, rate: RateSettings) -> RateSettings:
    """The settings with the noise of the virtual pick-offs, white and the same for all devices; else as they are."""
    operation, noise, adc = rate.operation, config.noise, config.instrument.instrument().adc
    if operation.pickoff_noise_v is not None or noise.kind != "white" or noise.snr_db is not None:
        return rate
    sigma = float(np.hypot(noise.sigma_v or DEFAULT_SIGMA_V, 0.0 if adc is None else adc.lsb_v / np.sqrt(12.0)))
    density = sigma * float(np.sqrt(2.0 / config.instrument.sample_rate_hz))
    return replace(rate, operation=replace(operation, pickoff_noise_v=density))


def _systematic(config: RunConfig) -> Systematic:
    """Common errors of the run; the temperature coefficient is that of the population if the run states none."""
    if config.source.kind == "population" and config.systematic.temperature_sd_c > 0.0:
        temperature = population(config).irregularity.get("temperature", {})
        if "tcf_ppm_per_k" in temperature:
            return config.systematic.built(temperature["tcf_ppm_per_k"])
    return config.systematic.built()


def with_run_tables(config: RunConfig, campaign: Campaign) -> Campaign:
    """``campaign`` with the common errors of the run, unless it declares its own, and each key of [operation] that it lacks."""
    own, common = campaign.operation, config.operation.built()
    keys = [field.name for field in fields(own)]
    merged = {key: getattr(common if getattr(own, key) is None else own, key) for key in keys}
    systematic = _systematic(config) if campaign.systematic.exact else campaign.systematic
    return replace(campaign, systematic=systematic, operation=DeclaredOperation(**merged))
