"""Draw a campaign with hidden effects; it depends on (seed, kind, number) only.

A device of the default population (rocking Q > 600, c12 = 0) is measured with the standard records, 1 mV of noise and offsets of
a few millivolts.  The SNR of each hidden effect is log-uniform in the range of the kind.
Shapes: N samples; records (N, 2).  Units: volts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from zlib import crc32

import numpy as np
from scipy.signal import lfilter

from pipeline.arrays import FloatArray
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.errors import UsageError
from pipeline.experiment.excitation import drive_samples
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Record

from ...simulate import device_parameters, standard_excitations
from .bench import BenchRecords
from .effects import Drawn, draw_effect, peak_of
from .kinds import KINDS, LONE, Noise
from .own_law import modelled_response, own_disturbance, without_law
from .strengths import FittedBaseline, baseline, modelled, sized
from .truth import OUTSIDE, clipped, hum, response

SIGMA_V = 1e-3
INSTRUMENT = Instrument(antialias=AntiAlias(), adc=Adc())
_LEAST_Q = 600.0
_ANGULAR_GAIN = 0.7
_OFFSET_V = 2e-3


@dataclass(frozen=True, eq=False)
class Hidden:
    """A campaign and the effects that are hidden in it.

    Parameters
    ----------
    kind, number, seed : these decide everything else.
    effects : names of the hidden effects.
    values : all parameters by name.
    sizes : names of the parameters that are zero without their effect.
    snr : SNR of each of the ``effects``.
    left_out : library effects that are not offered to the learning loop.
    campaign : the records.
    model : the model from which the loop starts; its library holds the candidates.
    noise_free_v : the driven records (N, 2) [V] without noise, by name; empty where each record has its own deviations.
    """

    kind: str
    number: int
    seed: int
    effects: tuple[str, ...]
    values: Mapping[str, float]
    sizes: tuple[str, ...]
    snr: tuple[float, ...]
    left_out: tuple[str, ...]
    campaign: Campaign
    model: Model = DEFAULT_COMPARE_MODEL
    noise_free_v: Mapping[str, FloatArray] = field(default_factory=dict)


def stream(seed: int, kind: str, number: int, purpose: str) -> np.random.Generator:
    """The random stream of one purpose in one campaign."""
    key = (crc32(kind.encode()), number, crc32(purpose.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def inseparable(first: str, second: str, model: Model = DEFAULT_COMPARE_MODEL) -> bool:
    """Whether one of two effects always imitates the other, so that both together look like one of them."""
    pairs = ((first, second), (second, first))
    return any(like.always and like.effects == (b,) for a, b in pairs for like in model.effect(a).look_alikes)


def effects_of(
    kind: str, number: int, random: np.random.Generator, model: Model = DEFAULT_COMPARE_MODEL
) -> tuple[str, ...]:
    """Names of the effects in campaign ``number`` of ``kind``: the candidates of ``model`` in turn, or a random pair of them."""
    library = model.candidates()
    if kind in ("one", "weak", "left-out", "bench-one", "lone-one"):
        return (library[number % len(library)],)
    if kind in ("bench-foreign", "lone-foreign"):
        foreign = (*OUTSIDE, *library)
        return (foreign[number % len(foreign)],)
    if kind == "outside":
        return (tuple(OUTSIDE)[number % len(OUTSIDE)],)
    if kind != "two":
        return ()
    while True:
        first, second = sorted(str(name) for name in random.choice(library, 2, replace=False))
        if not inseparable(first, second, model):
            return first, second


def draw_device(random: np.random.Generator) -> dict[str, float]:
    """Plant parameters by name, each in its unit, of a device of the default population with rocking Q > 600."""
    while True:
        values = device_parameters({}, int(random.integers(2**31)))
        if max(values["zeta1"], values["zeta2"]) < 0.5 / _LEAST_Q:
            return values


def noise(kind: Noise, silent: bool, samples: int, random: np.random.Generator) -> FloatArray:
    """Noise (samples, 2) [V] with an sd of 1 mV (1.2 mV in the driven records of "louder")."""
    if kind == "heavy-tailed":
        return np.asarray(SIGMA_V / np.sqrt(2.0) * random.standard_t(4.0, (samples, 2)))
    white = random.standard_normal((samples, 2))
    if kind == "coloured":
        return np.asarray(SIGMA_V * np.sqrt(1.0 - 0.7**2) * lfilter([1.0], [1.0, -0.7], white, axis=0))
    return SIGMA_V * white * (1.2 if kind == "louder" and not silent else 1.0)


def hide(kind: str, number: int, seed: int, model: Model = DEFAULT_COMPARE_MODEL) -> Hidden:
    """Draw and simulate campaign ``number`` of ``kind``.

    Parameters
    ----------
    kind, number : which campaign, see ``KINDS``.
    seed : root of all random streams.
    model : the loop will start from it; the effects to hide are its candidates.

    Raises
    ------
    UsageError : an unknown kind, or a negative number.
    """
    if kind not in KINDS or number < 0:
        raise UsageError("no such hidden campaign", value=f"{kind} {number}", allowed=f"{', '.join(KINDS)}; 0 and up")
    random = stream(seed, kind, number, "device")
    values = draw_device(random)
    effects = effects_of(kind, number, random, model)
    empty = _empty(int(random.integers(2**31)))
    if KINDS[kind].lone:
        names = LONE[int(random.integers(len(LONE)))]
        empty = tuple(r for r in empty if r.name in names)
    snr: list[float] = []
    sizes: list[str] = []
    if effects:
        fitted = [r for r in empty if r.role == "fit"]
        # The quantisation of the ADC adds to the noise.
        sigma = float(np.hypot(SIGMA_V, Adc().lsb_v / np.sqrt(12.0)))
        base = baseline(values, fitted, INSTRUMENT, sigma, KINDS[kind].bench)
        before = modelled(values, (), fitted, INSTRUMENT)
        changed = dict(values)
        for i, effect in enumerate(effects):
            target = float(np.exp(random.uniform(*np.log(KINDS[kind].snr))))
            drawn = draw_effect(effect, values, peak_of(before, [r.drive_v for r in fitted]), random, model)
            search = _SizeSearch(effect, model, drawn, values, fitted, before, base)
            size, reached = search.sized(target, stream(seed, kind, number, f"hum{i}"))
            changed |= drawn.at(size)
            snr.append(reached)
            sizes += drawn.direction
        values = changed
    streams = [stream(seed, kind, number, f"record{i}") for i in range(len(empty))]
    if KINDS[kind].bench:
        bench = BenchRecords(stream(seed, kind, number, "bench"))
        disturbed = [_disturbed(model, effects, values, r.drive_v.shape[0], s) for r, s in zip(empty, streams)]
        measured = bench.measured(empty, values, partial(_clean_record, model, effects), disturbed, streams)
        noise_free: dict[str, FloatArray] = {}
    else:
        clean = _clean(model, effects, values, empty)
        both = [
            _measured(r, clean.get(r.name), model, effects, values, KINDS[kind].noise, own)
            for r, own in zip(empty, streams)
        ]
        measured = tuple(record for record, _ in both)
        noise_free = {record.name: volts for record, volts in both if record.name in clean}
    campaign = Campaign(f"{kind}-{number}", measured, INSTRUMENT, _ANGULAR_GAIN, 1.0)
    foreign = kind in ("left-out", "bench-foreign", "lone-foreign")
    left_out = tuple(name for name in effects if foreign and name not in OUTSIDE)
    return Hidden(kind, number, seed, effects, values, tuple(sizes), tuple(snr), left_out, campaign, model, noise_free)


def _empty(seed: int) -> tuple[Record, ...]:
    rate = INSTRUMENT.sample_rate_hz
    drives = [(n, role, drive_samples(e, rate)) for n, role, e in standard_excitations(seed)]
    return tuple(Record(name, rate, v, np.zeros_like(v), role=role) for name, role, v in drives)


def _clean_record(model: Model, effects: tuple[str, ...], values: Mapping[str, float], record: Record) -> FloatArray:
    """The noise-free record (N, 2): of the independent simulator where it states the law of every effect."""
    if without_law(effects):
        return modelled_response(model, effects, values, record, INSTRUMENT)
    return response(values, record.drive_v, INSTRUMENT)


def _clean(
    model: Model, effects: tuple[str, ...], values: Mapping[str, float], records: tuple[Record, ...]
) -> dict[str, FloatArray]:
    """The noise-free driven records by name; records with the same drive are simulated once."""
    made: dict[bytes, FloatArray] = {}
    out = {}
    for record in records:
        key = record.drive_v.tobytes()
        if record.role != "noise":
            if key not in made:
                made[key] = _clean_record(model, effects, values, record)
            out[record.name] = made[key]
    return out


@dataclass(frozen=True, eq=False)
class _SizeSearch:
    """A drawn effect on a device: ``before`` are its ``fitted`` records without the effect."""

    effect: str
    model: Model
    drawn: Drawn
    values: Mapping[str, float]
    fitted: list[Record]
    before: list[FloatArray]
    base: FittedBaseline

    def sized(self, target: float, random: np.random.Generator) -> tuple[float, float]:
        """Size of the effect for an SNR of ``target``, and the SNR that it has."""
        if self.effect not in OUTSIDE and self.model.effect(self.effect).disturbance is not None:
            # A disturbance is proportional to its size.
            unit = self.drawn.at(1.0)
            lines = [_disturbed(self.model, (self.effect,), unit, y.shape[0], random) for y in self.before]
            return target / self.base.snr(lines), target
        found = sized(self.snr, target, self.drawn.most)
        return found.size, found.snr

    def snr(self, size: float) -> float:
        """SNR of the effect at ``size``."""
        trial = {**self.values, **self.drawn.at(size)}
        return self.base.snr([y - z for y, z in zip(self._records(trial), self.before)])

    def _records(self, trial: Mapping[str, float]) -> list[FloatArray]:
        if self.effect in OUTSIDE or without_law((self.effect,)):
            return [_clean_record(self.model, (self.effect,), trial, r) for r in self.fitted]
        if self.model.effect(self.effect).stages == ("adc",):
            return [clipped(y, trial) for y in self.before]
        return modelled(trial, (self.effect,), self.fitted, INSTRUMENT)


def _disturbed(
    model: Model, effects: tuple[str, ...], values: Mapping[str, float], samples: int, random: np.random.Generator
) -> FloatArray:
    """Disturbances (samples, 2) [V]: hum, and those of effects without an independent law."""
    volts = hum(values, samples, INSTRUMENT.sample_rate_hz, random)
    for effect in (model.effect(name) for name in without_law(effects)):
        if effect.disturbance is not None:
            volts = volts + own_disturbance(effect, values, samples, INSTRUMENT, random)
    return volts


def _measured(
    record: Record,
    clean: FloatArray | None,
    model: Model,
    effects: tuple[str, ...],
    values: Mapping[str, float],
    kind: Noise,
    random: np.random.Generator,
) -> tuple[Record, FloatArray]:
    """The record with offset, noise and disturbances added, then converted; and its volts (N, 2) without noise and offset."""
    samples = record.drive_v.shape[0]
    noise_free = record.sense_v if clean is None else clipped(clean, values)
    volts = noise_free + _OFFSET_V * random.standard_normal(2) + noise(kind, clean is None, samples, random)
    if values.get("adc_saturation.clips_noise", 0.0):
        volts = clipped(volts, values)
    disturbed = _disturbed(model, effects, values, samples, random)
    volts = volts + disturbed
    adc = INSTRUMENT.adc
    assert adc is not None
    half = 2.0 ** (adc.bits - 1)
    converted = np.clip(np.rint(volts / adc.lsb_v), -half, half - 1.0) * adc.lsb_v
    return replace(record, sense_v=converted), noise_free + disturbed
