"""Force laws: the compiled stage of an effect, called by the integrator at every step.

    force(t, q, qd, u, p, laws, out): adds an acceleration (n,) [V/s] to ``out``

at time t [s], coordinates q (n,) [V s], velocities qd (n,) [V], drive samples u (D,) [V], parameters p (k,).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.core.errors import NumbaExperimentalFeatureWarning

from ..arrays import FloatArray, RealArray
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
            next_step="see docs/how-to/add-an-effect.md",
        ) from error


@cache
def _each_point() -> Any:
    motion = (_VECTOR, _MATRIX, _MATRIX, _MATRIX)
    signature = types.void(types.UniTuple(FORCE_TYPE, 1), *motion, _VECTOR, LAWS_TYPE, _MATRIX)
    return njit(signature, cache=True, error_model="numpy")(_at_each_point)


def _at_each_point(
    law: Any,
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
        law[0](t[i], q[i], qd[i], u[i], p, laws, out[i])


class _Vectors(list[Any]):
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
        return _Vectors(self.q), _Vectors(self.qd), _Vectors(self.u)

    @cached_property
    def single(self) -> Points:
        """The points in single precision."""
        return Points(*(np.asarray(each, dtype=np.float32) for each in (self.t, self.q, self.qd, self.u)))

    def plus(self, q: RealArray, qd: RealArray) -> Points:
        """The points with another motion (n, m) added."""
        return Points(self.t, self.q + q, self.qd + qd, self.u)


def _with_vectors(force: Callable[..., None], points: Points, p: RealArray, laws: Laws, whole: RealArray) -> None:
    """Write the force to ``whole`` (n, m)."""
    out = _Vectors([0.0] * points.q.shape[0])
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
    _each_point()((compiled_force(force),), np.ascontiguousarray(points.t), *rows, p, laws, out)
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
