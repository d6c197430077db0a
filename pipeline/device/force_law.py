"""Force laws: the compiled stage of an effect, called by the integrator at every step.

    force(t, q, qd, u, p, laws, out): adds an acceleration (n,) [V/s] to ``out``

at time t [s], coordinates q (n,) [V s], velocities qd (n,) [V], drive samples u (D,) [V], parameters p (k,).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

from numba import njit, types
from numba.core.errors import NumbaExperimentalFeatureWarning

from ..arrays import FloatArray
from ..errors import ConfigError
from ..threads import once


class Laws(NamedTuple):
    """Linear mechanics and conditions of the record, as force laws see them.

    damping (n, n) [1/s], stiffness (n, n) [1/s^2]; drive (n, D) [1/s]; motion (D, n): motion @ q (D,) is the motion of the
    drive electrodes [V s]; bias_v of the record and operating_bias_v of the device [V]; ``axes``: nonlinear laws act on the
    first ``axes`` coordinates.
    """

    damping: FloatArray
    stiffness: FloatArray
    drive: FloatArray
    motion: FloatArray
    bias_v: float
    operating_bias_v: float
    axes: int


_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")
LAWS_TYPE = types.NamedTuple((_MATRIX, _MATRIX, _MATRIX, _MATRIX, types.float64, types.float64, types.int64), Laws)
FORCE_SIGNATURE = types.void(types.float64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, LAWS_TYPE, _VECTOR)
# Tuples of function pointers allow one compiled integrator for all combinations of effects.  The warning filter is set once,
# because changing filters around each call is not thread-safe.
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)
FORCE_TYPE = types.FunctionType(FORCE_SIGNATURE)


@once
def compiled_force(force: Callable[..., None]) -> Any:
    """``force`` compiled to the signature that the integrator calls.

    Raises
    ------
    ConfigError : numba cannot compile it.
    """
    try:
        return njit(FORCE_SIGNATURE, cache=True, error_model="numpy")(force)
    except Exception as error:
        raise ConfigError(
            "the force law of an effect does not compile",
            value=f"{force.__module__}: {str(error).strip().splitlines()[0] if str(error).strip() else error}",
            allowed="plain arithmetic on numbers and arrays",
            next_step="see docs/add-an-effect.md",
        ) from error


class ForcePointer(types.WrapperAddressProtocol):
    """A compiled force law by its address, which a compiled loop takes faster than the law itself."""

    def __init__(self, force: Callable[..., None]) -> None:
        found = compiled_force(force).get_compile_result(FORCE_SIGNATURE)
        self._address = int(found.library.get_pointer_to_function(found.fndesc.llvm_cfunc_wrapper_name))

    def __wrapper_address__(self) -> int:
        return self._address

    def signature(self) -> Any:
        """Signature of the compiled law."""
        return FORCE_SIGNATURE


@once
def force_pointer(force: Callable[..., None]) -> ForcePointer:
    """The compiled ``force`` by its address; raises as :func:`compiled_force`."""
    return ForcePointer(force)
