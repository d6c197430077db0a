"""What an effect does to a record, as the picture of its page shows it.

The device is like that of the paper.  The record is a chirp of 1 s; the size of the effect changes it by a given SNR.

    change = y(effect) - y(none)          left = (I - P) change

P projects onto what the parameters of the plant and an offset per channel can change, so ``left`` is what a fit of the
plant alone leaves. Shapes: N samples, S senses. Units: volts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.effect import Context, Effect
from pipeline.device.example import GYRO
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward, jacobian
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

from ..simulate import sized

SIGMA_V = 1e-3
SNR = 300.0
_RATE_HZ = 10_000.0
#: Frequency of an additional mode [Hz].
_MODE_HZ = 562.0
_SEED = 1
#: Amplitude of each hum line [V].
_HUM_V = 1e-3


@dataclass(frozen=True, eq=False)
class EffectSignature:
    """The record without the effect (N, S), the change by the effect, and what is left of it after a fit of the plant [V].

    ``sizes``: the parameters of the effect by full name, each in its unit.
    """

    effect: str
    sizes: Mapping[str, float]
    record: FloatArray
    change: FloatArray
    left: FloatArray
    rate_hz: float = _RATE_HZ


def effect_signature(effect: Effect) -> EffectSignature:
    """The signature of an effect of the library on a gyro."""
    drive = drive_samples(Chirp(duration_s=1.0), _RATE_HZ)
    empty = Record("chirp", _RATE_HZ, drive, np.zeros_like(drive))
    instrument = Instrument(_RATE_HZ, antialias=AntiAlias())
    model = DEFAULT_COMPARE_MODEL.with_effect(effect.name)
    plant = {name: value for name, value in GYRO.items() if name in model.by_name}
    record = forward(DEFAULT_COMPARE_MODEL, plant, empty, instrument)
    if effect.disturbance is not None:
        # Lines add to the record; their amplitudes are no parameters.
        p = np.array([parameter.null if not parameter.grid else parameter.grid[-1] for parameter in effect.parameters])
        lines = effect.disturbance(np.arange(len(drive)) / _RATE_HZ, p, Context(5.0, 5.0, plant)).sum(axis=1)
        change = np.stack([_HUM_V * lines] * drive.shape[1], axis=1)
        return EffectSignature(effect.name, dict(zip((q.name for q in effect.parameters), p)), record, change, change)
    random = np.random.default_rng(_SEED)
    sizes = sized(model, plant, effect.name, empty, instrument, SIGMA_V, random, SNR)
    if effect.resonance:
        # Between the modes, where the chirp excites it; the change is proportional to the other parameters.
        sizes[f"{effect.name}.{effect.resonance[0]}"] = _MODE_HZ
        size = float(np.linalg.norm(forward(model, {**plant, **sizes}, empty, instrument) - record)) / SIGMA_V
        free = {effect.full_name(one) for one in effect.members(model.built.shape) if not one.grid}
        sizes = {name: value * (SNR / size if name in free else 1.0) for name, value in sizes.items()}
    change = forward(model, {**plant, **sizes}, empty, instrument) - record
    return EffectSignature(
        effect.name, sizes, record, change, _left(change, jacobian(DEFAULT_COMPARE_MODEL, plant, empty, instrument))
    )


def alike(one: EffectSignature, other: EffectSignature) -> float:
    """|cosine| between what two effects leave after a fit of the plant: 1 where one chirp cannot tell them apart."""
    size = float(np.linalg.norm(one.left) * np.linalg.norm(other.left))
    return abs(float(np.sum(one.left * other.left))) / size if size > 0.0 else 0.0


def _left(change: FloatArray, derivatives: FloatArray) -> FloatArray:
    """``change`` (N, S) without what the derivatives (N, S, k) and offsets explain."""
    samples, senses = change.shape
    offsets = np.zeros((samples, senses, senses))
    for k in range(senses):
        offsets[:, k, k] = 1.0
    columns = np.concatenate([derivatives, offsets], axis=2).reshape(samples * senses, -1)
    columns = columns / np.linalg.norm(columns, axis=0)
    basis, _ = np.linalg.qr(columns)
    whole = change.reshape(-1)
    return np.asarray((whole - basis @ (basis.T @ whole)).reshape(samples, senses))
