"""The result of every reader, and the check of its size.

A reader is a module with ``read(path) -> Columns`` and ``write(path, columns)``.  It may raise any exception;
``readers.read_columns`` converts all of them to :class:`MeasurementError`.  Sizes are checked before memory is allocated,
because a damaged header can state any size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import MeasurementError
from ....input_limits import RECORD_EXPANSION, RECORD_VALUES

#: Column name -> vector (N,) as stored in the file; ``columns.assemble`` checks and converts it.
Columns = dict[str, NDArray[Any]]

#: Most columns of a table that is one variable: a matrix with more is no set of signals.
MOST_COLUMNS = 64


def allow(values: int, file_bytes: int) -> None:
    """Check the number of ``values`` that a file states against the limit and against its size in bytes.

    Raises
    ------
    MeasurementError : there are too many.
    """
    if not 0 <= values <= RECORD_VALUES:
        raise MeasurementError(
            "the file holds too many values",
            value=values,
            allowed=f"at most {RECORD_VALUES} values per record",
            next_step="split the record, or remove columns that are not needed",
        )
    if values > RECORD_EXPANSION * max(file_bytes, 1):
        raise MeasurementError(
            "the file states more values than its size can hold",
            value=values,
            allowed=f"at most {RECORD_EXPANSION * file_bytes} in {file_bytes} bytes",
            next_step="the file is damaged: copy it again from its source",
        )


def vectors(name: str, values: NDArray[Any]) -> Columns:
    """A row or column vector as ``name``, the columns of a table (N, k) or of its transpose as ``name[1]``, ``name[2]``, ..

    A table has at most :data:`MOST_COLUMNS` columns and more rows than columns; other arrays are no signals.
    """
    if (single := vector(values)) is not None:
        return {name: single}
    if values.dtype.kind not in "fiub" or values.ndim != 2 or not 1 < min(values.shape) <= MOST_COLUMNS:
        return {}
    tall = values if values.shape[0] > values.shape[1] else values.T
    return {f"{name}[{k + 1}]": np.ascontiguousarray(column) for k, column in enumerate(tall.T)}


def vector(values: NDArray[Any]) -> NDArray[Any] | None:
    """A row or column vector as (N,), a number as (1,), unit unchanged; ``None`` for a table and for what is no real number."""
    if values.dtype.kind not in "fiub" or values.size != max(values.shape, default=1):
        return None
    return np.ravel(values)
