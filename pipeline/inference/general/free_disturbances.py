"""Disturbances whose amplitudes are free in every record and channel: which of their shapes the residuals hold.

    fall / level = sum over records, channels and columns of (q^T r)^2 / gamma,        dof = as many terms

q are the columns of the disturbance, made orthonormal; gamma, at least 1, is the level of the residual around the frequency
of each: where the whole neighbourhood is too loud, the neighbourhood is what is wrong, not the line.
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

#: Bins on either side that tell the level around a line, and those nearest to it that are its own.
_AROUND = 20
_OWN = 2
#: Smallest eigenvalue of unit columns' inner products at which they are far from dependent.
_INDEPENDENT = 1e-3


@dataclass(frozen=True)
class Free:
    """One shape of a disturbance: values of its parameters, the fall of chi2, at what cost, gamma as a mean over the columns."""

    point: Mapping[str, float]
    fall: float
    dof: int
    level: float

    @property
    def worth(self) -> float:
        """The fall beyond what noise would give, and as much again: the larger, the better explained."""
        return self.fall / self.level - 3.0 * self.dof


@lru_cache(maxsize=32)
def _columns(
    effect: Effect, point: tuple[float, ...], samples: int, sample_rate_hz: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Columns c (N, L) without offset, T (L, L) so that c T is orthonormal, and the bin where each is strongest."""
    assert effect.disturbance is not None
    t = np.arange(samples) / sample_rate_hz
    columns = effect.disturbance(t, np.array(point), Context(0.0, 0.0, {}))
    columns = columns - columns.mean(axis=0)
    gram = columns.T @ columns
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    unit = gram / np.outer(scale, scale)
    if np.linalg.eigvalsh(unit)[0] < _INDEPENDENT:
        columns, turn = np.asarray(np.linalg.qr(columns / scale)[0]), np.eye(scale.size)
    else:
        # Cholesky is faster and, far from dependence, as good.
        turn = np.linalg.inv(np.linalg.cholesky(unit)).T / scale[:, None]
    bins = np.array([int(np.argmax(np.abs(rfft(column)))) for column in columns.T], dtype=np.int64)
    for kept in (columns, turn, bins):
        kept.setflags(write=False)
    return columns, turn, bins


def free_shapes(
    effect: Effect, shape: Shape, residuals: Sequence[FloatArray], sample_rates_hz: Sequence[float]
) -> tuple[Free, ...]:
    """Every shape on the grid of a disturbance against residuals (N, S) of the fitted records."""
    members = effect.members(shape)
    spectra = [np.abs(rfft(r, axis=0)) ** 2 * (2.0 / r.shape[0]) for r in residuals]
    # chi2 of two degrees of freedom a bin, so the running sum over bins tells the level.
    sums = [np.concatenate([np.zeros((1, s.shape[1])), np.cumsum(s, axis=0)]) for s in spectra]
    found = []
    for at in product(*(member.grid or (member.null,) for member in members)):
        fall, dof, quiet = 0.0, 0, 0.0
        for r, power, total, rate in zip(residuals, spectra, sums, sample_rates_hz):
            columns, turn, bins = _columns(effect, at, r.shape[0], rate)
            low, high = np.maximum(bins - _AROUND, 1), np.minimum(bins + _AROUND + 1, power.shape[0])
            first, last = np.maximum(bins - _OWN, low), np.minimum(bins + _OWN + 1, high)
            around = total[high] - total[low] - (total[last] - total[first])
            count = 2.0 * ((high - low) - (last - first))
            level = np.maximum(around / count[:, None], 1.0)
            own = (turn.T @ (columns.T @ r)) ** 2
            fall += float(np.sum(own))
            quiet += float(np.sum(own / level))
            dof += turn.shape[1] * r.shape[1]
        found.append(Free({m.name: float(v) for m, v in zip(members, at)}, fall, dof, fall / max(quiet, 1e-300)))
    return tuple(found)
