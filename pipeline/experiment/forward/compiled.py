"""The loops of ``kernels``, compiled once for each number of coordinates and cached on disk."""

from __future__ import annotations

from typing import Any

from numba import njit, types

from ...compiled_loops import is_cached
from ...device.force_law import FORCES_TYPES
from ...threads import once
from .first_order_kernel import first_order_deviation
from .kernels import deviation_from_linear, linear_states

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")

#: Compiler options of loops over samples.
OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}
_STEPS = (types.float64, types.int64)
_DRIVE = (_MATRIX, types.boolean)


@once
def compiled_deviation(half_size: int, beside: int = 0) -> Any:
    """``deviation_from_linear`` for at most ``half_size`` coordinates (H) that drives move, and ``beside`` others (W)."""
    return njit(_deviation_signature(half_size, beside), **OPTIONS)(deviation_from_linear)


def deviation_is_cached(half_size: int, beside: int = 0) -> bool:
    """Whether the cache of this machine holds :func:`compiled_deviation`."""
    return is_cached(njit(**OPTIONS)(deviation_from_linear), _deviation_signature(half_size, beside))


def _deviation_signature(half_size: int, beside: int) -> Any:
    shape, more = types.UniTuple(types.int64, half_size), types.Tuple((types.int64,) * beside)
    matrices = (_MATRIX, _MATRIX, _MATRIX, _MATRIX, types.float64)
    reads = (_VECTOR, _MATRIX, _MATRIX, _MATRIX)
    return types.void(shape, more, *FORCES_TYPES, *matrices, *_STEPS, types.int64, types.int64, *_DRIVE, *reads)


@once
def compiled_linear_states(half_size: int) -> Any:
    """``linear_states`` for at most ``half_size`` coordinates (H)."""
    shape = types.UniTuple(types.int64, half_size)
    signature = types.void(shape, _MATRIX, _MATRIX, _MATRIX, *_STEPS, *_DRIVE, _VECTOR, _MATRIX)
    return njit(signature, **OPTIONS)(linear_states)


@once
def compiled_first_order(half_size: int, beside: int) -> Any:
    """``first_order_deviation`` for at most ``half_size`` known coordinates (H), and ``beside`` others (W)."""
    shape, more = types.UniTuple(types.int64, half_size), types.Tuple((types.int64,) * beside)
    matrices = (_MATRIX, _MATRIX, _MATRIX, types.float64)
    reads = (_MATRIX, _MATRIX, _MATRIX)
    signature = types.void(shape, more, *FORCES_TYPES, *matrices, *_STEPS, types.int64, types.int64, *_DRIVE, *reads)
    return njit(signature, **OPTIONS)(first_order_deviation)
