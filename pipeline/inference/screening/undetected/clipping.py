"""Sizes at which clipping is probed, neither invisible nor loud, and the signatures of the ADC stage.

Shapes: N samples, S = 2 senses, W bins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ....arrays import ComplexArray, FloatArray, IntArray
from ....device.effect import Context
from ..inband import Band
from ..kept import kept_if_short
from .library import Acting, probes_of, write_real
from .linear import LinearDevice

#: Products of samples and bins, relative to the samples of the record, up to which a sum takes less time than an FFT.
_FEW = 8
#: Change of all samples by a probe of the ADC stage [sigma], and the samples near the peak, relative to it.
_CLIPPED, _LOUD = 30.0, 0.9


Loud = tuple[IntArray, FloatArray]


def loud_samples(model_v: FloatArray) -> Loud:
    """Indices and volts (n, S) of the samples (N, S) [V] near the peak, which are all that a weak clip changes."""
    size = np.abs(model_v)
    size = np.maximum(size[:, 0], size[:, 1])
    loud = np.flatnonzero(size > _LOUD * float(size.max()))
    return loud, model_v[loud]


def adc_sizes(louds: Sequence[Loud], sigma_v: FloatArray, bias_v: float, with_mismatch: bool) -> dict[str, float]:
    """Effect of the ADC stage with one parameter -> value at which the samples change by about ``_CLIPPED`` sigmas in all.

    Less is invisible and more is loud, in the record with the largest peak.
    """
    context = Context(bias_v, bias_v, {})
    volts = louds[0][1] if len(louds) == 1 else max((v for _, v in louds), key=lambda v: float(np.max(np.abs(v))))
    found: dict[str, float] = {}
    for probe in probes_of(with_mismatch, "adc"):
        if probe.effect.adc is None or probe.size != 1:
            continue
        low, high = 1e-6 * probe.member.scale, probe.member.high
        for _ in range(40):
            middle = math.sqrt(low * high)
            change = (probe.effect.adc(volts, np.array([middle]), context) - volts) / sigma_v
            size = math.sqrt(np.vdot(change, change))
            low, high = (low, middle) if size > _CLIPPED else (middle, high)
            if 0.5 * _CLIPPED < size < 2.0 * _CLIPPED:
                break
        found[probe.effect.name] = middle
    return found


@kept_if_short(4)
def _peak_v(band: Band) -> float:
    return float(np.max(np.abs(band.drive_v), initial=0.0))


def drive_sizes(bands: Sequence[Band], with_mismatch: bool) -> dict[str, float]:
    """Effect that clips the drive -> 1/level [1/V] of a level at 0.9 of the largest drive of the records."""
    peak_v = max(_peak_v(band) for band in bands)
    clips = {probe.effect.name for probe in probes_of(with_mismatch, "drive") if probe.effect.clips("drive")}
    return dict.fromkeys(clips, 1.0 / (_LOUD * peak_v)) if peak_v > 0.0 else {}


def adc_signatures(
    device: LinearDevice, louds: Loud, sizes: Mapping[str, float], with_mismatch: bool, out: FloatArray
) -> list[Acting]:
    """Changes by the ADC stage at ``sizes`` of :func:`adc_sizes`, written to the first rows of ``out`` (.., S, 2 W)."""
    found: list[Acting] = []
    loud, volts = louds
    for probe in probes_of(with_mismatch, "adc"):
        if probe.effect.adc is None or probe.effect.name not in sizes:
            continue
        change = probe.effect.adc(volts, np.array([sizes[probe.effect.name]]), device.context) - volts
        moved = np.flatnonzero(change.any(axis=1))
        write_real(transform_of_few(device.band, loud[moved], change[moved]), out[len(found)])
        found.append(Acting(probe, 1.0, 0))
    return found


def transform_of_few(band: Band, where: IntArray, change: FloatArray) -> ComplexArray:
    """``band.transform`` (S, W) of a record that is ``change`` (n, S) at the samples ``where`` (n,) and zero elsewhere.

    With a bin b = b0 + L j + k, exp(-i w_b n) is a product of two factors, of which there are 2 sqrt(W) for a sample.
    """
    bins, samples = band.bins, band.samples
    if where.size * bins.size > _FEW * samples:
        whole = np.zeros((samples, change.shape[1]))
        whole[where] = change
        return band.transform(whole)
    length = math.isqrt(bins.size - 1) + 1
    steps = np.concatenate([bins[::length], np.arange(length)])
    # Whole turns are taken off as integers, so that the angle keeps all its digits.
    waves = np.exp((-2j * np.pi / samples) * ((where[:, None] * steps) % samples))
    coarse, fine = waves[:, :-length], waves[:, -length:]
    found = (coarse.T * change.T[:, None]) @ fine
    return np.ascontiguousarray(found.reshape(change.shape[1], -1)[:, : bins.size])
