"""Likelihood of many points at once, for the sampler (``likelihood`` has that of one point, with its slopes, for the fit).

    -chi2/2 = -|d - A c(x)|^2 / 2,     c = [c_0, c_1] residues times powers of the shift of each pole,     A (r, 2 J), d (r,)

``whole_rows`` has all rows of the compressed data.  ``local_rows`` has few: with the slopes J and the residual e at the maximum,

    W = orth[J, e],    A -> W' A,    d -> W' d

and fewer powers of the shift, which they count from the poles of the maximum.  What is left out is the square of the curvature of
the model outside of W, and higher powers.  The product is that of W' A and c(x) - c(x^), a few standard deviations, in single
precision.  ``sample`` measures what both change.

Shapes: n points, P = 12 or 14 parameters, S = 2 senses, J = 48 features (12 for each power of the shift), r rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numba import njit
from scipy.linalg.lapack import dgeqrf, dorgqr

from ...arrays import ComplexArray, FloatArray, RealArray
from ...device.gyro_batch import batch_modes
from .compressed import Compressed
from .fit import modes_at
from .likelihood import FEATURES, ORDER, jacobian_rows, residual_rows

_ORDERS = ORDER + 1
#: C(m, l) in row m and column l.
_BINOMIAL: FloatArray = np.array([[comb(m, l) for l in range(_ORDERS)] for m in range(_ORDERS)], dtype=np.float64)
#: Order in the shift from the poles of the maximum, which is at most a few standard deviations: in 48 default devices it changes
#: the log likelihood by 1e-6 at most, order 1 by 5e-3.
_LOCAL = 2
#: Points whose features are in the cache at once: 200 kB.
_AT_ONCE = 256
#: Rows of a vector of the processor: 16 rows take less time than 15.
_LANES = 16


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a compressed likelihood, in sigmas.

    Parameters
    ----------
    expansion : poles (3,) [rad/s] of the features.
    design, target : A (r, 2 J), in the precision of its product, and d (r,) less what the origin adds.
    origin : residues (S, 3, D) from which those of c count.
    prior_root, prior_offset : (2, 2) and (2,) of the mismatches; (0, 2) and (0,) without.
    """

    expansion: ComplexArray
    design: RealArray
    target: FloatArray
    origin: ComplexArray
    prior_root: FloatArray
    prior_offset: FloatArray

    def log_likelihood(self, points: FloatArray) -> FloatArray:
        """-chi2/2 (n,) [1] of the rows and of the prior at ``points`` (n, P), -inf outside the support of the prior."""
        rows = np.ascontiguousarray(points.T)
        return _log_likelihood(
            rows,
            np.exp(rows[8:10]),
            self.expansion,
            self.design,
            self.target,
            self.origin,
            self.prior_root,
            self.prior_offset,
        )


def whole_rows(likelihood: Compressed) -> Rows:
    """All rows of a compressed likelihood."""
    rows = likelihood.triangle.shape[1]
    design = np.zeros((2 * rows, 2 * FEATURES))
    design[:rows, :FEATURES], design[rows:, FEATURES:] = likelihood.triangle
    design[: likelihood.cross.shape[0], FEATURES:] = likelihood.cross
    return Rows(
        likelihood.expansion,
        design,
        likelihood.data.ravel(),
        np.zeros((2, 3, 2), dtype=np.complex128),
        likelihood.prior_root,
        likelihood.prior_offset,
    )


def local_rows(likelihood: Compressed, x: FloatArray) -> Rows:
    """The rows that matter near the maximum ``x`` (P,): P + 1, and zeros; to a low order in the shift from its poles."""
    whole = whole_rows(likelihood)
    count = whole.target.size
    residual, _ = residual_rows(x, *likelihood.arrays)
    slopes = jacobian_rows(x, *likelihood.arrays)[:count]
    kept = np.concatenate([slopes / np.linalg.norm(slopes, axis=0), residual[:count, None]], axis=1)
    basis = np.zeros((-(-kept.shape[1] // _LANES) * _LANES, count))
    factors, reflections, _, _ = dgeqrf(kept, overwrite_a=True)
    orthonormal, _, _ = dorgqr(factors, reflections, overwrite_a=True)
    basis[: kept.shape[1]] = orthonormal.T
    centre, origin, design = _expanded_at(basis @ whole.design, whole.expansion, x)
    # At the maximum no pole is shifted, so its features are its residues.
    own = design.reshape(design.shape[0], -1, 2 * (_LOCAL + 1))[:, :, :2].reshape(design.shape[0], -1)
    target = basis @ whole.target - own @ origin.ravel().view(np.float64)
    return Rows(centre, design.astype(np.float32), target, origin, whole.prior_root, whole.prior_offset)


def _expanded_at(
    design: FloatArray, expansion: ComplexArray, x: FloatArray
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Poles (3,) and residues (S, 3, D) of ``x`` in the order of ``expansion`` (3,); a design (r, 2 J) with features around them.

    c_m = R (delta + h)^m = sum_l C(m, l) delta^{m-l} R h^l,      delta the poles less the expansion
    """
    poles, residues = modes_at(x)
    straight, crossed = (np.abs(poles[:2][list(way)] - expansion[:2]).sum() for way in ((0, 1), (1, 0)))
    order = [1, 0, 2] if crossed < straight else [0, 1, 2]
    centre, origin = poles[order], np.ascontiguousarray(residues[order].swapaxes(0, 1))
    power = np.subtract.outer(np.arange(_ORDERS), np.arange(_LOCAL + 1))
    delta = (centre - expansion)[:, None, None] ** np.maximum(power, 0)
    moved = (_BINOMIAL[:, : _LOCAL + 1] * delta).conj()
    # A real pair (A, B) times (re c, im c) is the real part of conj(A + iB) c.
    pairs = np.ascontiguousarray(design).view(np.complex128).reshape(-1, 2, 3, 2, _ORDERS)
    return centre, origin, (pairs @ moved).reshape(design.shape[0], -1).view(np.float64)


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _features(
    poles: FloatArray, residues: FloatArray, expansion: ComplexArray, origin: ComplexArray, out: RealArray
) -> None:
    """Fill ``out`` (2 J, n) with c of modes (3, 2, n), (3, S, D, 2, n), the residues less ``origin`` (S, 3, D).

    Each rocking pole is at the nearer one of the expansion.
    """
    count, orders = poles.shape[2], out.shape[0] // 24
    shift = np.empty((3, 2, count))
    crossed = np.empty(count, dtype=np.bool_)
    ar, ai, br, bi = expansion[0].real, expansion[0].imag, expansion[1].real, expansion[1].imag
    for n in range(count):
        pr, pi, qr, qi = poles[0, 0, n], poles[0, 1, n], poles[1, 0, n], poles[1, 1, n]
        straight = np.sqrt((pr - ar) ** 2 + (pi - ai) ** 2) + np.sqrt((qr - br) ** 2 + (qi - bi) ** 2)
        across = np.sqrt((pr - br) ** 2 + (pi - bi) ** 2) + np.sqrt((qr - ar) ** 2 + (qi - ai) ** 2)
        swap = across < straight
        crossed[n] = swap
        shift[0, 0, n], shift[0, 1, n] = (qr if swap else pr) - ar, (qi if swap else pi) - ai
        shift[1, 0, n], shift[1, 1, n] = (pr if swap else qr) - br, (pi if swap else qi) - bi
        shift[2, 0, n] = poles[2, 0, n] - expansion[2].real
        shift[2, 1, n] = poles[2, 1, n] - expansion[2].imag
    for k in range(3):
        for a in range(2):
            for d in range(2):
                first = ((a * 3 + k) * 2 + d) * orders * 2
                own, other = residues[k, a, d], residues[1 - k if k < 2 else k, a, d]
                fr, fi = origin[a, k, d].real, origin[a, k, d].imag
                for n in range(count):
                    cr = other[0, n] if crossed[n] else own[0, n]
                    ci = other[1, n] if crossed[n] else own[1, n]
                    out[first, n], out[first + 1, n] = cr - fr, ci - fi
                for m in range(1, orders):
                    j = first + 2 * m
                    for n in range(count):
                        cr, ci, hr, hi = out[j - 2, n] + fr, out[j - 1, n] + fi, shift[k, 0, n], shift[k, 1, n]
                        out[j, n], out[j + 1, n] = cr * hr - ci * hi, cr * hi + ci * hr
                    fr, fi = 0.0, 0.0


@njit(cache=True)
def _outside(x: FloatArray, chi2: FloatArray) -> None:
    """Set ``chi2`` (n,) to infinity where points x (P, n) are not ``likelihood.allowed``."""
    with_mismatch = x.shape[0] == 14
    for n in range(x.shape[1]):
        s, d = x[10, n], x[11, n]
        inside = (
            (x[3, n] > 0.0)
            & (x[4, n] * x[4, n] + x[5, n] * x[5, n] <= x[3, n] * x[3, n])
            & (x[7, n] > 0.0)
            & (4.0 * x[6, n] * x[6, n] > x[7, n] * x[7, n])
            & (abs(s) < 1.0)
            & (abs(d) < 1.0)
            & (x[0, n] * x[0, n] > x[1, n] * x[1, n] + x[2, n] * x[2, n])
            & (x[6, n] > 0.0)
        )
        if with_mismatch:
            inside = inside & (abs(s + x[13, n]) < 1.0) & (abs(d + x[12, n]) < 1.0)
        chi2[n] = chi2[n] if inside else np.inf


@njit(cache=True)
def _log_likelihood(
    x: FloatArray,
    gains: FloatArray,
    expansion: ComplexArray,
    design: RealArray,
    target: FloatArray,
    origin: ComplexArray,
    prior_root: FloatArray,
    prior_offset: FloatArray,
) -> FloatArray:
    """:meth:`Rows.log_likelihood` of points x (P, n) with gains (2, n) = exp(x[8:10])."""
    count = x.shape[1]
    out = np.empty(count)
    for first in range(0, count, _AT_ONCE):
        last = min(first + _AT_ONCE, count)
        own = x[:, first:last].copy()
        poles, residues = np.empty((3, 2, last - first)), np.empty((3, 2, 2, 2, last - first))
        batch_modes(own, gains[:, first:last].copy(), poles, residues)
        c = np.empty((design.shape[1], last - first), dtype=design.dtype)
        _features(poles, residues, expansion, origin, c)
        model = np.dot(design, c)
        total = np.zeros(last - first)
        for i in range(target.size):
            for n in range(last - first):
                r = target[i] - model[i, n]
                total[n] += r * r
        for i in range(prior_offset.size):
            for n in range(last - first):
                r = prior_offset[i] - prior_root[i, 0] * own[12, n] - prior_root[i, 1] * own[13, n]
                total[n] += r * r
        _outside(own, total)
        for n in range(last - first):
            out[first + n] = -0.5 * total[n]
    return out
