"""Sizes at which clipping is probed, neither invisible nor loud, and the signatures of the ADC stage.

Shapes: N samples, S = 2 senses, W bins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numba import njit

from ....arrays import ComplexArray, FloatArray, IntArray
from ....device.effect import Context
from ..inband import Band
from ..kept import kept_if_short
from .library import Acting, Changed, probes_of
from .linear import LinearDevice

#: Products of samples and bins, relative to the samples of the record, up to which a sum takes less time than an FFT.
_FEW = 8
#: Change of all samples by a probe of the ADC stage [sigma], and the samples near the peak, relative to it.
_CLIPPED, _LOUD = 30.0, 0.9
#: Changes that are near enough, and steps of a bisection to one of them: a factor of 1e9 in 30 steps.
_LEAST, _MOST, _STEPS = 0.5 * _CLIPPED, 2.0 * _CLIPPED, 40


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
        clips = probe.effect.clips("adc")
        # The law itself then confirms the first value, which takes a fifth of the time of a bisection with it.
        middle = _clip_value(volts, sigma_v, low, high) if clips else math.sqrt(low * high)
        for _ in range(_STEPS):
            change = (probe.effect.adc(volts, np.array([middle]), context) - volts) / sigma_v
            size = math.sqrt(np.vdot(change, change))
            if _LEAST < size < _MOST:
                break
            low, high = (low, middle) if size > _CLIPPED else (middle, high)
            middle = math.sqrt(low * high)
        found[probe.effect.name] = middle
    return found


@njit(cache=True)
def _clip_value(volts: FloatArray, sigma_v: FloatArray, low: float, high: float) -> float:
    """1/level [1/V] between ``low`` and ``high`` at which a clip at +-level changes the samples (n, S) by about ``_CLIPPED``."""
    middle = math.sqrt(low * high)
    for _ in range(_STEPS):
        level, square = 1.0 / middle, 0.0
        for i in range(volts.shape[0]):
            for a in range(volts.shape[1]):
                over = max(abs(volts[i, a]) - level, 0.0) / sigma_v[a]
                square += over * over
        size = math.sqrt(square)
        if _LEAST < size < _MOST:
            break
        low, high = (low, middle) if size > _CLIPPED else (middle, high)
        middle = math.sqrt(low * high)
    return middle


@kept_if_short(4)
def _peak_v(band: Band) -> float:
    return float(np.max(np.abs(band.drive_v), initial=0.0))


def drive_sizes(bands: Sequence[Band], with_mismatch: bool) -> dict[str, float]:
    """Effect that clips the drive -> 1/level [1/V] of a level at 0.9 of the largest drive of the records."""
    peak_v = max(_peak_v(band) for band in bands)
    clips = {probe.effect.name for probe in probes_of(with_mismatch, "drive") if probe.effect.clips("drive")}
    return dict.fromkeys(clips, 1.0 / (_LOUD * peak_v)) if peak_v > 0.0 else {}


def adc_changes(device: LinearDevice, louds: Loud, sizes: Mapping[str, float], with_mismatch: bool) -> Changed:
    """What the ADC stage changes at ``sizes`` of :func:`adc_sizes`."""
    found: list[Acting] = []
    spectra: list[ComplexArray] = []
    loud, volts = louds
    for probe in probes_of(with_mismatch, "adc"):
        if probe.effect.adc is None or probe.effect.name not in sizes:
            continue
        change = probe.effect.adc(volts, np.array([sizes[probe.effect.name]]), device.context) - volts
        moved = np.flatnonzero(change.any(axis=1))
        spectra.append(transform_of_few(device.band, loud[moved], change[moved]))
        found.append(Acting(probe, 1.0, 0))
    return Changed(found, np.array(spectra, dtype=np.complex128).reshape(len(found), -1, device.band.bins.size))


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
