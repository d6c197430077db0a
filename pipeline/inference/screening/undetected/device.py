"""Scores of a fitted device against the library of effects: its spectra, its fit and its quantities put together.

    spectra of Jacobian, signatures, residual  ->  rows in sigmas, and those of the prior  ->  scores and bounds

Shapes: P parameters, W bins, S = 2 senses.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import groupby
from typing import Any, TypeVar

import numpy as np

from ....arrays import FloatArray, IntArray
from ....experiment.instrument import Instrument
from ....experiment.noise.spectrum import NoiseSpectrum
from ...estimate import RateSettings
from ...gate import Undetected
from ..compressed import BandData
from ..fit import Fit
from ..mismatch import MismatchPrior
from .bounds import Candidates, EffectEvidence, Judged, Projection, judged, judged_together, summary
from .clipping import Loud, adc_sizes, drive_sizes
from .forces import forces_of
from .library import BandSignature, write_real
from .linear import LinearDevice, Moved, linear_devices
from .linear_stages import moved_mechanics
from .rows import products_of, record_weight, stationary_variance, take_out_hum, white_products
from .scan_bounds import judged_scans
from .scanned import BandScan, ScannedProducts, scanned_products, scans_of
from .signatures import Along, Motion, band_motion, signatures
from .slopes import QuantitySlopes, feature_slopes, quantity_slopes

T = TypeVar("T")
#: Devices whose forces are computed at once: four take 0.1 ms more each.
_AT_ONCE = 8


@dataclass(frozen=True, eq=False)
class Scoring:
    """A fitted device whose effects are to be scored.

    Parameters
    ----------
    fit : at the maximum.
    data, louds : its records in their band, and the samples of their models near their peaks (``loud_samples``).
    noise : spectrum of the silence.
    instrument, rate, prior, line_hz : as for ``identify_device``.
    """

    fit: Fit
    data: Sequence[BandData]
    louds: Sequence[Loud]
    noise: NoiseSpectrum
    instrument: Instrument
    rate: RateSettings
    prior: MismatchPrior | None
    line_hz: float | None


@dataclass(frozen=True, eq=False)
class _Linear:
    """What a stage passes on: the linear device in each band, its moved mechanics, and the sizes of the ADC stage."""

    devices: tuple[LinearDevice, ...]
    moved: Moved
    sizes: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Products:
    """Products (P + 1 + K, P + 1 + K) of the rows [J, r, Z] in sigmas, those of the scans, and the candidates Z."""

    whole: FloatArray
    scanned: ScannedProducts
    candidates: Candidates


def scored_device(scoring: Scoring) -> Undetected:
    """Scores and bounds of a fitted device.

    Raises
    ------
    numpy.linalg.LinAlgError, ConfigError : the linear device or its Jacobian is singular.
    """
    (slopes,) = quantity_slopes(scoring.fit.x[None], scoring.rate, scoring.prior)
    (linear,) = _linear([scoring])
    posed = _posed(scoring, _products(scoring, linear), slopes)
    return summary((judged(posed.problem), posed.scans), posed.quantities)


def scored_devices(scorings: Sequence[Scoring]) -> list[Undetected | Exception]:
    """:func:`scored_device` of each, stage by stage; what it raises takes the place of its scores.

    Each device passes its stages as it does alone, so its scores are the same bit for bit.
    """
    if len(scorings) == 1 or any(len(scoring.data) > 1 for scoring in scorings):
        # A long record is given up part by part.
        return _each(scored_device, scorings)
    linear = _together(_linear, lambda one: (one.instrument.bias_v, one.prior is None, one.fit.x.size), scorings)
    motions = _each(lambda one: band_motion(*one.devices), linear)
    along = _together(_along, _driven_alike, scorings, linear, motions)
    products = _each(_products, scorings, linear, along)
    slopes = _together(_slopes_of, lambda one: (one.rate, one.prior), scorings)
    posed = _each(_posed, scorings, products, slopes)
    return _each(lambda one, own: summary((own, one.scans), one.quantities), posed, _judged_of(posed))


def _each(stage: Callable[..., T], *inputs: Sequence[Any]) -> list[T | Exception]:
    """The stage of each device, from its inputs; an exception among them is passed on."""
    out: list[T | Exception] = []
    for own in zip(*inputs):
        failed = next((one for one in own if isinstance(one, Exception)), None)
        try:
            out.append(stage(*own) if failed is None else failed)
        except Exception as error:
            out.append(error)
    return out


def _together(
    stage: Callable[..., Sequence[T]], alike: Callable[..., Hashable], *inputs: Sequence[Any]
) -> list[T | Exception]:
    """The stage of devices that follow each other and are ``alike``, all at once; where that fails, of each alone."""

    def kind(own: tuple[Any, ...]) -> Hashable:
        return None if any(isinstance(one, Exception) for one in own) else (alike(*own),)

    out: list[T | Exception] = []
    for key, members in groupby(zip(*inputs), key=kind):
        group = list(members)
        if key is not None and len(group) > 1:
            try:
                out += stage(*(list(each) for each in zip(*group)))
                continue
            except Exception:
                # One of them fails; the others must not.
                pass
        out += _each(lambda *own: stage(*([one] for one in own))[0], *zip(*group))
    return out


def _linear(scorings: Sequence[Scoring]) -> list[_Linear]:
    """The linear devices of scorings with the same bias and parameters."""
    instrument, with_mismatch = scorings[0].instrument, scorings[0].prior is not None
    bands = [[item.band for item in scoring.data] for scoring in scorings]
    found = linear_devices(
        [scoring.fit for scoring in scorings], bands, instrument, partial(moved_mechanics, with_mismatch)
    )
    out = []
    for scoring, own_bands, (devices, moved) in zip(scorings, bands, found):
        sizes = adc_sizes(scoring.louds, scoring.noise.sigma_v, instrument.bias_v, with_mismatch)
        out.append(_Linear(devices, moved, sizes | drive_sizes(own_bands, with_mismatch)))
    return out


def _driven_alike(scoring: Scoring, linear: _Linear, motion: Motion) -> Hashable:
    return id(scoring.data[0].band), scoring.instrument.bias_v, scoring.prior is None


def _along(scorings: Sequence[Scoring], linear: Sequence[_Linear], motions: Sequence[Motion]) -> list[Along]:
    """The motion of devices with one record each, and the forces along it."""
    devices, sizes = [one.devices[0] for one in linear], [one.sizes for one in linear]
    signals, forces = [own for _, own in motions], []
    for first in range(0, len(devices), _AT_ONCE):
        own = slice(first, first + _AT_ONCE)
        forces += forces_of(devices[own], signals[own], sizes[own], scorings[0].prior is not None)
    return [Along(*motion, own) for motion, own in zip(motions, forces)]


def _products(scoring: Scoring, linear: _Linear, along: Along | None = None) -> _Products:
    """Products of all rows, summed over the records and the prior of the fit.

    ``along``: the motion and the forces of a device with one record, if they are known.
    """
    fit, data, with_mismatch = scoring.fit, scoring.data, scoring.prior is not None
    slopes, count = feature_slopes(fit), fit.x.size
    first = data[0].band.frequency_hz
    products: FloatArray | float = 0.0
    scanned: ScannedProducts | None = None
    candidates: Candidates | None = None
    for item, device, loud in zip(data, linear.devices, scoring.louds):
        edges = (float(first[0]), float(first[-1]))
        scans = scans_of(item.band, edges, scoring.line_hz, with_mismatch)
        found = signatures(device, linear.moved, loud, linear.sizes, with_mismatch, slopes, along)
        write_real(item.spectrum - found.sensed, found.rows[count])
        variance = stationary_variance(item, scoring.noise.sigma_v)
        candidates = _candidates(found.signatures)
        more, part = _of_record(found.rows, candidates.numbers, item, scans, variance)
        del found  # its rows are as large as a long record
        products = products + more
        scanned = part if scanned is None else scanned + part
    assert scanned is not None
    assert candidates is not None
    return _Products(np.array(products), scanned, candidates)


def _candidates(found: Sequence[BandSignature]) -> Candidates:
    """The effects of signatures, with the ranges of their strengths in units of the rows."""
    low, high = (np.array([getattr(one, end) * one.per_unit for one in found]) for end in ("low", "high"))
    return Candidates(tuple(one.effect for one in found), low, high)


@dataclass(frozen=True, eq=False)
class _Posed:
    """What is to be judged of a device: its effects; its scans are judged already.  The quantities that are known."""

    problem: EffectEvidence
    scans: Judged
    quantities: tuple[str, ...]


def _posed(scoring: Scoring, products: _Products, slopes: QuantitySlopes) -> _Posed:
    fit, data, prior, whole = scoring.fit, scoring.data, scoring.prior, products.whole
    count = fit.x.size
    of_prior = _prior_products(prior, fit.x)
    # The signatures have no part in the rows of the prior.
    whole[: count + 1, : count + 1] += of_prior
    names, gradient = slopes
    frequency = np.concatenate([item.band.frequency_hz for item in data])
    dof = 2.0 / float(np.mean(scoring.noise.relative_sd(frequency) ** 2))
    projection = Projection.of(whole[:count, :count], gradient)
    base = products.scanned.base + of_prior
    # Scans take noise that depends on the signal at its largest variance, and their fit with it.
    depends = any(item.noise is not None and item.noise.dependent.size for item in data)
    of_scans = Projection.of(base[:count, :count], gradient) if depends else projection
    scans = judged_scans(products.scanned, of_scans, base[:count, count], dof)
    return _Posed(EffectEvidence(whole, projection, products.candidates, dof), scans, names)


def _judged_of(posed: Sequence[_Posed | Exception]) -> list[Judged | Exception]:
    """The effects of each device judged."""
    return _together(
        lambda group: judged_together([one.problem for one in group]),
        lambda one: (one.problem.candidates.effects, one.quantities),
        posed,
    )


def _slopes_of(scorings: Sequence[Scoring]) -> list[QuantitySlopes]:
    """The slopes of the quantities of devices with the same rate settings and prior."""
    return quantity_slopes(np.stack([one.fit.x for one in scorings]), scorings[0].rate, scorings[0].prior)


def _of_record(
    rows: FloatArray, effects: IntArray, item: BandData, scans: Iterable[BandScan], variance: FloatArray
) -> tuple[FloatArray, ScannedProducts]:
    """Products (P + 1 + K, P + 1 + K) in sigmas of the rows [J, r, Z] of a record, and those of its scans with J and r.

    The hum lines are taken out of the rows in place; ``effects`` (K,) are numbers of those of Z.
    """
    count = rows.shape[0] - effects.size - 1
    fit = slice(0, count + 1)
    weight = record_weight(item, variance)
    take_out_hum(rows, item.nuisance)
    if item.noise is None:
        products = white_products(rows, count + 1, effects, item, variance)
        return products, scanned_products(scans, rows[fit], weight, products[fit, fit])
    products = products_of(rows, item, item.noise, variance)
    base = products[fit, fit]
    if item.noise.dependent.size:
        flat = (rows[fit] * np.tile(weight, 2)).reshape(count + 1, -1)
        base = flat @ flat.T
    return products, scanned_products(scans, rows[fit], weight, base)


@lru_cache(maxsize=4)
def _rows_of(prior: MismatchPrior) -> tuple[FloatArray, FloatArray]:
    """Root and offset of a prior, which all devices of a run share."""
    return prior.rows()


def _prior_products(prior: MismatchPrior | None, x: FloatArray) -> FloatArray:
    """What the prior adds to [J, r]' [J, r], (P + 1, P + 1)."""
    if prior is None:
        return np.zeros((x.size + 1, x.size + 1))
    root, offset = _rows_of(prior)
    rows = np.zeros((x.size + 1, offset.size))
    rows[12:14] = root.T
    rows[-1] = offset - root @ x[12:]
    return rows @ rows.T
