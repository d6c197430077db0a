"""Array types: every array in the packages is one of these; complex ones in real parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def real_parts(z: ComplexArray) -> FloatArray:
    """(2, ..): real parts, then imaginary ones; what compiled loops are fastest with."""
    return np.stack([z.real, z.imag])
