"""Adaptive multichannel least-squares lattice filter, unwindowed: the exact ARX fit, sample by sample, at all orders.

Every order p = 1..n solves, on all samples seen so far (0..N-1),

    min sum_{t=p}^{N-1} |y(t) + sum_k (A_k y(t-k) - B_k u(t-k))|^2 + sum_c mu_c |coefficients of channel c|^2      (*)

With x = (delta, y, u), C channels, forward errors f_p (x(t) less its prediction from x(t-1), .., x(t-p)) and backward
errors b_p (x(t-p) less its prediction from x(t), .., x(t-p+1)), both times the root of the conversion factor,

    f_0(t) = b_0(t) = x(t)
    f_p(t) = f_{p-1}(t)   - K_f,p^T b_{p-1}(t-1),       K_f,p = R_b,p^-1 P_f,p
    b_p(t) = b_{p-1}(t-1) - K_b,p^T f_{p-1}(t),         K_b,p = R_f,p^-1 P_b,p

where [R_b | P_f] is the triangular factor of all rows [b_{p-1}(t-1) | f_{p-1}(t)] and [R_f | P_b] that of
[f_{p-1}(t) | b_{p-1}(t-1)].  A new row enters both by C Givens rotations, channel by channel, and the rotated remainder
is the row of the next stage.  Rotations never square the data, so order 80 is as stable as order 10.

Two prefixes make a prewindowed lattice (zero initial state) solve (*) exactly, at every order:

- **unwindowed**: channel delta is 1 one sample before the data and 0 otherwise.  Its lags 1..p are unit vectors of the
  equations t = 0..p-1, whose history is unknown; they remove exactly these equations from the fit.
- **ridge**: before that, channel c receives one pulse sqrt(mu_c), pulses n+1 samples apart.  Lag k of channel c then has
  one further equation, sqrt(mu_c) x coefficient = 0, in which every other entry is zero.

Long because the filter and the conversion of its state to ARX coefficients are derived together.
Sources: Jiang & Gibson 1995 (unwindowed, orthogonal channels); Haykin, Adaptive Filter Theory (QRD lattice).
Shapes: S senses, D drives, C = 1 + S + D, n order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..arrays import FloatArray
from .arx import ArxModel
from .failure import IdentificationError


@dataclass(frozen=True, eq=False)
class Lattice:
    """State of the filter after ``samples`` samples; :func:`advance` returns the next one.

    forward, backward : (n, C, 2C) [R_b | P_f] and [R_f | P_b] of each stage.
    delayed : (n, C) b_{p}(t-1), p = 0..n-1.
    energy : (n+1, S, S) sum of f_p f_p^T of the senses, the least-squares residual energy of each order [V^2].
    history : (n, 2, n, C, 2C) forward and backward of the last n samples, newest last; the coefficients of a stage
        depend on the earlier stages one sample before.
    """

    senses: int
    drives: int
    samples: int
    forward: FloatArray
    backward: FloatArray
    delayed: FloatArray
    energy: FloatArray
    history: FloatArray

    @property
    def order(self) -> int:
        """n."""
        return self.forward.shape[0]


@njit(cache=True, fastmath={"contract", "nsz"})
def _rotate_in(forward: FloatArray, ahead: FloatArray, backward: FloatArray, behind: FloatArray) -> None:
    """Annihilate the left halves of two rows (2C) against the triangles on the left of two tables (C, 2C).

    The two rotations are independent; interleaving them hides the latency of the square roots.
    """
    channels, width = forward.shape
    for k in range(channels):
        x, a = ahead[k], forward[k, k]
        y, b = behind[k], backward[k, k]
        # A channel that held only zeros so far is not rotated.
        xa, yb = x * x + a * a, y * y + b * b
        r = 1.0 / np.sqrt(xa) if xa > 0.0 else 0.0
        q = 1.0 / np.sqrt(yb) if yb > 0.0 else 0.0
        c = a * r if xa > 0.0 else 1.0
        d = b * q if yb > 0.0 else 1.0
        s, t = x * r, y * q
        for m in range(k, width):
            upper, lower = forward[k, m], ahead[m]
            forward[k, m] = c * upper + s * lower
            ahead[m] = c * lower - s * upper
            upper, lower = backward[k, m], behind[m]
            backward[k, m] = d * upper + t * lower
            behind[m] = d * lower - t * upper


@njit(cache=True)
def _filter(
    x: FloatArray,
    senses: int,
    forward: FloatArray,
    backward: FloatArray,
    delayed: FloatArray,
    energy: FloatArray,
    history: FloatArray,
) -> None:
    """Run x (N, C) through the lattice, in place; ``history`` is a ring buffer that ends at the last sample."""
    samples, channels = x.shape
    order = forward.shape[0]
    ahead = np.empty(2 * channels)
    behind = np.empty(2 * channels)
    f = np.empty(channels)
    b = np.empty(channels)
    for t in range(samples):
        for c in range(channels):
            f[c] = x[t, c]
            b[c] = x[t, c]
        for p in range(order):
            for i in range(senses):
                for j in range(senses):
                    energy[p, i, j] += f[1 + i] * f[1 + j]
            for c in range(channels):
                ahead[c] = delayed[p, c]
                ahead[channels + c] = f[c]
                behind[c] = f[c]
                behind[channels + c] = delayed[p, c]
                delayed[p, c] = b[c]
            _rotate_in(forward[p], ahead, backward[p], behind)
            for c in range(channels):
                f[c] = ahead[channels + c]
                b[c] = behind[channels + c]
        for i in range(senses):
            for j in range(senses):
                energy[order, i, j] += f[1 + i] * f[1 + j]
        slot = t - (samples - order)
        if slot >= 0:
            history[slot, 0] = forward
            history[slot, 1] = backward


def _run(lattice: Lattice, x: FloatArray, counted: int) -> Lattice:
    order = lattice.order
    forward, backward = lattice.forward.copy(), lattice.backward.copy()
    delayed, energy = lattice.delayed.copy(), lattice.energy.copy()
    kept = lattice.history[min(x.shape[0], order) :]
    history = np.concatenate([kept, np.empty((order - kept.shape[0], *kept.shape[1:]))])
    _filter(np.ascontiguousarray(x), lattice.senses, forward, backward, delayed, energy, history)
    samples = lattice.samples + counted
    return Lattice(lattice.senses, lattice.drives, samples, forward, backward, delayed, energy, history)


def start_lattice(senses: int, drives: int, order: int, ridge_v2: FloatArray) -> Lattice:
    """The filter before the first sample.

    Parameters
    ----------
    senses, drives : S, D.
    order : n, the highest order.
    ridge_v2 : mu (S + D,) of each channel [V^2].  1e-16 of the expected channel energy N rms^2 changes
        nothing that the data determine; 1e-12 gives the model of ``fit_arx``.

    Raises
    ------
    IdentificationError : a ridge is not positive, or the order is not.
    """
    if order < 1 or ridge_v2.shape != (senses + drives,) or not np.all(ridge_v2 > 0.0):
        raise IdentificationError(
            "the lattice needs an order and a ridge for each channel",
            value=(order, ridge_v2.tolist()),
            allowed=f"order >= 1 and {senses + drives} values above zero",
            next_step="give the expected energy of each channel times a small number",
        )
    channels = 1 + senses + drives
    table = np.zeros((order, channels, 2 * channels))
    empty = Lattice(
        senses,
        drives,
        0,
        table,
        table,
        np.zeros((order, channels)),
        np.zeros((order + 1, senses, senses)),
        np.zeros((order, 2, *table.shape)),
    )
    prefix = np.zeros(((order + 1) * (channels - 1) + 1, channels))
    for c in range(1, channels):
        prefix[(order + 1) * (c - 1), c] = np.sqrt(ridge_v2[c - 1])
    prefix[-1, 0] = 1.0
    started = _run(empty, prefix, 0)
    return Lattice(
        senses,
        drives,
        0,
        started.forward,
        started.backward,
        started.delayed,
        np.zeros_like(started.energy),
        started.history,
    )


def advance(lattice: Lattice, y: FloatArray, u: FloatArray) -> Lattice:
    """The filter after the samples y (N, S), u (N, D) [V], any N >= 1.

    Raises
    ------
    IdentificationError : the shapes do not fit, or a value is not finite.
    """
    x = np.concatenate([np.zeros((y.shape[0], 1)), y, u], axis=1)
    if x.shape[1] != 1 + lattice.senses + lattice.drives or y.shape[1] != lattice.senses:
        raise IdentificationError(
            "the samples do not have the channels of the lattice",
            value=(y.shape, u.shape),
            allowed=f"{lattice.senses} senses and {lattice.drives} drives",
            next_step="start a new lattice for another device",
        )
    if not np.all(np.isfinite(x)):
        raise IdentificationError(
            "the samples hold values that are not finite",
            value=int(x.size - np.count_nonzero(np.isfinite(x))),
            allowed="finite volts",
            next_step="remove or repair these samples",
        )
    return _run(lattice, x, y.shape[0])


@njit(cache=True)
def _gain(table: FloatArray, gain: FloatArray) -> None:
    """gain = R^-1 P of a table [R | P] (C, 2C); zero for a channel that held only zeros so far."""
    channels = table.shape[0]
    for m in range(channels):
        for k in range(channels - 1, -1, -1):
            total = table[k, channels + m]
            for i in range(k + 1, channels):
                total -= table[k, i] * gain[i, m]
            gain[k, m] = total / table[k, k] if table[k, k] != 0.0 else 0.0


@njit(cache=True)
def _predictor(history: FloatArray, order: int) -> FloatArray:
    """F (p+1, C, C) of f_p(t) = sum_k F[k] x(t-k) after the newest sample N, p = ``order``.

    F_p(N) = F_{p-1}(N) - K_f,p(N)^T B_{p-1}(N-1),   B_p(N) = B_{p-1}(N-1) - K_b,p(N)^T F_{p-1}(N),  B one lag later.
    """
    newest = history.shape[0] - 1
    channels = history.shape[3]
    # f[j], b[j]: as they were j samples before the newest.
    f = np.zeros((order + 1, order + 1, channels, channels))
    b = np.zeros((order + 1, order + 1, channels, channels))
    for j in range(order + 1):
        f[j, 0] = np.eye(channels)
        b[j, 0] = np.eye(channels)
    k_f = np.zeros((channels, channels))
    k_b = np.zeros((channels, channels))
    for p in range(1, order + 1):
        for j in range(order - p + 1):
            _gain(history[newest - j, 0, p - 1], k_f)
            _gain(history[newest - j, 1, p - 1], k_b)
            for lag in range(p, 0, -1):
                before, delayed = f[j, lag].copy(), b[j + 1, lag - 1]
                f[j, lag] = before - k_f.T @ delayed
                b[j, lag] = delayed - k_b.T @ before
            b[j, 0] = -k_b.T @ f[j, 0]
    return f[0]


def arx_of(lattice: Lattice, order: int | None = None) -> ArxModel:
    """The ARX model of all samples so far, for any order up to the lattice's.

    Equals the batch solution of (*) at the head of this module; one run gives all orders.

    Parameters
    ----------
    lattice : after at least ``order`` + 1 samples.
    order : 1..n; ``None`` is n.

    Raises
    ------
    IdentificationError : the order exceeds the lattice's, or there are too few samples for it.
    """
    wanted = lattice.order if order is None else order
    unknowns = wanted * (lattice.senses + lattice.drives)
    if not 1 <= wanted <= lattice.order or lattice.samples - wanted <= unknowns:
        raise IdentificationError(
            "the lattice has no model of this order",
            value=f"order {wanted} after {lattice.samples} samples",
            allowed=f"1 to {lattice.order}, after more than {unknowns + wanted} samples",
            next_step="feed more samples, or ask for a lower order",
        )
    s = lattice.senses
    coefficients = _predictor(lattice.history, wanted)[1:, 1 : 1 + s, 1:]
    b = np.concatenate([np.zeros((1, s, lattice.drives)), -coefficients[:, :, s:]])
    covariance = lattice.energy[wanted] / (lattice.samples - wanted - unknowns)
    return ArxModel(np.ascontiguousarray(coefficients[:, :, :s]), b, covariance)


def fit_arx_lattice(y: FloatArray, u: FloatArray, order: int, ridge: float = 1e-16) -> ArxModel:
    """The ARX model of a whole record by the lattice; the counterpart of ``fit_arx``, without squaring the data.

    Parameters
    ----------
    y, u : (N, S), (N, D) [V].
    order : n.
    ridge : relative to the energy of each channel.  Rounding errors appear below 1e-17 at order 80, 1e-19 at order 40.
    Raises IdentificationError if a channel is silent, or there are too few samples for the order.
    """
    energy = np.sum(np.concatenate([y, u], axis=1) ** 2, axis=0)
    if not np.all(energy > 0.0):
        raise IdentificationError(
            "a channel is silent",
            value=energy.tolist(),
            allowed="a signal on every drive and sense channel",
            next_step="use a record in which all drives act",
        )
    return arx_of(advance(start_lattice(y.shape[1], u.shape[1], order, ridge * energy), y, u))
