"""Poles and residues of the motion of a device, and how small changes of its mechanics move them.

The state matrix A = R diag(p) L, with R L = 1; to first order in dA,

    dp_j = (L dA R)_jj,   dR = R X,   dL = -X L,   X_ij = (L dA R)_ij / (p_j - p_i),  X_jj = 0

Source: Golub & Van Loan, Matrix Computations, section 7.2.

Shapes: B devices, 3 modes and coordinates, k changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....arrays import ComplexArray, FloatArray, IntArray
from ....device.mechanics import Mechanics, modes_of, state_matrix


@dataclass(frozen=True, eq=False)
class PositionModes:
    """Modes of (K + s C + s^2)^-1 of each device.

    Parameters
    ----------
    every : all poles (B, 6) [rad/s].
    right, left : R and L (B, 6, 6).
    own : indices (B, 3) of the poles with Im p > 0.
    """

    every: ComplexArray
    right: ComplexArray
    left: ComplexArray
    own: IntArray

    @classmethod
    def of(cls, mechanics: Mechanics, near: ComplexArray) -> PositionModes:
        """Those of ``mechanics`` (B devices), in the order of the poles ``near`` (B, 3).

        Raises
        ------
        ConfigError : a mode does not oscillate, as in ``modes_of``.
        """
        every, right = np.linalg.eig(state_matrix(mechanics))
        upper = np.argsort(np.where(every.imag > 0.0, every.imag, np.inf), axis=1)[:, :3]
        order = np.argsort(np.argsort(near.imag, axis=1), axis=1)
        device = np.arange(len(every))[:, None]
        own = upper[device, order]
        if not np.all(every[device, own].imag > 0.0):
            # It states which mode does not oscillate.
            modes_of(mechanics)
        return cls(every, right, np.linalg.inv(right), own)

    @property
    def poles(self) -> ComplexArray:
        """p_j (B, 3) [rad/s]."""
        return self.every[self._device, self.own]

    @property
    def parts(self) -> ComplexArray:
        """Residues (B, 3, 3, 3), those of ``modes_of`` with unit drive and sense."""
        return _outer(self._columns, self._rows)

    def moved(self, change: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """First-order changes of the poles (B, k, 3) and residues (B, k, 3, 3, 3) by changes (B, k, 6, 6) of the state matrix."""
        crossed = self.left[:, None] @ change @ self.right[:, None]
        gap = (self.every[:, None] - self.every[:, :, None])[:, None]
        mixed = np.divide(crossed, gap, out=np.zeros_like(crossed), where=gap != 0.0)
        right = np.swapaxes(self.right[:, None, :3] @ mixed, 2, 3)
        left = -(mixed @ self.left[:, None, :, 3:])
        columns, rows = (np.swapaxes(each[self._device, :, self.own], 1, 2) for each in (right, left))
        parts = _outer(columns, self._rows[:, None]) + _outer(self._columns[:, None], rows)
        return np.swapaxes(crossed[self._device, :, self.own, self.own], 1, 2), parts

    @property
    def _device(self) -> IntArray:
        return np.arange(len(self.every))[:, None]

    @property
    def _columns(self) -> ComplexArray:
        """Position halves (B, 3, 3) of the right eigenvectors of the poles."""
        return np.swapaxes(self.right[:, :3], 1, 2)[self._device, self.own]

    @property
    def _rows(self) -> ComplexArray:
        """Velocity halves (B, 3, 3) of the left eigenvectors of the poles."""
        return self.left[self._device, self.own][:, :, 3:]


def _outer(column: ComplexArray, row: ComplexArray) -> ComplexArray:
    return np.asarray(column[..., :, None] * row[..., None, :])
