"""Mean and variance of many lines of numbers in one compiled pass: numpy takes five passes and as many arrays in between.

    m = sum x / n,      v = sum (x - m)^2 / n

Shapes: lines (..., n).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..arrays import FloatArray


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _moments(lines: FloatArray, means: FloatArray, variances: FloatArray) -> None:
    count, n = lines.shape
    for k in range(count):
        total = 0.0
        for i in range(n):
            total += lines[k, i]
        mean = total / n
        square = 0.0
        for i in range(n):
            square += (lines[k, i] - mean) * (lines[k, i] - mean)
        means[k], variances[k] = mean, square / n


def moments(lines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means and variances (...), with divisor n, of lines (..., n), n >= 1; nan of a line that contains nan."""
    flat = np.ascontiguousarray(lines).reshape(-1, lines.shape[-1])
    means, variances = np.empty(flat.shape[0]), np.empty(flat.shape[0])
    _moments(flat, means, variances)
    return means.reshape(lines.shape[:-1]), variances.reshape(lines.shape[:-1])
