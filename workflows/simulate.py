"""A virtual device measured as a real one would be: a campaign on disk, and the truth beside it.

Records: silence; to fit the paper's chirp twice, directions swapped, 0.35 of the level, each drive alone; held out the
swapped chirp at another level and a random-phase multisine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL, to_cartesian, to_physical
from pipeline.device.model import Model
from pipeline.errors import ConfigError
from pipeline.experiment.excitation import Chirp, Excitation, Multisine, Silence, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.measure import Hum, measured
from pipeline.experiment.record import Campaign, Record, Role
from populations.draw import draw
from populations.spec import load_spec

from .config import RunConfig, load_config

CAMPAIGN_CONFIG = Path(__file__).parent / "configs" / "campaign.toml"
#: An effect that is named without sizes is given this many sigmas in the paper's chirp, before any refit.
_DEFAULT_SNR = 300.0
#: Trials of a size, each a record.
_TRIALS = 20
_STREAM_NOISE, _STREAM_EFFECT = 105, 106


def standard_excitations(seed: int) -> tuple[tuple[str, Role, Excitation], ...]:
    """Names, roles and excitations of the standard campaign."""
    back = Chirp((700.0, 400.0), (400.0, 700.0))
    return (
        ("silence", "noise", Silence(2, 1.0)),
        ("chirp", "fit", Chirp()),
        ("chirp-again", "fit", Chirp()),
        ("chirp-swapped", "fit", back),
        ("chirp-low", "fit", Chirp(amplitude_v=(0.7, 0.7))),
        ("drive1-alone", "fit", Chirp(amplitude_v=(2.0, 0.0))),
        ("drive2-alone", "fit", Chirp(amplitude_v=(0.0, 2.0))),
        ("validate-swapped", "validate", replace(back, amplitude_v=(1.2, 1.2))),
        ("validate-multisine", "validate", Multisine(amplitude_v=(2.0, 2.0), seed=seed)),
    )


@dataclass(frozen=True, eq=False)
class Virtual:
    """What was simulated: the campaign, the model and all its parameters."""

    campaign: Campaign
    model: Model
    parameters: dict[str, float]


def parse_values(text: str) -> dict[str, float]:
    """ "a=1,b=2" as numbers by name.

    Raises
    ------
    ConfigError : not of that form.
    """
    out: dict[str, float] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, sign, value = part.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign:
            raise ConfigError("not name=number", value=part, allowed="theta_deg=12,split_hz=1.5")
    return out


def device_parameters(changes: Mapping[str, float], seed: int) -> dict[str, float]:
    """Plant parameters of device ``seed`` of the default population, with ``changes`` (split_hz moves f2_hz).

    Raises
    ------
    ConfigError : an unknown name.
    """
    drawn = draw(load_spec(None), seed, 0, 1)
    values = {name: float(drawn.true[name][0]) for name in PHYSICAL}
    values["c12_per_s"] = 0.0
    allowed = (*PHYSICAL, "split_hz")
    for name, value in changes.items():
        if name not in allowed:
            raise ConfigError("no such parameter of a device", value=name, allowed=", ".join(allowed))
        if name != "split_hz":
            values[name] = value
    if "split_hz" in changes:
        values["f2_hz"] = values["f1_hz"] + changes["split_hz"]
    if values["f2_hz"] < values["f1_hz"]:
        # f1 is the lower one by definition: renaming the axes is the same device.
        x = to_cartesian(np.array([[values[name] for name in PHYSICAL]]))
        values = dict(zip(PHYSICAL, to_physical(x)[0].tolist()))
    return values


def parse_effect(text: str) -> tuple[str, dict[str, float]]:
    """ "NAME" or "NAME:param=value,.." """
    name, _, values = text.partition(":")
    return name.strip(), parse_values(values)


def sized(
    model: Model,
    base: dict[str, float],
    name: str,
    chirp: Record,
    instrument: Instrument,
    sigma_v: float,
    random: np.random.Generator,
    snr: float = _DEFAULT_SNR,
) -> dict[str, float]:
    """Parameters of the effect ``name`` (in ``model``) that change the chirp by ``snr`` sigmas in all.

    Grid parameters are drawn from their grid, the others in random proportion, then scaled together within their ranges.
    """
    effect = model.effect(name)
    members = effect.members(model.built.shape)
    quiet = forward(model, base, chirp, instrument)
    if effect.stages == ("adc",):
        # A clip level only counts below the largest sample.
        level = float(np.max(np.abs(quiet))) * float(random.uniform(0.7, 0.98))
        return {effect.full_name(member): 1.0 / level for member in members}
    fixed, shape = {}, {}
    for member in members:
        full = effect.full_name(member)
        if member.grid:
            fixed[full] = float(random.choice(member.grid))
        else:
            sign = -1.0 if member.low < member.null and random.random() < 0.5 else 1.0
            shape[full] = sign * member.scale * float(random.uniform(0.5, 1.0))
    size, low, high = 1.0, 0.0, np.inf
    bounds = {f: model.bounds(f) for f in shape}
    for _ in range(_TRIALS):
        trial = {f: float(np.clip(size * v, *bounds[f])) for f, v in shape.items()}
        loud = forward(model, {**base, **fixed, **trial}, chirp, instrument)
        moved = float(np.linalg.norm(loud - quiet)) / sigma_v
        if moved == 0.0 or not np.isfinite(moved) or abs(moved / snr - 1.0) < 0.05:
            break
        low, high = (size, high) if moved < snr else (low, size)
        size *= float(np.clip(snr / moved, 1e-6, 1e6))
        if not low < size < high:
            # Curved effects overshoot: a proportional step would leap to and fro.
            size = float(np.sqrt(low * high))
    return {**fixed, **trial} if shape else fixed


def simulate(
    config: RunConfig, changes: Mapping[str, float], effects: Sequence[str], seed: int, folders: Sequence[str] = ()
) -> Virtual:
    """The standard campaign of one virtual device.

    Parameters
    ----------
    config : instrument, noise, hum, demodulation.
    changes : plant parameters that differ from the drawn device.
    effects : "NAME" or "NAME:param=value,..".
    seed : device, sizes and noise.
    folders : folders of users' own effects.

    Raises
    ------
    ConfigError : an unknown effect or parameter, or a value out of range.
    """
    instrument = config.instrument.instrument()
    sigma = config.noise.sigma_v or 1e-3
    named = [parse_effect(text) for text in effects]
    model = Model(effects=tuple(name for name, _ in named), effect_folders=tuple(folders))
    base = {k: v for k, v in device_parameters(changes, seed).items() if k in model.by_name}
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM_EFFECT,)))
    excitations = standard_excitations(seed)
    rate = instrument.sample_rate_hz
    samples = drive_samples(excitations[1][2], rate)
    chirp = Record("chirp", rate, samples, np.zeros_like(samples))
    parameters = dict(base)
    hum = config.hum_source()
    for name, values in named:
        effect = model.effect(name)
        if effect.disturbance is not None and not any((effect.force, effect.sense, effect.readout, effect.adc)):
            frequency = values.get("f", float(hum.frequency_hz))
            hum = Hum(frequency, hum.amplitude_v or (0.005, 0.002, 0.003, 0.001, 0.002))
            parameters[f"{name}.f"] = frequency
            continue
        full = {effect.full_name(m): m.name for m in effect.members(model.built.shape)}
        unknown = set(values) - set(full) - set(full.values())
        if unknown:
            raise ConfigError(
                f"no such parameter of {name}", value=sorted(unknown)[0], allowed=", ".join(full.values())
            )
        given = {f: values[k] for f, short in full.items() for k in (f, short) if k in values}
        if not given or any(m.grid for m in effect.members(model.built.shape)):
            drawn = sized(model, parameters, name, chirp, instrument, sigma, random)
            given = {**({} if given.keys() >= drawn.keys() else drawn), **given}
        parameters |= given
    return Virtual(_measure(config, model, parameters, hum, sigma, excitations, instrument, seed), model, parameters)


def _measure(
    config: RunConfig,
    model: Model,
    parameters: dict[str, float],
    hum: Hum,
    sigma_v: float,
    excitations: Sequence[tuple[str, Role, Excitation]],
    instrument: Instrument,
    seed: int,
) -> Campaign:
    rate = instrument.sample_rate_hz
    gain = float(load_spec(None).angular_gain)
    records = []
    for i, (name, role, excitation) in enumerate(excitations):
        drive = drive_samples(excitation, rate)
        empty = Record(name, rate, drive, np.zeros((drive.shape[0], 2)), role=role)
        quiet = isinstance(excitation, Silence)
        volts: FloatArray = empty.sense_v if quiet else forward(model, parameters, empty, instrument, angular_gain=gain)
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM_NOISE, i)))
        records.append(replace(empty, sense_v=measured(volts, rate, sigma_v, hum, instrument.adc, random)))
    return Campaign(
        f"virtual-{seed}",
        tuple(records),
        instrument,
        gain,
        config.demodulation.phase_error_deg,
        config.demodulation.drive,
    )


def campaign_config(path: Path | None) -> RunConfig:
    """The configuration of `simulate`: ``path``, or the shipped campaign.toml."""
    return load_config(path or CAMPAIGN_CONFIG)
