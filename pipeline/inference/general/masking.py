"""Residuals of records with bad samples: a nuisance basis for each channel, orthonormal on its good samples.

    rest = G y - Q Q^T G y,        G = diag(good),    Q = G B (B^T G B)^(-1/2)

so bad samples have residual and derivatives 0, and the nuisances are those that the good samples determine.

Shapes: N samples, S senses, L nuisances per channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class MaskedBasis:
    """The good samples (N, S) of a record, and Q (N, L) [1] of each channel."""

    good: BoolArray
    bases: tuple[FloatArray, ...]

    def rest(self, y: FloatArray, channel: int) -> FloatArray:
        """G y - Q Q^T G y (..., N) of y (..., N), in its unit."""
        z, q = y * self.good[:, channel], self.bases[channel]
        return np.asarray(z - (z @ q) @ q.T)


def masked_basis(basis: FloatArray, good: BoolArray | None) -> MaskedBasis | None:
    """The nuisance basis (N, L) [1] on the ``good`` samples (N, S) of each channel; ``None`` where all are good."""
    if good is None:
        return None
    bases = []
    for own in good.T:
        masked = basis * own[:, None]
        values, vectors = np.linalg.eigh(masked.T @ masked)
        kept = values > 1e-10 * values[-1]
        bases.append(masked @ (vectors[:, kept] / np.sqrt(values[kept])))
    return MaskedBasis(good, tuple(bases))
