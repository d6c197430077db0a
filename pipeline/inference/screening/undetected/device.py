"""Scores of a fitted device against the library of effects: its spectra, its fit and its quantities put together.

    whitened rows of channel a and bin w:  sqrt(2/N) / s_a(w),    s_a(w)^2 the variance of the noise that ``whitening`` gives

Shapes: P parameters, W bins, S = 2 senses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....axial import difference
from ....experiment.instrument import Instrument
from ....experiment.noise.spectrum import NoiseSpectrum
from ....quantities import AXES, NAMES
from ...estimate import RateSettings, cartesian_quantities
from ...gate import Undetected
from ..compressed import BandData
from ..fit import Fit
from ..likelihood import STEPS
from ..mismatch import MismatchPrior, mean_plant
from .bounds import Candidates, undetected
from .linear import LinearDevice, cartesian_poles, linear_device
from .signatures import BandSignature, signatures


def scored_device(
    fit: Fit,
    data: Sequence[BandData],
    models_v: Sequence[FloatArray],
    noise: NoiseSpectrum,
    instrument: Instrument,
    rate: RateSettings,
    prior: MismatchPrior | None,
) -> Undetected:
    """Scores and bounds of a fitted device.

    Parameters
    ----------
    fit : at the maximum.
    data, models_v : its records in their band, and their models (N, S) [V].
    noise : spectrum of the silence.
    instrument, rate, prior : as for ``identify_device``.

    Raises
    ------
    numpy.linalg.LinAlgError, ConfigError : the linear device or its Jacobian is singular.
    """
    sigma_v = noise.sigma_v
    jacobians, residuals, found, rows = [], [], [], []
    for i, (item, model_v) in enumerate(zip(data, models_v)):
        device = linear_device(fit, i, item.band, instrument)
        own = signatures(device, model_v, sigma_v, prior is not None)
        jacobians.append(_whitened(_jacobian(fit.x, device), item, sigma_v).T)
        residuals.append(_whitened((item.spectrum - device.sensed())[None], item, sigma_v)[0])
        found.append(own)
        rows.append(_whitened(np.stack([one.spectrum for one in own]), item, sigma_v))
    root, offset = (np.zeros((0, 2)), np.zeros(0)) if prior is None else prior.rows()
    below = np.zeros((offset.size, fit.x.size))
    if offset.size:
        below[:, 12:] = root
    jacobian = np.concatenate([*jacobians, below])
    residual = np.concatenate([*residuals, offset - below @ fit.x])
    frequency = np.concatenate([item.band.frequency_hz for item in data])
    dof = 2.0 / float(np.mean(noise.relative_sd(frequency) ** 2))
    return undetected(jacobian, residual, _candidates(found, rows, offset.size), _slopes(fit.x, rate, prior), dof)


def _candidates(found: Sequence[Sequence[BandSignature]], rows: Sequence[FloatArray], prior_rows: int) -> Candidates:
    """The signatures of all records, whose ``rows`` (K, n_r) follow each other, with zeros in those of the prior."""
    first = found[0]
    below = np.zeros((len(first), prior_rows))
    together = np.concatenate([*rows, below], axis=1).T
    low, high = np.array([one.low for one in first]), np.array([one.high for one in first])
    return Candidates(tuple(one.effect for one in first), together, low, high)


def _whitened(spectra: ComplexArray, item: BandData, sigma_v: FloatArray) -> FloatArray:
    """Spectra (K, S, W) [V] of a record as rows (K, 2 S W) in sigmas, hum lines projected out."""
    rows = np.concatenate([spectra.real, spectra.imag], axis=-1)
    n = item.nuisance
    if n.shape[1]:
        rows -= (rows @ n) @ n.T
    variance = np.repeat(sigma_v[:, None] ** 2, item.band.bins.size, axis=1)
    if item.noise is not None:
        variance = item.noise.variance + item.noise.dependent_mean[:, None]
    rows *= np.tile(math.sqrt(2.0 / item.band.samples) / np.sqrt(variance), 2)
    return np.asarray(rows.reshape(rows.shape[0], -1))


def _jacobian(x: FloatArray, device: LinearDevice) -> ComplexArray:
    """d(spectrum)/dx (P, S, W) [V per unit of x]."""
    _, residues = cartesian_poles(x)
    d_poles, d_residues = [], []
    for i in range(x.size):
        sides = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[i] += sign * STEPS[i]
            sides.append(cartesian_poles(moved))
        d_poles.append((sides[0][0] - sides[1][0]) / (2.0 * STEPS[i]))
        d_residues.append((sides[0][1] - sides[1][1]) / (2.0 * STEPS[i]))
    slopes = residues * np.array(d_poles)[:, :, None, None]
    return device.read(np.array(d_residues), slopes)


def _slopes(x: FloatArray, rate: RateSettings, prior: MismatchPrior | None) -> dict[str, FloatArray]:
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
