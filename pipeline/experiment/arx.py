"""Prediction of one sense channel from its own past and the drives, and interpolation of its bad samples.

    e[n] = sum_k A_k y[n-k] - sum_d sum_k B_dk u_d[n-k] - c,        A_0 = 1,    k = 0 .. p
    size of a spike at n:   s[n] = sum_k A_k e[n+k] / |A|^2          (matched filter; its sd is that of e over |A|)
    interpolation:          y_bad = argmin sum e^2

The coefficients are those of least squares.  Interpolation: Janssen, Veldhuis and Vries, IEEE Trans. Acoust. Speech Signal
Process. 34 (1986) 317.

Shapes: N samples, D drives, K bad samples.  Volts.
"""

from __future__ import annotations

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray

#: Order of the ARX model: three modes, a sweep and their harmonics take about 12 coefficients at 70 dB.
ORDER = 24
#: Rows of the least-squares problem; more do not improve the detection and cost time.
_ROWS = 8000


class Arx:
    """An ARX model of one channel: A (p + 1,), and the part of e (N,) that drives and offset give."""

    def __init__(self, a: FloatArray, driven: FloatArray) -> None:
        self.a, self.driven = a, driven
        self.norms = np.maximum(np.convolve(np.ones(driven.size - a.size + 1), (a**2)[::-1]), 1e-300)
        # At both ends some of the errors that a spike causes are unknown, and the sd of s is larger.
        self.weights = np.sqrt(self.norms / float(a @ a))

    @classmethod
    def fitted(cls, y: FloatArray, drive_v: FloatArray, bad: BoolArray) -> Arx:
        """Least squares over rows without a ``bad`` sample (N,)."""
        p, samples = ORDER, y.size
        sound = np.flatnonzero(np.convolve(bad, np.ones(p + 1))[p:samples] < 0.5) + p
        rows = sound[:: max(1, sound.size // _ROWS)]
        lags = rows[:, None] - np.arange(p + 1)
        columns = [y[lags[:, 1:]], np.ones((rows.size, 1)), *(u[lags] for u in drive_v.T)]
        x = np.concatenate(columns, axis=1)
        scale = np.linalg.norm(x, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        x = x / scale
        values, vectors = np.linalg.eigh(x.T @ x)
        kept = np.maximum(values, 1e-13 * values[-1])
        w = vectors @ ((vectors.T @ (x.T @ y[rows])) / kept) / scale
        driven = np.full(samples, w[p])
        for d, u in enumerate(drive_v.T):
            first = p + 1 + d * (p + 1)
            driven += np.convolve(u, w[first : first + p + 1])[:samples]
        return cls(np.concatenate([[1.0], -w[:p]]), driven)

    def errors(self, y: FloatArray) -> FloatArray:
        """e (N - p,) of y (N,), from sample p on."""
        p = self.a.size - 1
        return np.asarray(np.convolve(y, self.a)[p : y.size] - self.driven[p:])

    def sizes(self, y: FloatArray) -> FloatArray:
        """s (N,) [V]: size of a spike at each sample."""
        return np.asarray(np.convolve(self.errors(y), self.a[::-1]) / self.norms)

    def interpolated(self, y: FloatArray, bad: IntArray) -> FloatArray:
        """y (N,) with the samples ``bad`` (K,) replaced so that sum e^2 is least."""
        if not bad.size:
            return y
        # Loading scipy.sparse takes 0.1 s, and few records have bad samples.
        from scipy import sparse
        from scipy.sparse.linalg import spsolve

        p, count = self.a.size - 1, y.size - self.a.size + 1
        rows, columns = (
            bad[:, None] + np.arange(p + 1) - p,
            np.broadcast_to(np.arange(bad.size)[:, None], (bad.size, p + 1)),
        )
        inside = (rows >= 0) & (rows < count)
        entries = np.broadcast_to(self.a, rows.shape)[inside]
        m = sparse.csc_matrix((entries, (rows[inside], columns[inside])), shape=(count, bad.size))
        out = y.copy()
        out[bad] = 0.0
        normal = (m.T @ m + 1e-12 * float(self.a @ self.a) * sparse.identity(bad.size)).tocsc()
        out[bad] = np.asarray(spsolve(normal, -(m.T @ self.errors(out))), dtype=np.float64)
        return out
