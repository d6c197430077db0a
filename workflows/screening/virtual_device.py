"""One virtual device: its volts, its silent and its chirp record, and its identification.

Shapes: N samples, two drives and two senses, B devices of a draw.  Volts unless stated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from zlib import crc32

import msgspec
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.effect import Context
from pipeline.device.gyro import PHYSICAL, gyro_mechanics
from pipeline.device.mechanics import Mechanics, modes_of
from pipeline.device.model import SCREENING_MODEL, Model
from pipeline.errors import ConfigError
from pipeline.experiment.antialias import Bank, behind_filter
from pipeline.experiment.excitation import drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.forward.record import forward
from pipeline.experiment.forward.recursion import in_lanes
from pipeline.experiment.noise.measure import measured
from pipeline.experiment.noise.spectrum import noise_spectrum
from pipeline.experiment.record import Record
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.identification.failure import IdentificationError
from pipeline.inference.estimate import RateSettings
from pipeline.inference.gate import Gate
from pipeline.inference.screening.device import FitRecord, IdentificationSettings, fit_device, prepare
from pipeline.inference.screening.result import DeviceResult, Fitted, results_of
from pipeline.inference.screening.sample import SamplerSettings
from populations.draw import Draw, draw

from ..config import RunConfig
from .settings import (
    DEFAULT_SIGMA_V,
    EFFECT_STREAM,
    NOISE_STREAM,
    POSTERIOR_STREAM,
    device_seed,
    population,
    rate_of,
    settings_of,
)

_PARTS = tuple(field.name for field in fields(Mechanics))


def physical_of(values: Mapping[str, FloatArray]) -> FloatArray:
    """Physical parameters (B, 12), in the order of ``PHYSICAL``, from arrays (B,) by quantity name."""
    return np.stack([values[name] for name in PHYSICAL], axis=-1)


@lru_cache(maxsize=2)
def _shared(config_key: bytes) -> FitRecord:
    config = msgspec.msgpack.decode(config_key, type=RunConfig)
    instrument = config.instrument.instrument()
    drive = drive_samples(config.experiment.excitation(), instrument.sample_rate_hz)
    record = Record("chirp", instrument.sample_rate_hz, drive, np.zeros_like(drive), role="fit")
    prepared, band_hz = prepare(record, instrument, settings_of(config)), config.identification
    prepared = replace(prepared, drive_lanes=in_lanes(drive))
    try:
        filtered = bandpass(drive, instrument.sample_rate_hz, band_hz.low_hz, band_hz.high_hz)
    except IdentificationError:
        # The route of each device reports it.
        return prepared
    return replace(prepared, filtered_drive_v=filtered)


@dataclass(frozen=True)
class _FitSettings:
    """What ``fit_device`` takes beside the records and the noise, which all devices of a run share."""

    identification: IdentificationSettings
    sampler: SamplerSettings
    gate: Gate
    rate: RateSettings


@lru_cache(maxsize=2)
def _fit_settings(config_key: bytes, angular_gain: float) -> _FitSettings:
    config = msgspec.msgpack.decode(config_key, type=RunConfig)
    return _FitSettings(
        settings_of(config), config.posterior.settings(), config.judging_gate(), rate_of(config, angular_gain)
    )


def shared_record(config: RunConfig) -> FitRecord:
    """Drive, band and nuisance basis, which all virtual devices of a run share."""
    return _shared(msgspec.msgpack.encode(config))


def virtual_model(config: RunConfig) -> Model:
    """:func:`checked_model`, once per configuration."""
    return _model(msgspec.msgpack.encode(config))


@lru_cache(maxsize=4)
def _model(config_key: bytes) -> Model:
    return checked_model(msgspec.msgpack.decode(config_key, type=RunConfig))


def checked_model(config: RunConfig) -> Model:
    """The model of the virtual devices: the plant with c12, and the effects in [experiment] and [effects].

    Raises
    ------
    ConfigError : an effect that does not exist or that the population does not draw; an unknown parameter in a size.
    """
    named = config.experiment.effects
    effects = tuple(dict.fromkeys((*SCREENING_MODEL.effects, *named, *config.effects)))
    model = Model(effects=effects, effect_folders=config.effect_folders)
    for name, table in config.effects.items():
        effect = model.effect(name)
        own = [member.name for member in effect.members(model.built.shape)]
        if name in named or name in SCREENING_MODEL.effects or effect.disturbance is not None:
            raise ConfigError(
                "[effects] cannot contain this effect",
                value=name,
                allowed="effects of the device or its read-out that are not in experiment.effects",
                next_step=f"remove [effects.{name}]",
            )
        for parameter in table.size:
            if parameter not in own:
                raise ConfigError(
                    f"[effects.{name}] size: no such parameter of the effect",
                    value=parameter,
                    allowed=", ".join(own),
                    next_step="correct its name",
                )
    drawn = draw(population(config), config.run.seed, 0, 1).effects
    for name in named:
        if name not in drawn:
            raise ConfigError(
                "experiment.effects: the population does not draw sizes of this effect",
                value=name,
                allowed=", ".join(sorted(drawn)),
                next_step=f"give sizes in [effects.{name}]",
            )
    return model


def effect_sizes(config: RunConfig, model: Model, n: int, device_id: str, lot: str) -> dict[str, float]:
    """Parameter -> size, in its unit, that [effects] gives to device ``n``; empty if the device has none of them."""
    out: dict[str, float] = {}
    for name, table in sorted(config.effects.items()):
        key = (EFFECT_STREAM, n, crc32(name.encode()))
        random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=key))
        affected = random.random() < table.share if not table.devices else device_id in table.devices
        if not affected or (table.lots and lot not in table.lots):
            continue
        for parameter, (mean, sd) in sorted(table.size.items()):
            full = f"{name}.{parameter}"
            out[full] = float(np.clip(mean + sd * random.standard_normal(), *model.bounds(full)))
    return out


def virtual_banks(config: RunConfig, drawn: Draw, devices: range) -> list[Bank] | None:
    """Modes behind the filter of some ``devices`` of a draw, each a batch of one; ``None`` with other effects than linear ones.

    Together, since each step takes hardly longer for all than for one.  The bank of a device does not depend on the others.

    Raises
    ------
    ConfigError : as :func:`virtual_model`; a mode of a device does not oscillate.
    """
    model = virtual_model(config)
    named = config.experiment.effects
    if config.effects or any(model.effect(name).stages != ("mechanics",) for name in named):
        return None
    instrument = config.instrument.instrument()
    physical = physical_of(drawn.true)[devices.start : devices.stop]
    plant = gyro_mechanics(physical)
    acting = [effect for effect in model.ordered_effects() if effect.name in named]
    members = {effect.name: effect.members(model.built.shape) for effect in acting}
    whole = []
    for n, i in enumerate(devices):
        mechanics = Mechanics(*(getattr(plant, name)[n : n + 1] for name in _PARTS))
        values = _values(config, drawn, i, physical[n])
        context = Context(instrument.bias_v, instrument.bias_v, values)
        for effect in acting:
            if effect.mechanics is not None:
                own = [values[effect.full_name(member)] for member in members[effect.name]]
                mechanics = effect.mechanics(mechanics, np.array(own), context)
        whole.append(mechanics)
    joined = Mechanics(*(np.concatenate([getattr(one, name) for one in whole]) for name in _PARTS))
    bank = behind_filter(modes_of(joined), instrument.antialias)
    return [Bank(bank.poles[n : n + 1], bank.residues[n : n + 1]) for n in range(len(devices))]


def _values(config: RunConfig, drawn: Draw, i: int, physical: FloatArray) -> dict[str, float]:
    """Parameters of the plant, from ``physical`` (12,), and of the effects in [experiment], of device ``i`` of a draw."""
    values = dict(zip(PHYSICAL, physical.tolist()))
    for name, parameters in drawn.effects.items():
        if name in config.experiment.effects:
            values |= {f"{name}.{parameter}": float(value[i]) for parameter, value in parameters.items()}
    return values


def virtual_volts(config: RunConfig, drawn: Draw, i: int, bank: Bank | None = None) -> FloatArray:
    """Pick-off volts (N, 2) of device ``i`` of a draw, before hum, noise and ADC; raises as :func:`virtual_banks`.

    ``bank`` is that of :func:`virtual_banks`, where it is known already.
    """
    instrument = config.instrument.instrument()
    shared = shared_record(config)
    if bank is None:
        banks = virtual_banks(config, drawn, range(i, i + 1))
        bank = None if banks is None else banks[0]
    if bank is not None:
        # Linear mechanics: the modal bank is ten times as fast as the general forward model, with the same result.
        rate, hold = instrument.sample_rate_hz, instrument.hold
        return respond(bank, shared.record.drive_v, rate, hold, shared.drive_lanes)[0]
    model = virtual_model(config)
    values = _values(config, drawn, i, physical_of(drawn.true)[i])
    values |= effect_sizes(config, model, int(drawn.index[i]), drawn.device_id[i], drawn.lot[i])
    return forward(model, values, shared.record, instrument)


def virtual_records(
    config: RunConfig, drawn: Draw, i: int, bank: Bank | None = None
) -> tuple[FloatArray, FloatArray, float]:
    """Silent and fit record, (N, 2) [V], of device ``i`` of a draw, and sigma [V]; as :func:`virtual_volts`."""
    instrument = config.instrument.instrument()
    volts = virtual_volts(config, drawn, i, bank)
    sigma = config.noise.sigma_v or DEFAULT_SIGMA_V
    if config.noise.snr_db is not None:
        window = window_slice(volts, instrument.sample_rate_hz, config.identification.window_s)
        sigma = float(np.sqrt(np.mean(volts[window] ** 2)) * 10.0 ** (-config.noise.snr_db / 20.0))
    random = np.random.default_rng(device_seed(config, NOISE_STREAM, int(drawn.index[i])))
    hum, rate = config.hum_source(), instrument.sample_rate_hz
    quiet = np.zeros((round(config.experiment.silence_s * rate), 2))
    kind = config.noise.noise_kind()
    silent = measured(quiet, rate, sigma, hum, instrument.adc, random, kind)
    return silent, measured(volts, rate, sigma, hum, instrument.adc, random, kind), sigma


def fit_virtual(
    config: RunConfig, drawn: Draw, i: int, angular_gain: float, bank: Bank | None = None
) -> Fitted | DeviceResult:
    """Simulate the records of device ``i`` of a draw, measure the noise on the silent one, fit the device and sample it.

    ``bank`` as for :func:`virtual_volts`.
    """
    instrument = config.instrument.instrument()
    shared = shared_record(config)
    silent, fit, _ = virtual_records(config, drawn, i, bank)
    noise = noise_spectrum(silent, instrument.sample_rate_hz, config.line_hz(), instrument.adc)
    record = Record("chirp", instrument.sample_rate_hz, shared.record.drive_v, fit, role="fit")
    shares = _fit_settings(msgspec.msgpack.encode(config), angular_gain)
    return fit_device(
        [replace(shared, record=record)],
        noise,
        instrument,
        shares.identification,
        shares.sampler,
        shares.gate,
        shares.rate,
        device_seed(config, POSTERIOR_STREAM, int(drawn.index[i])),
    )


def identify_virtual(config: RunConfig, drawn: Draw, i: int, angular_gain: float) -> DeviceResult:
    """The result of device ``i`` of a draw, from its simulated records."""
    (result,) = results_of([fit_virtual(config, drawn, i, angular_gain)])
    if isinstance(result, Exception):
        raise result
    return result
