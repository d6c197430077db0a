"""Force laws: the compiled stage of an effect, called by the integrator at every step.

    force(t, q, qd, u, p, laws, out): adds an acceleration (n,) [V/s] to ``out``

at time t [s], coordinates q (n,) [V s], velocities qd (n,) [V], drive samples u (D,) [V], parameters p (k,).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from ..arrays import FloatArray, IntArray, RealArray
from ..errors import ConfigError
from ..threads import once


class Laws(NamedTuple):
    """Linear mechanics and conditions of the record, as force laws see them.

    damping (n, n) [1/s], stiffness (n, n) [1/s^2]; drive (n, D) [1/s]; motion (D, n): motion @ q (D,) is the motion of the
    drive electrodes [V s]; bias_v of the record and operating_bias_v of the device [V]; ``axes``: nonlinear laws act on the
    first ``axes`` coordinates; elapsed_s: time from the start of the run to the first sample of the record [s]; the last
    ``memories`` coordinates are memories, whose velocity is an internal state (``effect``).
    """

    damping: FloatArray
    stiffness: FloatArray
    drive: FloatArray
    motion: FloatArray
    bias_v: float
    operating_bias_v: float
    axes: int
    elapsed_s: float = 0.0
    memories: int = 0


_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")
LAWS_TYPE = types.NamedTuple(
    (_MATRIX, _MATRIX, _MATRIX, _MATRIX, types.float64, types.float64, types.int64, types.float64, types.int64), Laws
)
FORCE_SIGNATURE = types.void(types.float64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, LAWS_TYPE, _VECTOR)
#: Types of the forces that act, as compiled loops take them: addresses (F,), parameters one after the other, ends (F + 1,), laws.
FORCES_TYPES = (types.Array(types.int64, 1, "C"), _VECTOR, types.Array(types.int64, 1, "C"), LAWS_TYPE)


#: Only compiled loops call a force: a wrapper for Python would take half of the compilation.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cpython_wrapper": True}


@once
def compiled_force(force: Callable[..., None]) -> Any:
    """``force`` compiled to the signature that the integrator calls.

    Raises
    ------
    ConfigError : numba cannot compile it.
    """
    try:
        return njit(FORCE_SIGNATURE, **_OPTIONS)(force)
    except Exception as error:
        raise ConfigError(
            "the force law of an effect does not compile",
            value=f"{force.__module__}: {str(error).strip().splitlines()[0] if str(error).strip() else error}",
            allowed="plain arithmetic on numbers and arrays",
            next_step="see docs/how-to/add-an-effect.md",
        ) from error


@once
def _address(force: Callable[..., None]) -> int:
    """Address of the machine code of ``force``, which stays as long as the process; raises as :func:`compiled_force`."""
    compiled = compiled_force(force).get_compile_result(FORCE_SIGNATURE)
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def acting_forces(forces: Sequence[tuple[Any, FloatArray]]) -> tuple[IntArray, FloatArray, IntArray]:
    """Addresses (F,) of forces, their parameters one after the other, and where those of each begin and end (F + 1,).

    Raises
    ------
    ConfigError : as :func:`compiled_force`.
    """
    parameters = [np.asarray(p, dtype=np.float64) for _, p in forces]
    addresses = np.array([_address(force) for force, _ in forces], dtype=np.int64)
    return addresses, np.concatenate([np.zeros(0), *parameters]), np.cumsum([0, *(p.size for p in parameters)])


# An address needs no type of its own for each number of forces, and no look at the function that it belongs to.
def _push(
    typing: Any, address: Any, t: Any, q: Any, qd: Any, u: Any, p: Any, first: Any, end: Any, laws: Any, out: Any
) -> tuple[Any, Callable[..., Any]]:
    """Type and code of a call of the force at ``address`` with the parameters p[first:end]."""

    def generated(target: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer, t, q, qd, u, p, first, end, laws, out = values
        # A slice would count references, which takes longer than most forces.
        own, whole = make_array(_VECTOR)(target, builder), make_array(_VECTOR)(target, builder, p)
        data = builder.gep(whole.data, [first])
        strides = cgutils.unpack_tuple(builder, whole.strides)
        populate_array(own, data, [builder.sub(end, first)], strides, whole.itemsize, None)
        convention = target.call_conv
        kind = convention.get_function_type(types.void, FORCE_SIGNATURE.args).as_pointer()
        given = (t, q, qd, u, own._getvalue(), laws, out)
        code = builder.inttoptr(pointer, kind)
        status, _ = convention.call_function(builder, code, types.void, FORCE_SIGNATURE.args, given)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return target.get_dummy_value()

    motion = (types.float64, _VECTOR, _VECTOR, _VECTOR)
    return types.void(types.int64, *motion, _VECTOR, types.int64, types.int64, LAWS_TYPE, _VECTOR), generated


#: push(address, t, q, qd, u, p, first, end, laws, out) in compiled loops calls the force at an address of ``acting_forces``.
push: Any = intrinsic(_push)


@once
def _each_point() -> Any:
    motion = (_VECTOR, _MATRIX, _MATRIX, _MATRIX)
    signature = types.void(types.int64, *motion, _VECTOR, LAWS_TYPE, _MATRIX)
    return njit(signature, cache=True, error_model="numpy")(_at_each_point)


def _at_each_point(
    address: int,
    t: FloatArray,
    q: FloatArray,
    qd: FloatArray,
    u: FloatArray,
    p: FloatArray,
    laws: Laws,
    out: FloatArray,
) -> None:
    """Add the force at each of m points to ``out`` (m, n); q, qd (m, n), u (m, D)."""
    for i in range(t.size):
        push(address, t[i], q[i], qd[i], u[i], p, 0, p.size, laws, out[i])


class Vectors(list[Any]):
    """Vectors in place of the numbers of an array: what a law indexes, and asks for its size."""

    @property
    def size(self) -> int:
        return len(self)


@dataclass(frozen=True, eq=False)
class Points:
    """m points of a motion: times t (m,) [s], coordinates q (n, m) [V s], velocities qd (n, m) [V], drive u (D, m) [V].

    All of one precision, which is that of the force of a law that takes vectors.
    """

    t: RealArray
    q: RealArray
    qd: RealArray
    u: RealArray

    @cached_property
    def elements(self) -> tuple[Any, Any, Any]:
        """q, qd and u as n, n and D vectors (m,)."""
        return Vectors(self.q), Vectors(self.qd), Vectors(self.u)

    @cached_property
    def single(self) -> Points:
        """The points in single precision."""
        return Points(*(np.asarray(each, dtype=np.float32) for each in (self.t, self.q, self.qd, self.u)))

    def plus(self, q: RealArray, qd: RealArray) -> Points:
        """The points with another motion (n, m) added."""
        return Points(self.t, self.q + q, self.qd + qd, self.u)


def _with_vectors(force: Callable[..., None], points: Points, p: RealArray, laws: Laws, whole: RealArray) -> None:
    """Write the force to ``whole`` (n, m)."""
    out = Vectors([0.0] * points.q.shape[0])
    force(points.t, *points.elements, p, laws, out)
    for own, row in zip(whole, out):
        own[:] = row


@lru_cache(maxsize=256)
def takes_vectors(force: Callable[..., None], parameters: int) -> bool:
    """Whether a law gives the same with vectors in place of numbers: not where it branches or calls ``math``."""
    random = np.random.default_rng(0)
    points = Points(random.random(4), *(random.standard_normal((k, 4)) for k in (3, 3, 2)))
    for each in (points.t, points.q, points.qd, points.u):
        # A law that changes a vector in place would change its input.
        each.flags.writeable = False
    p, matrix = random.random(parameters), random.standard_normal((3, 3))
    laws = Laws(matrix, matrix, random.standard_normal((3, 2)), random.standard_normal((2, 3)), 5.0, 5.0, 2)
    one_by_one = np.zeros((3, 4))
    try:
        together = np.empty((3, 4))
        _with_vectors(force, points, p, laws, together)
        for i, t in enumerate(points.t):
            force(t, points.q[:, i], points.qd[:, i], points.u[:, i], p, laws, one_by_one[:, i])
    except Exception:
        # Numbers and vectors differ in more ways than can be listed; the compiled law is right in any case.
        return False
    return bool(np.allclose(together, one_by_one, rtol=1e-12, atol=0.0))


def force_along(force: Callable[..., None], points: Points, p: FloatArray, laws: Laws) -> FloatArray:
    """The force (n, m) [V/s] at m points of a motion, with parameters p (k,).

    A law that is plain arithmetic takes vectors as it takes numbers, so it needs no compilation; others are compiled.

    Raises
    ------
    ConfigError : as :func:`compiled_force`.
    """
    if takes_vectors(force, p.size):
        whole = np.empty(points.q.shape)
        _with_vectors(force, points, p, laws, whole)
        return whole
    out = np.zeros(points.q.shape[::-1])
    rows = (np.ascontiguousarray(each.T) for each in (points.q, points.qd, points.u))
    _each_point()(_address(force), np.ascontiguousarray(points.t), *rows, p, laws, out)
    return out.T


def in_single(laws: Laws) -> Laws:
    """The laws with matrices in single precision, for :func:`single_force_along`."""
    names = ("damping", "stiffness", "drive", "motion")
    return laws._replace(**{name: getattr(laws, name).astype(np.float32) for name in names})


def single_force_along(force: Callable[..., None], points: Points, p: FloatArray, laws: Laws, out: RealArray) -> None:
    """Write :func:`force_along` to ``out``; all arrays are in single precision, ``laws`` by :func:`in_single`.

    Only for a law that :func:`takes_vectors`; it takes half the time.
    """
    _with_vectors(force, points, p.astype(np.float32), laws, out)
