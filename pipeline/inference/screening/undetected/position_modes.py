"""Poles and residues of the motion of a device, and how small changes of its mechanics move them.

The state matrix A = R diag(p) L, with R L = 1; to first order in dA,

    dp_j = (L dA R)_jj,   dR = R X,   dL = -X L,   X_ij = (L dA R)_ij / (p_j - p_i),  X_jj = 0

Source: Golub & Van Loan, Matrix Computations, section 7.2.

Shapes: 3 modes and coordinates, k changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....arrays import ComplexArray, FloatArray, IntArray
from ....device.mechanics import Mechanics, modes_of, state_matrix


@dataclass(frozen=True, eq=False)
class PositionModes:
    """Modes of (K + s C + s^2)^-1: all poles (6,) [rad/s], R and L (6, 6), and the indices (3,) of those with Im p > 0."""

    every: ComplexArray
    right: ComplexArray
    left: ComplexArray
    own: IntArray

    @classmethod
    def of(cls, mechanics: Mechanics, near: ComplexArray) -> PositionModes:
        """Those of ``mechanics`` (a batch of one), in the order of the poles ``near`` (3,).

        Raises
        ------
        ConfigError : a mode does not oscillate, as in ``modes_of``.
        """
        every, right = np.linalg.eig(state_matrix(mechanics)[0])
        upper = np.argsort(np.where(every.imag > 0.0, every.imag, np.inf))[:3]
        own = upper[np.argsort(np.argsort(near.imag))]
        if not np.all(every[own].imag > 0.0):
            # It states which mode does not oscillate.
            modes_of(mechanics)
        return cls(every, right, np.linalg.inv(right), own)

    @property
    def poles(self) -> ComplexArray:
        """p_j (3,) [rad/s]."""
        return self.every[self.own]

    @property
    def parts(self) -> ComplexArray:
        """Residues (3, 3, 3), those of ``modes_of`` with unit drive and sense."""
        return _outer(self.right[:3, self.own].T, self.left[self.own, 3:])

    def moved(self, change: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """First-order changes of the poles (k, 3) and of the residues (k, 3, 3, 3) by changes (k, 6, 6) of the state matrix."""
        crossed = self.left @ change @ self.right
        gap = self.every - self.every[:, None]
        mixed = np.divide(crossed, gap, out=np.zeros_like(crossed), where=gap != 0.0)
        right = np.swapaxes((self.right[:3] @ mixed)[:, :, self.own], 1, 2)
        left = -(mixed @ self.left[:, 3:])[:, self.own]
        parts = _outer(right, self.left[self.own, 3:]) + _outer(self.right[:3, self.own].T, left)
        return crossed[:, self.own, self.own], parts


def _outer(column: ComplexArray, row: ComplexArray) -> ComplexArray:
    return np.asarray(column[..., :, None] * row[..., None, :])
