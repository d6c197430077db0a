"""Draw a campaign with something hidden in it: (seed, kind, number) decides everything.

A device of the default population (rocking Q > 600, c12 = 0), 1 mV of noise, offsets of a few millivolts, the standard
records; the effects with SNRs log-uniform in the range of the kind.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal
from zlib import crc32

import numpy as np
from scipy.signal import lfilter

from pipeline.arrays import FloatArray
from pipeline.errors import UsageError
from pipeline.experiment.excitation import drive_samples
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Record

from ...simulate import device_parameters, standard_excitations
from .effects import LIBRARY, Drawn, draw_effect, peak_of
from .strengths import FittedBaseline, baseline, modelled, sized
from .truth import OUTSIDE, clipped, hum, response

Noise = Literal["white", "coloured", "heavy-tailed", "louder"]

SIGMA_V = 1e-3
INSTRUMENT = Instrument(antialias=AntiAlias(), adc=Adc())
_LEAST_Q = 600.0
_ANGULAR_GAIN = 0.7
_OFFSET_V = 2e-3
#: Hidden together they cannot be told from one of them.
_LIKE = ({"pickoff_pole", "loop_delay"}, {"updown_tilt", "electrode_mismatch"})


@dataclass(frozen=True)
class HiddenKind:
    """A kind of campaign: how many the issue asks for, SNR range, noise."""

    campaigns: int
    meaning: str
    snr: tuple[float, float] = (10.0, 1000.0)
    noise: Noise = "white"


KINDS: dict[str, HiddenKind] = {
    "none": HiddenKind(500, "nothing hidden"),
    "one": HiddenKind(220, "one library effect"),
    "weak": HiddenKind(110, "one library effect, weak", (4.0, 10.0)),
    "outside": HiddenKind(54, "one effect that is in no library"),
    "left-out": HiddenKind(66, "one library effect, taken out of the library"),
    "two": HiddenKind(60, "two library effects"),
    "coloured": HiddenKind(60, "nothing hidden, coloured noise", noise="coloured"),
    "heavy-tailed": HiddenKind(60, "nothing hidden, noise of Student's t, 4 degrees of freedom", noise="heavy-tailed"),
    "louder": HiddenKind(60, "nothing hidden, noise 20 % stronger in the driven records", noise="louder"),
}


@dataclass(frozen=True, eq=False)
class Hidden:
    """A campaign and what is hidden in it.

    ``values``: all parameters by name; ``sizes``: names of those that are zero without their effect; ``snr``: of each of
    the ``effects``; ``left_out``: library effects that the loop must do without.
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


def stream(seed: int, kind: str, number: int, purpose: str) -> np.random.Generator:
    """The random numbers of one purpose in one campaign."""
    key = (crc32(kind.encode()), number, crc32(purpose.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def effects_of(kind: str, number: int, random: np.random.Generator) -> tuple[str, ...]:
    """Names of what campaign ``number`` of ``kind`` hides: each in turn, pairs at random."""
    if kind in ("one", "weak", "left-out"):
        return (LIBRARY[number % len(LIBRARY)],)
    if kind == "outside":
        return (tuple(OUTSIDE)[number % len(OUTSIDE)],)
    if kind != "two":
        return ()
    while True:
        first, second = sorted(str(name) for name in random.choice(LIBRARY, 2, replace=False))
        if {first, second} not in _LIKE:
            return first, second


def device(random: np.random.Generator) -> dict[str, float]:
    """Plant parameters of a device of the default population with rocking Q > 600."""
    while True:
        values = device_parameters({}, int(random.integers(2**31)))
        if max(values["zeta1"], values["zeta2"]) < 0.5 / _LEAST_Q:
            return values


def noise(kind: Noise, silent: bool, samples: int, random: np.random.Generator) -> FloatArray:
    """(samples, 2) of noise [V] with an sd of 1 mV, but for the driven records of "louder"."""
    if kind == "heavy-tailed":
        return np.asarray(SIGMA_V / np.sqrt(2.0) * random.standard_t(4.0, (samples, 2)))
    white = random.standard_normal((samples, 2))
    if kind == "coloured":
        return np.asarray(SIGMA_V * np.sqrt(1.0 - 0.7**2) * lfilter([1.0], [1.0, -0.7], white, axis=0))
    return SIGMA_V * white * (1.2 if kind == "louder" and not silent else 1.0)


def hide(kind: str, number: int, seed: int) -> Hidden:
    """Campaign ``number`` of ``kind``.

    Raises
    ------
    UsageError : an unknown kind, or a negative number.
    """
    if kind not in KINDS or number < 0:
        raise UsageError("no such hidden campaign", value=f"{kind} {number}", allowed=f"{', '.join(KINDS)}; 0 and up")
    random = stream(seed, kind, number, "device")
    values = device(random)
    effects = effects_of(kind, number, random)
    empty = _empty(int(random.integers(2**31)))
    snr: list[float] = []
    sizes: list[str] = []
    if effects:
        fitted = [r for r in empty if r.role == "fit"]
        # What the ADC adds to the noise.
        sigma = float(np.hypot(SIGMA_V, Adc().lsb_v / np.sqrt(12.0)))
        base = baseline(values, fitted, INSTRUMENT, sigma)
        before = modelled(values, (), fitted, INSTRUMENT)
        changed = dict(values)
        for i, effect in enumerate(effects):
            target = float(np.exp(random.uniform(*np.log(KINDS[kind].snr))))
            drawn = draw_effect(effect, values, peak_of(before), random)
            found = _strength(
                effect, drawn, values, fitted, before, base, target, stream(seed, kind, number, f"hum{i}")
            )
            changed |= drawn.at(found[0])
            snr.append(found[1])
            sizes += drawn.direction
        values = changed
    clean = _answers(values, empty)
    measured = tuple(
        _measured(r, clean.get(r.name), values, KINDS[kind].noise, stream(seed, kind, number, f"record{i}"))
        for i, r in enumerate(empty)
    )
    campaign = Campaign(f"{kind}-{number}", measured, INSTRUMENT, _ANGULAR_GAIN, 1.0)
    left_out = effects if kind == "left-out" else ()
    return Hidden(kind, number, seed, effects, values, tuple(sizes), tuple(snr), left_out, campaign)


def _empty(seed: int) -> tuple[Record, ...]:
    rate = INSTRUMENT.sample_rate_hz
    drives = [(n, role, drive_samples(e, rate)) for n, role, e in standard_excitations(seed)]
    return tuple(Record(name, rate, v, np.zeros_like(v), role=role) for name, role, v in drives)


def _answers(values: Mapping[str, float], records: tuple[Record, ...]) -> dict[str, FloatArray]:
    """The noise-free driven records by name, those with the same drive computed once."""
    made: dict[bytes, FloatArray] = {}
    out = {}
    for record in records:
        key = record.drive_v.tobytes()
        if record.role != "noise":
            if key not in made:
                made[key] = response(values, record.drive_v, INSTRUMENT)
            out[record.name] = made[key]
    return out


def _strength(
    effect: str,
    drawn: Drawn,
    values: Mapping[str, float],
    fitted: list[Record],
    before: list[FloatArray],
    base: FittedBaseline,
    target: float,
    random: np.random.Generator,
) -> tuple[float, float]:
    """Size of the effect for an SNR of ``target``, and the SNR that it has."""
    rate = INSTRUMENT.sample_rate_hz
    if effect == "mains_hum":
        per_size = base.snr([hum(drawn.at(1.0), y.shape[0], rate, random) for y in before])
        return target / per_size, target

    def snr_of(size: float) -> float:
        trial = {**values, **drawn.at(size)}
        if effect == "adc_saturation":
            return base.snr([clipped(y, trial) - y for y in before])
        if effect in OUTSIDE:
            return base.snr([y - z for y, z in zip((response(trial, r.drive_v, INSTRUMENT) for r in fitted), before)])
        return base.snr([y - z for y, z in zip(modelled(trial, (effect,), fitted, INSTRUMENT), before)])

    found = sized(snr_of, target, drawn.most)
    return found.size, found.snr


def _measured(
    record: Record, clean: FloatArray | None, values: Mapping[str, float], kind: Noise, random: np.random.Generator
) -> Record:
    """Offset, noise and hum on top, then the converter."""
    samples = record.drive_v.shape[0]
    volts = record.sense_v if clean is None else clipped(clean, values)
    volts = volts + _OFFSET_V * random.standard_normal(2) + noise(kind, clean is None, samples, random)
    if values.get("adc_saturation.clips_noise", 0.0):
        volts = clipped(volts, values)
    volts = volts + hum(values, samples, record.sample_rate_hz, random)
    adc = INSTRUMENT.adc
    assert adc is not None
    half = 2.0 ** (adc.bits - 1)
    return replace(record, sense_v=np.clip(np.rint(volts / adc.lsb_v), -half, half - 1.0) * adc.lsb_v)
