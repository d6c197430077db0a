"""Scores of a fitted device against the library of effects: its spectra, its fit and its quantities put together.

    spectra of Jacobian, signatures, residual  ->  rows in sigmas, and those of the prior  ->  scores and bounds

Shapes: P parameters, W bins, S = 2 senses.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ....arrays import FloatArray
from ....axial import difference
from ....experiment.instrument import Instrument
from ....experiment.noise.spectrum import NoiseSpectrum
from ....quantities import AXES, NAMES
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
from .rows import generalised_rows, real_rows, stationary_rows, stationary_variance
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
    scans: Sequence[BandScan] = ()
    products: FloatArray | float = 0.0
    scanned: ScannedProducts | None = None
    with_mismatch = prior is not None
    louds = [loud_samples(model_v) for model_v in models_v]
    sizes = adc_sizes(louds, noise.sigma_v, instrument.bias_v, with_mismatch)
    first = data[0].band.frequency_hz
    devices, moved = linear_devices(
        fit, [item.band for item in data], instrument, partial(moved_mechanics, with_mismatch)
    )
    sensed, slopes = model_features(fit)
    for item, loud, device in zip(data, louds, devices):
        found = signatures(device, moved, loud, sizes, with_mismatch)
        scans = scans_of(item.band, (float(first[0]), float(first[-1])), line_hz, with_mismatch)
        rows = np.empty((count + len(found) + 1, 2, 2 * item.band.bins.size))
        rows[:count] = device.rows(slopes)
        rows[count:-1] = real_rows(np.stack([one.spectrum for one in found]))
        rows[-1] = real_rows(item.spectrum) - device.rows(sensed)
        variance = stationary_variance(item, noise.sigma_v)
        stationary = stationary_rows(rows, item, variance)
        flat = stationary.reshape(rows.shape[0], -1)
        if item.noise is not None and item.noise.dependent.size:
            flat = generalised_rows(rows, item, item.noise)
        products = products + flat @ flat.T
        kept = np.append(np.arange(count), rows.shape[0] - 1)
        own = scanned_products(scans, stationary[kept], np.sqrt(2.0 / item.band.samples / variance))
        scanned = own if scanned is None else scanned + own
    assert scanned is not None
    of_prior = np.zeros((count + 1, count + 1))
    if prior is not None:
        rows = _prior_rows(prior, fit.x)
        of_prior = rows @ rows.T
    # The signatures have no part in the rows of the prior.
    kept = np.append(np.arange(count), count + len(found))
    whole = np.array(products)
    whole[np.ix_(kept, kept)] += of_prior
    gradients = quantity_slopes(fit.x, rate, prior)
    gradient = np.stack(list(gradients.values()))
    low, high = np.array([one.low for one in found]), np.array([one.high for one in found])
    candidates = Candidates(tuple(one.effect for one in found), low, high)
    frequency = np.concatenate([item.band.frequency_hz for item in data])
    dof = 2.0 / float(np.mean(noise.relative_sd(frequency) ** 2))
    parts = (
        judged(whole, Projection.of(whole[:count, :count], gradient), candidates, dof),
        judged_scans(scans, scanned, gradient, of_prior, dof),
    )
    return summary(parts, list(gradients))


def _prior_rows(prior: MismatchPrior, x: FloatArray) -> FloatArray:
    """What the prior adds to the rows of the Jacobian and of the residual, (14 + 1, 2)."""
    root, offset = prior.rows()
    out = np.zeros((x.size + 1, offset.size))
    out[12:14] = root.T
    out[-1] = offset - root @ x[12:]
    return out


def model_features(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Coefficients (S, J) of the model's spectrum in the features of the fit, and their slopes (P, S, J) per unit of x."""
    x, steps = fit.x, STEPS[: fit.x.size]
    points = np.concatenate([x[None], x + np.diag(steps), x - np.diag(steps)])
    c, shift = np.empty((points.shape[0], 2, FEATURES)), np.empty(3)
    for point, out in zip(points, c):
        coefficients(point, fit.likelihood.expansion, out, shift)
    return c[0], (c[1 : x.size + 1] - c[x.size + 1 :]) / (2.0 * steps[:, None, None])


def quantity_slopes(x: FloatArray, rate: RateSettings, prior: MismatchPrior | None) -> dict[str, FloatArray]:
    """dq/dx (P,) of every quantity that is known."""
    step = STEPS[: x.size]
    points = np.concatenate([x + np.diag(step), x - np.diag(step)])
    q = cartesian_quantities(points if prior is None else mean_plant(points, prior), rate)
    out = {}
    for name in NAMES:
        ahead, behind = q[name][: x.size], q[name][x.size :]
        change = difference(ahead, behind) if name in AXES else ahead - behind
        if np.all(np.isfinite(change)):
            out[name] = change / (2.0 * step)
    return out
