"""Least-squares ARX model of many inputs and outputs, from shifted sums.

    y(t) + A_1 y(t-1) + .. + A_n y(t-n) = B_0 u(t) + B_1 u(t-1) + .. + B_n u(t-n) + e(t)                 (7)

All products of the regressors are the entries of one block-Hankel Gram matrix of w = (y, u),

    G[i, j] = sum_{t=n}^{N-1} w(t-i) w(t-j)^T,   i, j = 0..n,

where every entry follows from its upper left neighbour by what enters and leaves the sum:

    G[i+1, j+1] = G[i, j] + w(n-1-i) w(n-1-j)^T - w(N-1-i) w(N-1-j)^T

The sum starts at t = n, so nothing is assumed about the data before the first sample ("unwindowed").
Band-passed regressors have a condition near 1e17: a ridge relative to each diagonal entry makes the Cholesky
factorisation possible and determines the residues, from which theta follows.  A relative ridge leaves the model
invariant under a change of the units of any channel.

Shapes: N samples, S senses, D drives, C = S + D, n order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg.lapack import dposv

from ..arrays import FloatArray
from .failure import IdentificationError

_CHUNK = 1024


@dataclass(frozen=True, eq=False)
class ArxModel:
    """A(q^-1) y = B(q^-1) u + e.

    A : (n, S, S), A[k-1] belongs to y(t-k); the identity before y(t) is not stored.
    B : (n+1, S, D), B[k] belongs to u(t-k); B[0] is exactly zero where no direct feedthrough was fitted.
    innovation_covariance : (S, S) of e [V^2].
    """

    A: FloatArray
    B: FloatArray
    innovation_covariance: FloatArray

    @property
    def order(self) -> int:
        """n, the same for A and B."""
        return self.A.shape[0]


@njit(cache=True, fastmath=True)
def _lagged_sums(w: FloatArray, order: int, first_row: FloatArray) -> None:
    """first_row[j, a, b] = sum_{t=n}^{N-1} w_a(t) w_b(t-j); w (C, N), in chunks that stay in the cache."""
    channels, samples = w.shape
    last = channels - 1
    sums = np.empty((4, 4))
    for start in range(order, samples, _CHUNK):
        stop = min(start + _CHUNK, samples)
        for a in range(0, channels, 4):
            x0, x1 = w[a, start:stop], w[min(a + 1, last), start:stop]
            x2, x3 = w[min(a + 2, last), start:stop], w[min(a + 3, last), start:stop]
            for b in range(channels):
                for j in range(0, order + 1, 4):
                    k1, k2, k3 = min(j + 1, order), min(j + 2, order), min(j + 3, order)
                    y0, y1 = w[b, start - j : stop - j], w[b, start - k1 : stop - k1]
                    y2, y3 = w[b, start - k2 : stop - k2], w[b, start - k3 : stop - k3]
                    s00, s01, s02, s03, s10, s11, s12, s13 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                    s20, s21, s22, s23, s30, s31, s32, s33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                    # Four channels at four lags are sixteen sums of eight loads.
                    for t in range(x0.size):
                        c0, c1, c2, c3 = y0[t], y1[t], y2[t], y3[t]
                        s00 += x0[t] * c0
                        s01 += x0[t] * c1
                        s02 += x0[t] * c2
                        s03 += x0[t] * c3
                        s10 += x1[t] * c0
                        s11 += x1[t] * c1
                        s12 += x1[t] * c2
                        s13 += x1[t] * c3
                        s20 += x2[t] * c0
                        s21 += x2[t] * c1
                        s22 += x2[t] * c2
                        s23 += x2[t] * c3
                        s30 += x3[t] * c0
                        s31 += x3[t] * c1
                        s32 += x3[t] * c2
                        s33 += x3[t] * c3
                    sums[0, 0], sums[0, 1], sums[0, 2], sums[0, 3] = s00, s01, s02, s03
                    sums[1, 0], sums[1, 1], sums[1, 2], sums[1, 3] = s10, s11, s12, s13
                    sums[2, 0], sums[2, 1], sums[2, 2], sums[2, 3] = s20, s21, s22, s23
                    sums[3, 0], sums[3, 1], sums[3, 2], sums[3, 3] = s30, s31, s32, s33
                    for i in range(min(4, channels - a)):
                        for k in range(min(4, order + 1 - j)):
                            first_row[j + k, a + i, b] += sums[i, k]


@njit(cache=True)
def _shift_down(w: FloatArray, order: int, first_row: FloatArray, gram: FloatArray) -> None:
    """Fill gram ((n+1) C, (n+1) C) from its first block row."""
    channels, samples = w.shape
    for j in range(order + 1):
        for a in range(channels):
            for b in range(channels):
                gram[a, j * channels + b] = first_row[j, a, b]
                gram[j * channels + b, a] = first_row[j, a, b]
    for i in range(order):
        for a in range(channels):
            enters, leaves = w[a, order - 1 - i], w[a, samples - 1 - i]
            row = gram[i * channels + a]
            below = gram[(i + 1) * channels + a]
            for j in range(order):
                for b in range(channels):
                    below[(j + 1) * channels + b] = (
                        row[j * channels + b] + enters * w[b, order - 1 - j] - leaves * w[b, samples - 1 - j]
                    )


def gram_matrix(w: FloatArray, order: int) -> FloatArray:
    """G[i, j] = sum_{t=n}^{N-1} w(t-i) w(t-j)^T as one symmetric matrix ((n+1) C, (n+1) C) [V^2].

    Parameters
    ----------
    w : (C, N) all channels, one per row [V].
    order : n, the largest lag.
    """
    channels = w.shape[0]
    first_row = np.zeros((order + 1, channels, channels))
    gram = np.empty(((order + 1) * channels, (order + 1) * channels))
    _lagged_sums(w, order, first_row)
    _shift_down(w, order, first_row, gram)
    return gram


def solve_gram(
    gram: FloatArray, senses: int, drives: int, samples: int, ridge: float = 1e-12, direct: bool = False
) -> ArxModel:
    """The ARX model whose normal equations are blocks of ``gram``: (G_pp + ridge diag G_pp) Theta = G_py.

    Parameters
    ----------
    gram : ((n+1) C, (n+1) C) from :func:`gram_matrix`, channels in the order (y, u).
    senses, drives : S, D.
    samples : number of equations summed in ``gram``, for the innovation covariance.
    ridge : relative to each diagonal entry.
    direct : fit B_0 too.

    Raises
    ------
    IdentificationError : a channel is silent, or the regressors are linearly dependent despite the ridge.
    """
    channels = senses + drives
    order = gram.shape[0] // channels - 1
    first = senses if direct else channels
    # Symmetric, so its transpose is it in the order of LAPACK.
    penalised = np.array(gram[first:, first:], order="C").T
    diagonal = np.einsum("ii->i", penalised)
    diagonal *= 1.0 + ridge
    _, theta, info = dposv(penalised, gram[first:, :senses], lower=0, overwrite_a=1)
    if info != 0 or not np.all(np.isfinite(theta)):
        raise IdentificationError(
            "the record does not determine an ARX model",
            value=f"order {order}, normal equations singular at row {info}",
            allowed="no constant drive or sense channel, and linearly independent drive sequences",
            next_step="use a record in which all drives act, or a lower order",
        )
    explained = theta.T @ gram[first:, :senses]
    covariance = (gram[:senses, :senses] - (explained + explained.T) / 2.0) / max(samples - theta.shape[0], 1)
    b0 = theta[:drives].T if direct else np.zeros((senses, drives))
    lagged = theta[-order * channels :].reshape(order, channels, senses).transpose(0, 2, 1)
    return ArxModel(
        A=np.ascontiguousarray(-lagged[:, :, :senses]),
        B=np.concatenate([b0[None], lagged[:, :, senses:]]),
        innovation_covariance=covariance,
    )


def fit_arx(y: FloatArray, u: FloatArray, order: int, ridge: float = 1e-12, direct: bool = False) -> ArxModel:
    """A, B = argmin sum_{t=n}^{N-1} |y(t) - sum_k (B_k u(t-k) - A_k y(t-k))|^2 + ridge: the paper, eq. (7).

    Parameters
    ----------
    y : (N, S) sense samples [V].
    u : (N, D) drive samples [V].
    order : n, for A and B; the paper uses 40 and tried 10 to 80.
    ridge : relative to each diagonal entry of the normal equations; 1e-12 to 1e-8 suit band-passed data.
    direct : fit B_0 too.  Not needed for a zero-order hold and a velocity pick-off: a drive sample first acts on
        the next sense sample.

    Raises
    ------
    IdentificationError : the record is too short for the order, is not finite, or does not determine the model.
    """
    samples, senses = y.shape
    drives = u.shape[1]
    unknowns = order * (senses + drives)
    if order < 1 or samples - order <= unknowns:
        raise IdentificationError(
            "the record is too short for the ARX order",
            value=f"{samples} samples, order {order}",
            allowed=f"order >= 1 and more than {unknowns + order} samples at this order",
            next_step="take a longer window or a lower order",
        )
    w = np.empty((senses + drives, samples))
    w[:senses] = y.T
    w[senses:] = u.T
    gram = gram_matrix(w, order)
    # Every sample stands on the diagonal of the matrix, squared; only a large one can be finite and its square not.
    if not np.isfinite(gram.trace()) and not np.all(np.isfinite(w)):
        raise IdentificationError(
            "the record holds values that are not finite",
            value=int(np.size(w) - np.count_nonzero(np.isfinite(w))),
            allowed="finite volts in every sample",
            next_step="remove or repair these samples",
        )
    return solve_gram(gram, senses, drives, samples - order, ridge, direct)
