"""Scores of a fitted device against the library of effects: its spectra, its fit and its quantities put together.

    spectra of Jacobian, signatures, residual  ->  rows in sigmas, and those of the prior  ->  scores and bounds

Shapes: P parameters, W bins, S = 2 senses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import groupby
from typing import Any, TypeVar

import numpy as np
from numba import njit

from ....arrays import ComplexArray, FloatArray, IntArray
from ....axial import wrap
from ....experiment.instrument import Instrument
from ....experiment.noise.spectrum import NoiseSpectrum
from ....quantities import AXES, IDENTIFIED
from ...estimate import RateSettings, cartesian_quantities
from ...gate import Undetected
from ..compressed import BandData
from ..fit import Fit
from ..likelihood import FEATURES, STEPS, coefficients
from ..mismatch import MismatchPrior, mean_plant
from .bounds import Candidates, EffectEvidence, Judged, Projection, judged, judged_together, summary
from .clipping import Loud, adc_sizes, drive_sizes
from .library import BandSignature, write_real
from .linear import LinearDevice, Moved, linear_devices
from .linear_stages import moved_mechanics
from .rows import products_of, record_weight, stationary_variance, take_out_hum, white_products
from .scan_bounds import judged_scans
from .scanned import BandScan, ScannedProducts, scanned_products, scans_of
from .signatures import signatures

T = TypeVar("T")
#: Names of the quantities that are known, and dq/dx (Q, P).
QuantitySlopes = tuple[tuple[str, ...], FloatArray]


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
    posed = _posed(scoring, _products(scoring, _linear(scoring)), slopes)
    return summary((judged(posed.problem), posed.scans), posed.quantities)


def scored_devices(scorings: Sequence[Scoring]) -> list[Undetected | Exception]:
    """:func:`scored_device` of each, stage by stage; what it raises takes the place of its scores.

    Each device passes its stages as it does alone, so its scores are the same bit for bit.
    """
    if len(scorings) == 1:
        # A long record is given up part by part.
        return _each(scored_device, scorings)
    linear = _each(_linear, scorings)
    products = _each(_products, scorings, linear)
    posed = _each(_posed, scorings, products, _slopes_of(scorings))
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


def _linear(scoring: Scoring) -> _Linear:
    with_mismatch = scoring.prior is not None
    sizes = adc_sizes(scoring.louds, scoring.noise.sigma_v, scoring.instrument.bias_v, with_mismatch)
    bands = [item.band for item in scoring.data]
    sizes |= drive_sizes(bands, with_mismatch)
    return _Linear(
        *linear_devices(scoring.fit, bands, scoring.instrument, partial(moved_mechanics, with_mismatch)), sizes
    )


def _products(scoring: Scoring, linear: _Linear) -> _Products:
    """Products of all rows, summed over the records and the prior of the fit."""
    fit, data, with_mismatch = scoring.fit, scoring.data, scoring.prior is not None
    slopes, count = feature_slopes(fit), fit.x.size
    first = data[0].band.frequency_hz
    products: FloatArray | float = 0.0
    scanned: ScannedProducts | None = None
    candidates: Candidates | None = None
    for item, device, loud in zip(data, linear.devices, scoring.louds):
        edges = (float(first[0]), float(first[-1]))
        scans = scans_of(item.band, edges, scoring.line_hz, with_mismatch)
        found = signatures(device, linear.moved, loud, linear.sizes, with_mismatch, slopes)
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
    """The effects of each device judged; those that follow each other with the same effects and quantities at once."""

    def alike(one: _Posed | Exception) -> tuple[Any, ...]:
        return () if isinstance(one, Exception) else (one.problem.candidates.effects, one.quantities)

    out: list[Judged | Exception] = []
    for key, own in groupby(posed, key=alike):
        group = list(own)
        if key and len(group) > 1:
            try:
                out += judged_together([one.problem for one in group if isinstance(one, _Posed)])
                continue
            except Exception:
                # One of them fails; the others must not.
                pass
        out += _each(lambda one: judged(one.problem), group)
    return out


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


def feature_slopes(fit: Fit) -> FloatArray:
    """Slopes (P, S, J), per unit of x, of the coefficients of the model's spectrum in the features of the fit."""
    slopes = np.empty((fit.x.size, 2, FEATURES))
    _feature_slopes(fit.x, fit.likelihood.expansion, slopes)
    return slopes


@njit(cache=True)
def _feature_slopes(x: FloatArray, expansion: ComplexArray, out: FloatArray) -> None:
    ahead, behind, shift = np.empty((2, FEATURES)), np.empty((2, FEATURES)), np.empty(3)
    for i in range(x.size):
        moved = x.copy()
        moved[i] = x[i] + STEPS[i]
        coefficients(moved, expansion, ahead, shift)
        moved[i] = x[i] - STEPS[i]
        coefficients(moved, expansion, behind, shift)
        for a in range(2):
            for j in range(FEATURES):
                out[i, a, j] = (ahead[a, j] - behind[a, j]) / (2.0 * STEPS[i])


def quantity_slopes(x: FloatArray, rate: RateSettings, prior: MismatchPrior | None) -> list[QuantitySlopes]:
    """Names of the quantities that are known, and dq/dx (Q, P), of each of the parameters x (B, P)."""
    size = x.shape[1]
    step = STEPS[:size]
    moves = np.concatenate([np.diag(step), -np.diag(step)])
    points = (x[:, None] + moves).reshape(-1, size)
    q = cartesian_quantities(points if prior is None else mean_plant(points, prior), rate)
    names = tuple(quantity.name for quantity in IDENTIFIED)
    both = np.stack([q[name] for name in names]).reshape(len(names), x.shape[0], 2, size)
    change = both[:, :, 0] - both[:, :, 1]
    axes = [names.index(name) for name in AXES]
    change[axes] = wrap(change[axes])
    change /= 2.0 * step
    known = np.asarray(np.isfinite(change).all(axis=2))
    return [
        (tuple(name for name, is_known in zip(names, own) if is_known), change[own, i]) for i, own in enumerate(known.T)
    ]


def _slopes_of(scorings: Sequence[Scoring]) -> list[QuantitySlopes | Exception]:
    """The slopes of the quantities of each device; those with the same rate settings and prior at once."""
    out: list[QuantitySlopes | Exception] = []
    for _, own in groupby(scorings, key=lambda one: (one.rate, one.prior)):
        group = list(own)
        try:
            out += quantity_slopes(np.stack([one.fit.x for one in group]), group[0].rate, group[0].prior)
        except Exception as error:
            out += [error] * len(group)
    return out
