"""Signatures of the ADC stage: the change of the samples of the model, at a size that is neither invisible nor loud.

Shapes: N samples, S = 2 senses, W bins.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....arrays import FloatArray, IntArray
from ....device.effect import Context, Effect
from .library import BandSignature, members_of, scored_effects
from .linear import LinearDevice

#: Change of all samples by a probe of the ADC stage [sigma], and the samples near the peak, relative to it.
_CLIPPED, _LOUD = 30.0, 0.9


def adc_probes(
    models_v: Sequence[FloatArray], sigma_v: FloatArray, bias_v: float, with_mismatch: bool
) -> dict[str, float]:
    """Effect of the ADC stage with one parameter -> value at which the samples change by about ``_CLIPPED`` sigmas in all.

    Less is invisible and more is loud, in the record with the largest peak; ``models_v`` (N, S) [V] of each record.
    """
    context = Context(bias_v, bias_v, {})
    volts = max((_loud(v)[1] for v in models_v), key=lambda v: float(np.max(np.abs(v))))
    found: dict[str, float] = {}
    for effect in scored_effects(with_mismatch):
        members = members_of(effect)
        if effect.adc is None or len(members) != 1:
            continue
        low, high = 1e-6 * members[0].scale, members[0].high
        for _ in range(40):
            middle = float(np.sqrt(low * high))
            size = float(np.linalg.norm((effect.adc(volts, np.array([middle]), context) - volts) / sigma_v))
            low, high = (low, middle) if size > _CLIPPED else (middle, high)
            if 0.5 * _CLIPPED < size < 2.0 * _CLIPPED:
                break
        found[effect.name] = middle
    return found


def _loud(model_v: FloatArray) -> tuple[IntArray, FloatArray]:
    """Indices and volts of the samples near the peak, which are all that a weak clip changes."""
    size = np.abs(model_v)
    loud = np.flatnonzero(np.maximum(size[:, 0], size[:, 1]) > _LOUD * float(size.max()))
    return loud, model_v[loud]


def adc_signature(effect: Effect, device: LinearDevice, model_v: FloatArray, probe: float) -> BandSignature:
    assert effect.adc is not None
    loud, volts = _loud(model_v)
    whole = np.zeros_like(model_v)
    whole[loud] = effect.adc(volts, np.array([probe]), device.context) - volts
    return BandSignature(effect.name, device.band.transform(whole), 0.0, np.inf)
