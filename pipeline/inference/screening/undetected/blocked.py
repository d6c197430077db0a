"""Columns of scans as mixtures of few, block by block of adjacent bins: products with them take less than half of the time.

    Z_b = B_b M_b + R_b,      |r| <= 1e-5 |z|  for each column r of R_b, with the column z of Z of all bins
    rows Z = sum_b (rows_b B_b) M_b = [rows_1 B_1, rows_2 B_2, ..] M

A narrow mode has a shape of its own only in the block that has its frequency; in the others it is one of a few smooth ones, times
the spectrum of the drive.  Over all bins at once the columns are nearly independent: rank 194 of 210.

B comes from a Cholesky factor with pivots of the products of unit columns, Z_b' Z_b = P' L L' P, which ends where what is left of
each column is below the tolerance: B_b = Z_b[pivots] L_11'^-1 are orthonormal, and M_b = L' P.

Shapes: K columns, W bins, r columns B_b of a block of w bins.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpstrf

from ....arrays import RealArray

#: Blocks of a band.  Of 901 bins and 210 columns they have 373 columns in all, and products with 30 rows take 0.15 ms; with
#: 4 blocks 0.18 ms, with 10 blocks 0.16 ms, with all columns 0.30 ms.
_BLOCKS = 6
#: Part of a unit column in a block that is left out.  In 24 devices it changed p-values of scans by 4e-5 of themselves at most,
#: and bounds by 5e-5; 1e-4: 2e-4 and 2e-4, 1e-3: 4e-3 and 6e-2, 1e-6: 9e-6 and 5e-6, for 0.01 ms more.
_LEFT_OUT = 1e-5
#: Multiplications, relative to those with all columns, from which blocks save nothing: they are smaller products.
_WORTH = 0.75


@dataclass(frozen=True, eq=False)
class Blocked:
    """Columns (2 W, K) as mixtures, in single precision.

    Parameters
    ----------
    edges : first bin of each block, and W.
    bases : (2 w, r) columns of each block, real parts before imaginary ones.
    mix : (sum of r, K).
    """

    edges: tuple[int, ...]
    bases: tuple[NDArray[np.float32], ...]
    mix: NDArray[np.float32]

    def products(self, rows: RealArray) -> NDArray[np.float32]:
        """Products (n, K) of ``rows`` (n, 2 W) with the columns."""
        parts = rows.reshape(rows.shape[0], 2, -1)
        inner = np.empty((rows.shape[0], self.mix.shape[0]), dtype=np.float32)
        last = 0
        for first, end, basis in zip(self.edges, self.edges[1:], self.bases):
            own = np.empty((rows.shape[0], 2, end - first), dtype=np.float32)
            own[:] = parts[:, :, first:end]
            before, last = last, last + basis.shape[1]
            np.matmul(own.reshape(rows.shape[0], -1), basis, out=inner[:, before:last])
        return np.asarray(inner @ self.mix)


def blocked(columns: NDArray[np.float32]) -> Blocked | None:
    """The columns (K, 2 W), real parts before imaginary ones, as mixtures; ``None`` where that saves no time."""
    count, bins = columns.shape[0], columns.shape[1] // 2
    norm = np.sqrt(np.einsum("kw,kw->k", columns, columns, dtype=np.float64))
    norm[norm == 0.0] = 1.0
    edges = tuple(bins * b // _BLOCKS for b in range(_BLOCKS + 1))
    parts = columns.reshape(count, 2, bins)
    bases, mixes = [], []
    for first, end in pairwise(edges):
        own = parts[:, :, first:end].reshape(count, -1) / norm[:, None]
        factor, pivots, rank, _ = dpstrf(own @ own.T, tol=_LEFT_OUT**2, lower=1)
        factor, pivots = np.tril(factor)[:, :rank], pivots - 1
        bases.append(solve_triangular(factor[:rank], own[pivots[:rank]], lower=True).T.astype(np.float32, order="C"))
        mix = np.empty((rank, count), dtype=np.float32)
        mix[:, pivots] = factor.T * norm[pivots]
        mixes.append(mix)
    found = Blocked(edges, tuple(bases), np.concatenate(mixes))
    work = sum(basis.size for basis in bases) + found.mix.size
    return found if work < _WORTH * columns.size else None
