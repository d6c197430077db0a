"""Noise of driven records from a smooth local fit over neighbouring frequencies (local polynomial method).

In a window of W bins the response to each drive and the transient are polynomials of second order of the frequency:

    Y(k) = sum_d (a_d0 + a_d1 x + a_d2 x^2) U_d(k) + b_0 + b_1 x + b_2 x^2 + N(k),     x in [-1, 1] over the window

The residual power per free complex coefficient, v, is sigma^2 times a gamma variable of mean 1 and shape W - 3 (D + 1).  Lines,
harmonics of a nonlinear device, and a resonance that is narrower than a window only add power, so v is noise in the quiet
windows and more in the others.  The noise of a channel therefore follows from low quantiles of v:

    s(p) = quantile p of v / quantile p of the gamma variable            the same for all p if all windows are quiet
    sd of ln s(p)  = sqrt(p (1 - p) / n) / (q_p g(q_p)),    g, q_p: density and quantile of the gamma variable

Windows that lie above the 0.1 % tail of the gamma variable are left out.  The median of the rest is used where it agrees with
the lowest tenth, and the records that show the lowest level: others hold disturbances at all frequencies, such as clipping.
Where no record has mostly quiet windows, the local fit only bounds the noise.
Source: Pintelon, Schoukens, Vandersypen, Barbe, Mech. Syst. Signal Process. 24 (2010) 573.

Shapes: N samples, S senses, D drives, K windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft
from scipy.special import gammainccinv, gammaincinv, gammaln

from ...arrays import FloatArray
from ..record import Record

#: Unknowns of each polynomial, and bins of a window per unknown: a quarter of the information is spent on the response.
_ORDER, _BINS_PER_UNKNOWN = 3, 4
#: Quantile from which the level is taken, and the lower one that it must agree with, as most windows are quiet only then.
_LEVEL, _LOWER = 0.5, 0.1
#: Tail probability of a quiet window above which a window counts as disturbed, and passes until those are found.
_TAIL, _PASSES = 1e-3, 3
#: Largest difference of the logarithms of both, and of two records [sd].
_AGREE = 3.0


@dataclass(frozen=True, eq=False)
class LocalNoise:
    """Noise variance (S,) [V^2] per sample, its degrees of freedom, and whether it is measured or only bounded from above."""

    variance: FloatArray
    dof: int
    measured: bool


def has_windows(record: Record) -> bool:
    """Whether a record is long enough for a local fit."""
    return record.drive_v.shape[0] > 50 * (record.drive_v.shape[1] + 1)


def _window_variances(record: Record) -> tuple[FloatArray, int]:
    """v (K, S) [V^2] of the windows from zero to Nyquist, and their free complex coefficients W - 3 (D + 1)."""
    samples, drives = record.drive_v.shape
    y, u = rfft(record.sense_v - record.sense_v.mean(axis=0), axis=0), rfft(record.drive_v, axis=0)
    unknowns = _ORDER * (drives + 1)
    width = _BINS_PER_UNKNOWN * unknowns
    x = np.linspace(-1.0, 1.0, width)[:, None] ** np.arange(_ORDER)
    out = []
    for first in range(1, y.shape[0] - width, width):
        rows = slice(first, first + width)
        columns = np.concatenate([x, *(x * u[rows, d : d + 1] for d in range(drives))], axis=1)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        basis, size, _ = np.linalg.svd(columns, full_matrices=False)
        basis = basis[:, size > 1e-9 * size[0]]
        residual = y[rows] - basis @ (basis.conj().T @ y[rows])
        out.append(np.sum(np.abs(residual) ** 2, axis=0) / (width - basis.shape[1]) / samples)
    return np.array(out), width - unknowns


def log_covariance(windows: int, shape: int) -> FloatArray:
    """Covariance (2, 2) of ln s at the quantiles ``_LOWER`` and ``_LEVEL`` of ``windows`` quiet ones."""
    p = np.array([_LOWER, _LEVEL])
    # x f(x) of a gamma variable of mean 1 at its quantiles x = y / shape.
    y = gammaincinv(shape, p)
    slope = np.exp(shape * np.log(y) - y - gammaln(shape))
    both = np.minimum.outer(p, p) - np.outer(p, p)
    return np.asarray(both / windows / np.outer(slope, slope))


def quiet_level(v: FloatArray, shape: int) -> tuple[float, bool]:
    """The level [V^2] of the windows v (K,) of one channel, and whether most of them are quiet."""
    quantiles, most = gammaincinv(shape, [_LOWER, _LEVEL]) / shape, gammainccinv(shape, _TAIL) / shape
    kept = v
    for _ in range(_PASSES):
        low, level = np.quantile(kept, [_LOWER, _LEVEL]) / quantiles
        kept = v[v < level * most]
    covariance = log_covariance(kept.size, shape)
    sd = np.sqrt(covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1])
    return float(level), bool(2 * kept.size > v.size and np.log(level / max(low, 1e-300)) < _AGREE * sd)


def local_noise(records: Sequence[Record]) -> LocalNoise:
    """The noise of driven ``records`` for which ``has_windows`` holds."""
    found = [_window_variances(record) for record in records]
    levels, bounds, sds = [], [], []
    for v, shape in found:
        each = [quiet_level(own, shape) for own in v.T]
        levels.append([level if quiet else np.inf for level, quiet in each])
        bounds.append(np.median(v, axis=0) / (gammaincinv(shape, 0.5) / shape))
        sds.append(np.sqrt(log_covariance(v.shape[0], shape)[1, 1]))
    level, sd = np.array(levels), np.array(sds)[:, None]
    dof = 2.0 / sd**2
    if not np.all(np.isfinite(level.min(axis=0))):
        return LocalNoise(np.asarray(np.sum(dof * bounds, axis=0) / np.sum(dof)), int(np.sum(dof)), False)
    lowest = np.argmin(level, axis=0)
    distance = np.log(level / level.min(axis=0))
    used = distance <= _AGREE * np.sqrt(sd**2 + sd[lowest, 0] ** 2)
    total = np.sum(np.where(used, dof, 0.0), axis=0)
    variance = np.sum(np.where(used, dof * np.where(used, level, 0.0), 0.0), axis=0) / total
    return LocalNoise(variance, int(total.min()), True)
