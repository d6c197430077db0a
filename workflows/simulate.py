"""Simulation of the standard campaign of a virtual device.

Records: a silent one; to fit, the paper's chirp twice, with directions swapped, at 0.35 of the level, and on each drive alone;
held out, the swapped chirp at another level and a random-phase multisine.

Shapes: N samples, two drives and two senses.  Volts unless stated.
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
#: SNR of an effect that is named without sizes: norm of its change of the paper's chirp record over sigma, before any refit.
_DEFAULT_SNR = 300.0
#: Largest number of simulated records to find the size of an effect.
_TRIALS = 20
_STREAM_NOISE, _STREAM_EFFECT = 105, 106


def standard_excitations(seed: int) -> tuple[tuple[str, Role, Excitation], ...]:
    """Name, role and excitation of each record of the standard campaign; ``seed`` sets the phases of the multisine."""
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


@dataclass(frozen=True, eq=False, repr=False)
class Simulated:
    """A simulated campaign, with the model and all its true parameters by name, each in its unit."""

    campaign: Campaign
    model: Model
    parameters: dict[str, float]

    def __repr__(self) -> str:
        return f"{self.campaign!r}\n  true: {', '.join(f'{name} = {value:.6g}' for name, value in self.parameters.items())}"


def parse_values(text: str) -> dict[str, float]:
    """ "a=1,b=2" as numbers by name.

    Raises
    ------
    ConfigError : the text does not have this form.
    """
    out: dict[str, float] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, sign, value = part.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign:
            raise ConfigError(
                "a parameter is not given as name=number",
                value=part,
                allowed="for example theta_deg=12,split_hz=1.5",
                next_step="correct --device or --effect",
            )
    return out


def device_parameters(changes: Mapping[str, float], seed: int) -> dict[str, float]:
    """Plant parameters by name, each in its unit, of the first device that the default population draws with ``seed``.

    ``changes`` replaces values by name; split_hz changes f2_hz.

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
            raise ConfigError(
                "a device has no such parameter",
                value=name,
                allowed=", ".join(allowed),
                next_step="correct --device",
            )
        if name != "split_hz":
            values[name] = value
    if "split_hz" in changes:
        values["f2_hz"] = values["f1_hz"] + changes["split_hz"]
    if values["f2_hz"] < values["f1_hz"]:
        # f1 is the lower frequency by definition; exchanging the axes describes the same device.
        x = to_cartesian(np.array([[values[name] for name in PHYSICAL]]))
        values = dict(zip(PHYSICAL, to_physical(x)[0].tolist()))
    return values


def parse_effect(text: str) -> tuple[str, dict[str, float]]:
    """Name and sizes of an effect from "NAME" or "NAME:param=value,.."; raises as :func:`parse_values`."""
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
    """Parameters of an effect whose SNR in the chirp record, ||change|| / sigma, is ``snr`` to 5 %.

    Parameters with a grid are drawn from it.  The others are drawn in random proportion and scaled together within their
    ranges.

    Parameters
    ----------
    model : contains the effect ``name``.
    base : all other parameters by name.
    chirp : record whose drive is simulated.
    sigma_v : noise sd [V].
    random : source of the random numbers.
    """
    effect = model.effect(name)
    members = effect.members(model.built.shape)
    without = forward(model, base, chirp, instrument)
    if effect.clips("adc") or effect.clips("drive"):
        # Clipping has an effect only below the largest sample.
        samples = without if effect.clips("adc") else chirp.drive_v
        level = float(np.max(np.abs(samples))) * float(random.uniform(0.7, 0.98))
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
        changed = forward(model, {**base, **fixed, **trial}, chirp, instrument)
        found = float(np.linalg.norm(changed - without)) / sigma_v
        if found == 0.0 or not np.isfinite(found) or abs(found / snr - 1.0) < 0.05:
            break
        low, high = (size, high) if found < snr else (low, size)
        size *= float(np.clip(snr / found, 1e-6, 1e6))
        if not low < size < high:
            # For a nonlinear effect proportional steps oscillate; bisect instead.
            size = float(np.sqrt(low * high))
    return {**fixed, **trial} if shape else fixed


def simulate(
    config: RunConfig, changes: Mapping[str, float], effects: Sequence[str], seed: int, folders: Sequence[str] = ()
) -> Simulated:
    """The standard campaign of one virtual device.

    Parameters
    ----------
    config : instrument, noise, hum and demodulation.
    changes : plant parameters that replace those of the drawn device, by name.
    effects : "NAME" or "NAME:param=value,.."; sizes that are not given have an SNR of 300.
    seed : of the device, the sizes and the noise.
    folders : folders with the user's own effects.

    Raises
    ------
    ConfigError : an unknown effect or parameter.
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
                f"the effect {name} has no such parameter",
                value=sorted(unknown)[0],
                allowed=", ".join(full.values()),
                next_step="correct --effect",
            )
        given = {f: values[k] for f, member in full.items() for k in (f, member) if k in values}
        if not given or any(m.grid for m in effect.members(model.built.shape)):
            drawn = sized(model, parameters, name, chirp, instrument, sigma, random)
            given = {**({} if given.keys() >= drawn.keys() else drawn), **given}
        parameters |= given
    return Simulated(_measure(config, model, parameters, hum, sigma, excitations, instrument, seed), model, parameters)


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
        y = measured(volts, rate, sigma_v, hum, instrument.adc, random, config.noise.noise_kind())
        records.append(replace(empty, sense_v=y))
    return Campaign(
        f"virtual-{seed}",
        tuple(records),
        instrument,
        gain,
        config.demodulation.phase_error_deg,
        config.demodulation.drive,
    )


def campaign_config(path: Path | None) -> RunConfig:
    """The configuration of ``simulate``: the file ``path``, or the shipped campaign.toml."""
    return load_config(path or CAMPAIGN_CONFIG)
