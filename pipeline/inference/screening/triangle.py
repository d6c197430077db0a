"""The triangle T of the QR decomposition [A, y] = Q T of features A and data y, less their hum lines.

Q is not needed.  From the Gram matrix T takes a third of the time of reflections:

    T^T T = [A, y]^T (I - n n^T) [A, y]        (Cholesky)

Its rounding, 1e-15 of |y|^2, is an error of chi2; the least pivot tells how near the columns are to being dependent.  Reflections
are the way where either is too large.  120 default devices, 1e-12 < pivot: chi2 differs by 7e-5, its sd being 60, the maximum by
2e-5 sd, an sd by 1e-14 of itself (pivots below: 3 devices).

Shapes: W bins, J features, S senses, L nuisances; J + S = n columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf, dtpqrt

from ...arrays import FloatArray

#: Least pivot, in units of the square of its column: an error of 1e-5 of what the column adds to the ones before it.
_PIVOT = 1e-10
#: Largest |y|^2 [sigma^2] of a sense: an error of chi2 of 1e-3.
_LOUDEST = 1e12
#: Columns that reflections treat at once: they stay in the cache; LAPACK's own choice of 32 takes 1.5 times as long.
_AT_ONCE = 10


@dataclass(frozen=True, eq=False)
class FeatureRows:
    """One record: ``columns`` A (2 W, J), ``data`` y (2 W, S) and an orthonormal ``nuisance`` basis n (2 W, L) [1].

    ``scale`` times A and y are in units of the sd of the noise.
    """

    columns: FloatArray
    data: FloatArray
    nuisance: FloatArray
    scale: float

    def without_lines(self) -> FloatArray:
        """Scaled [A, y] (2 W, n) less their part in the nuisance basis, in columns of memory."""
        size = self.columns.shape[1]
        both = np.empty((size + self.data.shape[1], self.columns.shape[0]))
        np.multiply(self.columns.T, self.scale, out=both[:size])
        np.multiply(self.data.T, self.scale, out=both[size:])
        if not self.nuisance.shape[1]:
            return both.T
        # In place: the columns do not fit into the cache twice.
        along = both @ self.nuisance
        return np.asarray(dgemm(-1.0, self.nuisance, along, 1.0, both.T, trans_b=True, overwrite_c=True))


def triangle_of(parts: Sequence[FeatureRows]) -> FloatArray:
    """T (n, n), upper triangular, of all records of a device together."""
    found = _by_gram(parts)
    return _by_reflections(parts) if found is None else found


def _by_gram(parts: Sequence[FeatureRows]) -> FloatArray | None:
    """T by the Gram matrix; ``None`` where rounding would show."""
    features, count = parts[0].columns.shape[1], parts[0].columns.shape[1] + parts[0].data.shape[1]
    gram, square = np.zeros((count, count)), np.zeros(count)
    for part in parts:
        # The data may consist of lines, the columns do not: what their lines take away is no difference of large numbers.
        y = part.scale * (part.data - part.nuisance @ (part.nuisance.T @ part.data))
        own = part.columns.T @ part.columns
        both = part.columns.T @ np.concatenate([part.nuisance, y], axis=1)
        along, product = both[:, : part.nuisance.shape[1]], both[:, part.nuisance.shape[1] :]
        square[:features] += part.scale**2 * own.diagonal()
        gram[:features, :features] += part.scale**2 * (own - along @ along.T)
        gram[:features, features:] += part.scale * product
        gram[features:, features:] += y.T @ y
    square[features:] = gram[features:, features:].diagonal()
    if not (np.all(square > 0.0) and np.all(square[features:] < _LOUDEST)):
        return None
    size = np.sqrt(square)
    found, fault = dpotrf(gram / (size[:, None] * size), clean=True, overwrite_a=True)
    if fault or found.diagonal()[:features].min() ** 2 < _PIVOT:
        return None
    return np.asarray(found * size)


def _by_reflections(parts: Sequence[FeatureRows]) -> FloatArray:
    """T by Householder reflections, record after record."""
    count = parts[0].columns.shape[1] + parts[0].data.shape[1]
    found = np.zeros((count, count), order="F")
    for part in parts:
        found, _, _, fault = dtpqrt(0, min(_AT_ONCE, count), found, part.without_lines(), overwrite_b=True)
        assert fault == 0  # of an argument, never of the numbers
    return np.asarray(found)
