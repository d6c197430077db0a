"""What every reader gives back, and how much it may hold.

A reader is one module with ``read(path) -> Columns`` and ``write(path, columns)``.  It may raise anything:
the door (``read_columns``) turns every failure into one :class:`MeasurementError`.  Sizes are checked before
memory is asked for, since a damaged header can claim any size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import MeasurementError

#: Column name -> vector, as it lies in the file; checked and converted later, by ``columns.assemble``.
Columns = dict[str, NDArray[Any]]

#: Largest number of values read from one file (268 MB as float64, eleven minutes of five columns at 10 kHz).
MAX_VALUES = 2**25
#: Deflate cannot expand by more than this.
MAX_EXPANSION = 1100


def allow(values: int, file_bytes: int) -> None:
    """Refuse a file that claims more ``values`` than may be read, or than its size in bytes can hold."""
    if not 0 <= values <= MAX_VALUES:
        raise MeasurementError(
            "the file claims too many values",
            value=values,
            allowed=f"at most {MAX_VALUES} values in a record",
            next_step="split the record, or leave out columns that are not needed",
        )
    if values > MAX_EXPANSION * max(file_bytes, 1):
        raise MeasurementError(
            "the file claims more values than its size can hold",
            value=values,
            allowed=f"at most {MAX_EXPANSION * file_bytes} in {file_bytes} bytes",
            next_step="the file is damaged: copy it again from its source",
        )


def vector(values: NDArray[Any]) -> NDArray[Any] | None:
    """A row or column vector as (N,); ``None`` where ``values`` is no real vector of numbers."""
    if values.dtype.kind not in "fiub" or values.ndim == 0 or values.size != max(values.shape, default=0):
        return None
    return np.ravel(values)
