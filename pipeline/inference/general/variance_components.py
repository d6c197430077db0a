"""Variance components of record variation by restricted maximum likelihood, from products of whitened columns.

    r = J dx + C_k d_k + e,     d_k ~ N(0, D),     D = diag(sd^2)

    -2 log L = sum_k log|I + D G_kk| + log|J' V^-1 J| + r' P r,      V = I + C D C',  P = V^-1 - V^-1 J (J' V^-1 J)^-1 J' V^-1
    d_k = (D^-1 + G_kk)^-1 C_k' (r_k - J_k dx),      G_kk = C_k' C_k

A kind of variation is kept only if it raises 2 log L by more than ``_NEEDED``; else its spread is exactly zero.
Sources: Patterson and Thompson, Biometrika 58 (1971) 545; Henderson, Biometrics 31 (1975) 423.

Shapes: K records, n rows, P parameters, m deviations of a record, 4 kinds of deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import chdtri

from ...arrays import FloatArray
from ...experiment.variation import KINDS, RecordSpread
from .gauss_newton import CLOSE

#: Increase of 2 log L that makes a kind of variation needed.  For equal records it is half a chi2 of one degree of freedom, so
#: that one of four kinds is kept by mistake in 0.1 % of campaigns:  4 P(chi2_1 > 12.1) / 2 = 1e-3.
_NEEDED = float(chdtri(1.0, 2.0 * 1e-3 / len(KINDS)))
#: Spreads from which the search starts, in decades below the largest.
_DECADES = (-5.0, -3.5, -2.0, -0.5)


@dataclass(frozen=True, eq=False)
class Grams:
    """Products of whitened columns: J'J (P, P), J'r (P,); C'J (K, m, P), C'C (K, m, m), C'r (K, m); r'r."""

    jj: FloatArray
    jr: FloatArray
    cj: FloatArray
    cc: FloatArray
    cr: FloatArray
    rr: float

    def without_parameters(self) -> Grams:
        """The products of the deviations alone, for parameters that stay where they are."""
        return replace(self, jj=self.jj[:0, :0], jr=self.jr[:0], cj=self.cj[:, :, :0])


def grams_of(columns: Sequence[FloatArray], jacobians: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> Grams:
    return Grams(
        sum((j.T @ j for j in jacobians), np.zeros((jacobians[0].shape[1],) * 2)),
        sum((j.T @ r for j, r in zip(jacobians, residuals)), np.zeros(jacobians[0].shape[1])),
        np.stack([c.T @ j for c, j in zip(columns, jacobians)]),
        np.stack([c.T @ c for c in columns]),
        np.stack([c.T @ r for c, r in zip(columns, residuals)]),
        sum(float(r @ r) for r in residuals),
    )


def with_residuals(
    g: Grams, columns: Sequence[FloatArray], jacobians: Sequence[FloatArray], residuals: Sequence[FloatArray]
) -> Grams:
    """The products of the same columns with other residuals (n,) of each record."""
    return replace(
        g,
        jr=sum((j.T @ r for j, r in zip(jacobians, residuals)), np.zeros_like(g.jr)),
        cr=np.stack([c.T @ r for c, r in zip(columns, residuals)]),
        rr=sum(float(r @ r) for r in residuals),
    )


@dataclass(frozen=True, eq=False)
class Solved:
    """-2 log L at given spreads; the step dx (P,), the deviations (K, m) and their covariances (K, m, m) at known x."""

    value: float
    dx: FloatArray
    deviations: FloatArray
    covariances: FloatArray


def solved(g: Grams, sd: FloatArray) -> Solved:
    """The linear problem with sds (m,) of the deviations."""
    records, m, parameters = g.cj.shape
    inner = np.eye(m) + sd[:, None] * g.cc * sd
    inverse = sd[:, None] * np.linalg.inv(inner) * sd
    pull = (inverse @ g.cr[..., None])[..., 0]
    flat = g.cj.reshape(records * m, parameters)
    left = g.jj - flat.T @ (inverse @ g.cj).reshape(records * m, parameters)
    right = g.jr - flat.T @ pull.reshape(-1)
    scale = np.sqrt(np.maximum(np.diagonal(left), 1e-300))
    size, vectors = np.linalg.eigh(left / np.outer(scale, scale))
    kept = size > 1e-12 * np.max(size, initial=0.0)
    along = vectors.T @ (right / scale)
    dx = vectors[:, kept] @ (along[kept] / size[kept]) / scale
    quadratic = g.rr - float(np.vdot(g.cr, pull)) - float(right @ dx)
    value = float(np.sum(np.linalg.slogdet(inner)[1]) + np.sum(np.log(size[kept])) + 2.0 * np.sum(np.log(scale)))
    deviations = pull - (inverse @ (g.cj @ dx)[..., None])[..., 0]
    return Solved(value + quadratic, dx, deviations, inverse)


def _best_sd(g: Grams, kinds: tuple[int, ...], active: Sequence[int], largest: FloatArray) -> tuple[float, FloatArray]:
    """The smallest -2 log L and its sds (4,) over the ``active`` kinds, each at most ``largest`` (4,): grid, then descent."""
    of = np.array(kinds)

    def value(at: FloatArray) -> float:
        return solved(g, (largest * 10.0**at)[of]).value

    trials = []
    for point in product(_DECADES, repeat=len(active)):
        at = np.full(len(KINDS), -np.inf)
        at[list(active)] = point
        trials.append((value(at), tuple(at)))
    best, found = min(trials)
    at, step = np.array(found), (_DECADES[1] - _DECADES[0]) / 2.0
    while step > CLOSE:
        nearby = []
        for kind, sign in product(active, (1.0, -1.0)):
            trial = at.copy()
            trial[kind] = min(trial[kind] + sign * step, 0.0)
            nearby.append((value(trial), tuple(trial)))
        new, moved = min(nearby)
        if new < best - CLOSE:
            best, at = new, np.array(moved)
        else:
            step /= 2.0
    return best, largest * 10.0**at


def spread_of(g: Grams, kinds: tuple[int, ...], largest: FloatArray, most: int = len(KINDS)) -> RecordSpread:
    """The spreads that the records need, of at most ``most`` kinds; kinds are added in the order of their gain in likelihood."""
    chosen: tuple[int, ...] = ()
    best, sd = solved(g, np.zeros(len(kinds))).value, np.zeros(len(KINDS))
    while len(chosen) < most:
        trials = [(*_best_sd(g, kinds, (*chosen, k), largest), k) for k in range(len(KINDS)) if k not in chosen]
        value, found, kind = min(trials, key=lambda trial: trial[0])
        if best - value < _NEEDED:
            break
        best, sd, chosen = value, found, (*chosen, kind)
    return RecordSpread(*(float(sd[k]) if k in chosen else 0.0 for k in range(len(KINDS))))
