"""Array types: every array in the packages is one of these; complex ones in real parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
#: Real or complex numbers in single or double precision; the document of a function says which.
RealArray = NDArray[Any]
AnyComplexArray = NDArray[Any]

#: Eigenvalue of a Gram matrix of unit columns, relative to the largest, below which its direction is rounding: the columns are
#: right to 3e-5.
RANK = 1e-9


def real_parts(z: ComplexArray) -> FloatArray:
    """(2, ..): real parts, then imaginary ones; what compiled loops are fastest with."""
    return np.stack([z.real, z.imag])


def by_column(x: FloatArray) -> FloatArray:
    """A view (P, ..) of x (.., P): ``numpy.moveaxis`` of the last axis, in a tenth of its time."""
    return x.transpose(x.ndim - 1, *range(x.ndim - 1))


def by_row(columns: FloatArray) -> FloatArray:
    """A view (.., P) of ``columns`` (P, ..), the inverse of :func:`by_column`."""
    return columns.transpose(*range(1, columns.ndim), 0)
