"""Shapes of a disturbance whose amplitudes are free in every record and channel, scored against residuals.

    delta_chi2         = sum over records, channels and columns of (q^T r)^2,               dof = number of terms
    delta_chi2 / level = sum over records, channels and columns of (q^T r)^2 / gamma

q are the orthonormalised columns of the disturbance, r the residual.  gamma >= 1 is the level of the residual around the
frequency of a column: where all neighbouring bins are too high, a broadband misfit is the cause and not a line.

Shapes: N samples, S senses, L columns; residuals in sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray, IntArray
from ...device.effect import Context, Effect
from ...device.parameters import Shape

#: Bins on either side over which a window or a sweep spreads a line.
SPREAD_BINS = 3
#: Bins on either side that give the level around a line.
AROUND = 50


@dataclass(frozen=True)
class DisturbanceShape:
    """One shape of a disturbance.

    Parameters
    ----------
    point : values of its parameters by name.
    delta_chi2, dof : by how much chi2 falls with free amplitudes, and how many there are.
    level : mean of gamma over the columns, weighted by their share of delta_chi2 / gamma.
    """

    point: Mapping[str, float]
    delta_chi2: float
    dof: int
    level: float

    @property
    def score(self) -> float:
        """delta_chi2 / level less three times its expectation in noise; the largest marks the best shape."""
        return self.delta_chi2 / max(self.level, 1e-300) - 3.0 * self.dof  # above Nyquist there is neither


@lru_cache(maxsize=32)
def _columns(
    effect: Effect, point: tuple[float, ...], samples: int, sample_rate_hz: float
) -> tuple[FloatArray, IntArray]:
    """Orthonormal columns q (N, L) without offset, and the strongest bin of each (L,)."""
    assert effect.disturbance is not None
    t = np.arange(samples) / sample_rate_hz
    columns = effect.disturbance(t, np.array(point), Context(0.0, 0.0, {}))
    columns = columns - columns.mean(axis=0)
    columns = np.asarray(np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))[0])
    bins = np.array([int(np.argmax(np.abs(rfft(column)))) for column in columns.T], dtype=np.int64)
    for cached in (columns, bins):
        cached.setflags(write=False)
    return columns, bins


def free_shapes(
    effect: Effect, shape: Shape, residuals: Sequence[FloatArray], sample_rates_hz: Sequence[float]
) -> tuple[DisturbanceShape, ...]:
    """Every shape on the parameter grid of a disturbance, scored against the residuals of the fit records.

    Parameters
    ----------
    effect : with a disturbance.
    shape : numbers of drives and senses of the plant.
    residuals : (N, S) in sigmas, of each fit record.
    sample_rates_hz : of each fit record [Hz].
    """
    members = effect.members(shape)
    spectra = [np.abs(rfft(r, axis=0)) ** 2 * (2.0 / r.shape[0]) for r in residuals]
    # A bin has chi2 with two degrees of freedom; running sums give the mean over any neighbourhood.
    sums = [np.concatenate([np.zeros((1, s.shape[1])), np.cumsum(s, axis=0)]) for s in spectra]
    found = []
    for at in product(*(member.grid or (member.null,) for member in members)):
        delta_chi2, dof, relative = 0.0, 0, 0.0
        for r, power, total, rate in zip(residuals, spectra, sums, sample_rates_hz):
            columns, bins = _columns(effect, at, r.shape[0], rate)
            low, high = np.maximum(bins - AROUND, 1), np.minimum(bins + AROUND + 1, power.shape[0])
            first, last = np.maximum(bins - SPREAD_BINS, low), np.minimum(bins + SPREAD_BINS + 1, high)
            around = total[high] - total[low] - (total[last] - total[first])
            count = 2.0 * ((high - low) - (last - first))
            level = np.maximum(around / count[:, None], 1.0)
            own = (columns.T @ r) ** 2
            delta_chi2 += float(np.sum(own))
            relative += float(np.sum(own / level))
            dof += columns.shape[1] * r.shape[1]
        point = {m.name: float(v) for m, v in zip(members, at)}
        found.append(DisturbanceShape(point, delta_chi2, dof, delta_chi2 / max(relative, 1e-300)))
    return tuple(found)


def best_shape(
    effect: Effect, shape: Shape, residuals: Sequence[FloatArray], sample_rates_hz: Sequence[float]
) -> dict[str, float]:
    """The shape of largest score, as full parameter name -> value; arguments as of :func:`free_shapes`."""
    best = max(free_shapes(effect, shape, residuals, sample_rates_hz), key=lambda one: one.score)
    return {effect.full_name(m): best.point[m.name] for m in effect.members(shape)}
