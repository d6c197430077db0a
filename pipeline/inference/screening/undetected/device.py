"""Scores of a fitted device against the library of effects: its spectra, its fit and its quantities put together.

    spectra of Jacobian, signatures, residual  ->  rows in sigmas, and those of the prior  ->  scores and bounds

Shapes: P parameters, W bins, S = 2 senses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache, partial

import numpy as np

from ....arrays import FloatArray
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
from .bounds import Candidates, Projection, judged, summary
from .clipping import adc_sizes, loud_samples
from .library import BandSignature
from .linear import linear_devices
from .linear_stages import moved_mechanics
from .rows import hum_of, products_of, record_weight, stationary_variance, white_products, without_hum, write_real
from .scan_bounds import judged_scans
from .scanned import BandScan, ScannedProducts, scanned_products, scans_of
from .signatures import signatures


def scored_device(
    fit: Fit,
    data: Sequence[BandData],
    models_v: Sequence[FloatArray],
    noise: NoiseSpectrum,
    instrument: Instrument,
    rate: RateSettings,
    prior: MismatchPrior | None,
    line_hz: float | None,
) -> Undetected:
    """Scores and bounds of a fitted device.

    Parameters
    ----------
    fit : at the maximum.
    data, models_v : its records in their band, and their models (N, S) [V].
    noise : spectrum of the silence.
    instrument, rate, prior, line_hz : as for ``identify_device``.

    Raises
    ------
    numpy.linalg.LinAlgError, ConfigError : the linear device or its Jacobian is singular.
    """
    count = fit.x.size
    found: Sequence[BandSignature] = ()
    products: FloatArray | float = 0.0
    scanned: ScannedProducts | None = None
    with_mismatch = prior is not None
    louds = [loud_samples(model_v) for model_v in models_v]
    sizes = adc_sizes(louds, noise.sigma_v, instrument.bias_v, with_mismatch)
    first = data[0].band.frequency_hz
    devices, moved = linear_devices(
        fit, [item.band for item in data], instrument, partial(moved_mechanics, with_mismatch)
    )
    slopes = feature_slopes(fit)
    for item, loud, device in zip(data, louds, devices):
        found = signatures(device, moved, loud, sizes, with_mismatch)
        scans = scans_of(item.band, (float(first[0]), float(first[-1])), line_hz, with_mismatch)
        rows = np.empty((count + len(found) + 1, 2, 2 * item.band.bins.size))
        np.matmul(slopes.reshape(2 * count, -1), device.columns.T, out=rows[:count].reshape(2 * count, -1))
        for row, one in zip(rows[count:], found):
            write_real(one.change, row, one.per_unit)
        write_real(item.spectrum - device.sensed, rows[-1])
        own, part = _products(rows, count, item, scans, stationary_variance(item, noise.sigma_v))
        del rows  # as large as a long record
        products = products + own
        scanned = part if scanned is None else scanned + part
    assert scanned is not None
    of_prior = _prior_products(prior, fit.x)
    # The signatures have no part in the rows of the prior.
    whole = np.array(products)
    kept = np.append(np.arange(count), count + len(found))
    whole[np.ix_(kept, kept)] += of_prior
    names, gradient = quantity_slopes(fit.x, rate, prior)
    low, high = np.array([one.low for one in found]), np.array([one.high for one in found])
    candidates = Candidates(tuple(one.effect for one in found), low, high)
    frequency = np.concatenate([item.band.frequency_hz for item in data])
    dof = 2.0 / float(np.mean(noise.relative_sd(frequency) ** 2))
    projection = Projection.of(whole[:count, :count], gradient)
    base = scanned.base + of_prior
    # Scans take noise that depends on the signal at its largest variance, and their fit with it.
    depends = any(item.noise is not None and item.noise.dependent.size for item in data)
    of_scans = Projection.of(base[:count, :count], gradient) if depends else projection
    parts = (
        judged(whole, projection, candidates, dof),
        judged_scans(scanned, of_scans, base[:count, count], dof),
    )
    return summary(parts, names)


def _products(
    rows: FloatArray, count: int, item: BandData, scans: Iterable[BandScan], variance: FloatArray
) -> tuple[FloatArray, ScannedProducts]:
    """Products (P + K + 1, P + K + 1) in sigmas of the rows [J, Z, r] of a record, and those of its scans with J and r.

    The hum lines of the residual (the last of the rows) are taken out in place; P = ``count``.
    """
    kept = np.append(np.arange(count), rows.shape[0] - 1)
    weight = record_weight(item, variance)
    if item.noise is None:
        rows[-1:] = without_hum(rows[-1:], item.nuisance)
        hum = hum_of(rows, item.nuisance)
        hum[-1] = 0.0
        products = white_products(rows, hum, item, variance)
        return products, scanned_products(scans, rows[kept], hum[kept], weight, products[np.ix_(kept, kept)])
    products = products_of(rows, item, item.noise, variance)
    left = without_hum(rows[kept], item.nuisance)
    base = products[np.ix_(kept, kept)]
    if item.noise.dependent.size:
        flat = (left * np.tile(weight, 2)).reshape(count + 1, -1)
        base = flat @ flat.T
    none = np.zeros((count + 1, 2, item.nuisance.shape[1]))
    return products, scanned_products(scans, left, none, weight, base)


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
    steps = STEPS[: fit.x.size]
    points = np.concatenate([fit.x + np.diag(steps), fit.x - np.diag(steps)])
    c, shift = np.empty((points.shape[0], 2, FEATURES)), np.empty(3)
    for point, out in zip(points, c):
        coefficients(point, fit.likelihood.expansion, out, shift)
    return np.asarray((c[: steps.size] - c[steps.size :]) / (2.0 * steps[:, None, None]))


def quantity_slopes(
    x: FloatArray, rate: RateSettings, prior: MismatchPrior | None
) -> tuple[tuple[str, ...], FloatArray]:
    """Names of the quantities that are known, and dq/dx (Q, P)."""
    step = STEPS[: x.size]
    points = np.concatenate([x + np.diag(step), x - np.diag(step)])
    q = cartesian_quantities(points if prior is None else mean_plant(points, prior), rate)
    names = tuple(quantity.name for quantity in IDENTIFIED)
    both = np.stack([q[name] for name in names])
    change = both[:, : x.size] - both[:, x.size :]
    axes = [names.index(name) for name in AXES]
    change[axes] = wrap(change[axes])
    known = np.asarray(np.isfinite(change).all(axis=1))
    return tuple(name for name, is_known in zip(names, known) if is_known), change[known] / (2.0 * step)
