"""Steady response of a nonlinear device to single tones, by harmonic balance with continuation in the order of the rows.

Numerics of the continuation: ``harmonic_kernels``; residual, derivatives and pick-off: ``harmonic_terms``.

    x' = x - J^-1 R(x; p')          the motion at parameters p' close to p, on the branch of x, to first order

Shapes: N rows, T times of a period, n coordinates, D drives, S senses, m = n (2 H + 1) unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, types

from ...arrays import ComplexArray, FloatArray
from ...device.force_law import FORCES_TYPES, acting_forces
from ...errors import ConfigError
from ...threads import once
from .harmonic_kernels import follow
from .harmonic_terms import SHAPES, TonePoints, force_samples, jacobian_of, linear_state, pickoff_tones, residual_of
from .system import System
from .tones import linear_tones, read_out

#: Newton steps to parameters close by: a quadratic force moves the tone by way of the mean and the second harmonic.
_ITERATIONS = 2

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")
_CUBE = types.Array(types.float64, 3, "C")
_ROWS = (_MATRIX, _MATRIX, _VECTOR, _VECTOR, _CUBE, _MATRIX)


@once
def _compiled() -> Any:
    """``follow`` as machine code, cached on disk."""
    return njit(types.int64(*FORCES_TYPES, *_ROWS), cache=True, nogil=True, error_model="numpy")(follow)


@dataclass(frozen=True, eq=False)
class SteadyMotion:
    """The motion of every row, its system and, where it was asked for, J.

    Parameters
    ----------
    system, points : the device and the rows.
    x : (N, m) [V s], coordinate by coordinate 1, cos, sin, cos 2, ..
    missed : rows without a stable solution.
    """

    system: System
    points: TonePoints
    x: FloatArray
    missed: int = 0

    @property
    def y(self) -> ComplexArray:
        """Y (N, S) [V] behind the read-out."""
        return detected(self.system, self.points, self.x)


def steady_motion(system: System, points: TonePoints) -> SteadyMotion:
    """The motion of every row, followed in the order of the rows where forces are nonlinear.

    Raises
    ------
    ConfigError : no row has a stable solution, or a force law has memories.
    """
    if system.memories:
        # The corners of a hysteresis have harmonics above the third, which cost 0.3 % of the peak.
        raise ConfigError(
            "an effect with a memory is not computed for sweeps and frequency responses",
            value=[effect.name for effect, _ in system.forces if effect.memories],
            next_step="remove it from the model, or use time records",
        )
    if not system.forces:
        return SteadyMotion(system, points, linear_state(system, points))
    x = np.zeros((points.omega.size, system.mechanics.stiffness.shape[1] * SHAPES.shape[0]))
    missed = int(
        _compiled()(
            *acting_forces([(effect.force, p) for effect, p in system.forces]),
            system.laws,
            np.ascontiguousarray(system.mechanics.gyroscopic[0]),
            SHAPES,
            np.ascontiguousarray(points.time_s),
            np.ascontiguousarray(points.omega),
            force_samples(system, points),
            x,
        )
    )
    if missed == points.omega.size or not np.all(np.isfinite(x)):
        raise ConfigError(
            "the motion has no steady state", next_step="check the size and sign of the nonlinear effects"
        )
    return SteadyMotion(system, points, x, missed)


def detected(system: System, points: TonePoints, x: FloatArray) -> ComplexArray:
    """Y (N, S) [V] of a motion x (N, m), behind the read-out."""
    return read_out(system, points.frequency_hz, pickoff_tones(system, points, x), points.drive_v)


def branch(motion: SteadyMotion) -> Callable[[System], ComplexArray]:
    """Y (N, S) [V] of systems with parameters close to those of ``motion``, on its branch; J is that of ``motion``."""
    m = motion.x.shape[1]
    jacobian: list[FloatArray] = []

    def at(system: System) -> ComplexArray:
        if not (system.forces or system.senses or system.drives or motion.system.forces):
            return linear_tones(system, motion.points.frequency_hz, motion.points.drive_v)
        if system.memories or system.mechanics.stiffness.shape[1] * SHAPES.shape[0] != m:
            if any(effect.has_coordinates for effect, _ in system.forces):
                return steady_motion(system, motion.points).y
            # An effect appended a coordinate; it is linear here, so its motion starts from the linear one.
            return detected(system, motion.points, linear_state(system, motion.points))
        if not jacobian:
            jacobian.append(jacobian_of(motion.system, motion.points, motion.x))
        moved = motion.x
        for _ in range(_ITERATIONS):
            left = residual_of(system, motion.points, moved)
            moved = moved - np.linalg.solve(jacobian[0], left[:, :, None])[:, :, 0]
        return detected(system, motion.points, moved)

    return at
