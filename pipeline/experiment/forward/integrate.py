"""Motion under forces that are not linear or not constant in time, on a grid finer than the samples.

    q'' + (C + G) q' + K q = F u(t) + a(t, q, q', u)

The linear trajectory x_l under the held drive is exact (matrix exponential); what is integrated is the deviation d from it,

    d' = A d + (0, a(t, x_l + d, u))

by Lawson-RK4 with the exact exponential of A, ``SUBSTEPS`` steps a sample: no cancellation, and the kinks of the held
drive stay in the exact part.  Its remainder in volts, r = (V, D) d + (sense laws), is smooth between samples: the read-out
(``readout_filter``) sees it as the polynomial through the ``SUBSTEPS`` + 1 values of each sample interval.

A force that is so weak that only its first order counts is summed along the linear trajectory, which serves for all such
forces.

Shapes: N samples, M = (N - 1) SUBSTEPS + 1 grid points, n coordinates, D drives, S senses.  State (2n,): (q, q').
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from ...arrays import FloatArray, IntArray
from ...device.effect import Laws, compiled_force
from ...device.mechanics import Mechanics, state_matrix
from ...errors import ConfigError
from ..instrument import Hold
from .kernels import MOST_FORCES, along_of, march_of, states_of

SUBSTEPS = 4

#: Force laws (as effects have them) and their parameters (k,).
Forces = Sequence[tuple[Any, FloatArray]]


def _no_force(
    t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray
) -> None:
    return


@dataclass(frozen=True, eq=False)
class Steps:
    """Propagators of a system over half a substep, as the compiled loops take them.

    A state is (scale q, 0, q', 0) of size 2H: ``unit`` (2n,) scales (q, q'), ``place`` (2n,) is where each goes.
    ``half`` (2H, 2H) of the state, ``held`` and ``ramp`` (D, 2H) of a drive and its slope, transposed.
    """

    step_s: float
    substeps: int
    sloped: bool
    half_size: int
    scale: float
    unit: FloatArray
    place: IntArray
    half: FloatArray
    held: FloatArray
    ramp: FloatArray

    @property
    def coordinates(self) -> int:
        """n."""
        return self.unit.size // 2

    def placed(self, rows: FloatArray) -> FloatArray:
        """(r, 2n) -> (r, 2H)."""
        out = np.zeros((rows.shape[0], 2 * self.half_size))
        out[:, self.place] = rows
        return out

    def begun(self, start: FloatArray | None) -> FloatArray:
        """A state (2n,), or rest, as the loops take it."""
        return self.placed((np.zeros_like(self.unit) if start is None else start * self.unit)[None])[0]


def steps_of(mechanics: Mechanics, step_s: float, hold: Hold, substeps: int) -> Steps:
    """Exact propagators of ``mechanics`` (a batch of one) under samples that are ``step_s`` apart."""
    a = state_matrix(mechanics)[0]
    n, drives = mechanics.drive.shape[1:]
    # In (omega q, q') the exponential is of a matrix of even size: no digits are lost.
    scale = float(np.sqrt(np.mean(np.diagonal(mechanics.stiffness[0]))))
    unit = np.concatenate([np.full(n, scale), np.ones(n)])
    grown = np.zeros((2 * n + 2 * drives, 2 * n + 2 * drives))
    grown[: 2 * n, : 2 * n] = a * unit[:, None] / unit
    grown[n : 2 * n, 2 * n : 2 * n + drives] = mechanics.drive[0]
    grown[2 * n : 2 * n + drives, 2 * n + drives :] = np.eye(drives)
    moved = expm(grown * (0.5 * step_s / substeps))
    half_size = n if n <= 4 else 1 << (n - 1).bit_length()
    place = np.concatenate([np.arange(n), half_size + np.arange(n)])
    rows = np.zeros((2 * n + 2 * drives, 2 * half_size))
    rows[:, place] = moved[: 2 * n].T
    half = np.zeros((2 * half_size, 2 * half_size))
    half[place] = rows[: 2 * n]
    held, ramp = rows[2 * n : 2 * n + drives].copy(), rows[2 * n + drives :].copy()
    return Steps(step_s, substeps, hold != "zoh", half_size, scale, unit, place, half, held, ramp)


def _compiled(forces: Forces) -> tuple[Any, int, Any]:
    if len(forces) > MOST_FORCES:
        raise ConfigError("too many forces at once", value=len(forces), allowed=f"at most {MOST_FORCES}")
    padding = MOST_FORCES - len(forces)
    return (
        tuple([compiled_force(force) for force, _ in forces] + [compiled_force(_no_force)] * padding),
        len(forces),
        tuple([np.ascontiguousarray(p, dtype=np.float64) for _, p in forces] + [np.zeros(1)] * padding),
    )


def trajectory(
    mechanics: Mechanics,
    forces: Forces,
    laws: Laws,
    drive: FloatArray,
    step_s: float,
    hold: Hold,
    start: FloatArray | None,
    substeps: int = SUBSTEPS,
    reads: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Linear trajectory and deviation from it, both (M, 2n), under ``drive`` (N, D).

    Parameters
    ----------
    mechanics : a batch of one.
    forces : force laws and their parameters.
    laws : what force laws may use.
    drive : volts that make force.
    step_s : time between samples [s].
    hold : "zoh" or "foh".
    start : state (2n,) at the first sample; ``None`` is rest.
    reads : (S, 2n), where only what it reads off the deviation is wanted: then (0, S) and (M, S).

    Raises
    ------
    ConfigError : more than ``MOST_FORCES`` forces, or a motion that diverges.
    """
    steps = steps_of(mechanics, step_s, hold, substeps)
    points = (drive.shape[0] - 1) * substeps + 1
    taps = steps.placed((np.eye(steps.unit.size) if reads is None else reads) / steps.unit)
    linear = np.empty((points if reads is None else 0, taps.shape[0]))
    deviation = np.empty((points, taps.shape[0]))
    march_of(steps.half_size)(
        (0,) * steps.half_size,
        *_compiled(forces),
        laws,
        steps.half,
        steps.held,
        steps.ramp,
        steps.scale,
        step_s,
        substeps,
        steps.coordinates,
        np.ascontiguousarray(drive),
        steps.sloped,
        steps.begun(start),
        taps,
        linear,
        deviation,
    )
    if not np.isfinite(deviation[-1]).all():
        raise ConfigError("the motion diverges", next_step="check size and sign of the nonlinear effects")
    return linear, deviation


@dataclass(frozen=True, eq=False)
class Motion:
    """A linear trajectory: its steps, the drive (N, D), and its scaled states (2M - 1, 2H) at half substeps."""

    steps: Steps
    drive: FloatArray
    states: FloatArray

    @property
    def state(self) -> FloatArray:
        """(M, 2n) at the grid points."""
        return np.asarray(self.states[::2, self.steps.place] / self.steps.unit)


def linear_motion(
    mechanics: Mechanics, drive: FloatArray, step_s: float, hold: Hold, start: FloatArray | None, substeps: int
) -> Motion:
    """The linear trajectory, for ``pushed``; arguments as in ``trajectory``."""
    steps = steps_of(mechanics, step_s, hold, substeps)
    u = np.ascontiguousarray(drive)
    states = np.empty((2 * (u.shape[0] - 1) * substeps + 1, 2 * steps.half_size))
    states_of(steps.half_size)(
        (0,) * steps.half_size,
        steps.half,
        steps.held,
        steps.ramp,
        step_s,
        substeps,
        u,
        steps.sloped,
        steps.begun(start),
        states,
    )
    return Motion(steps, u, states)


def perturbed_motion(motion: Motion, forces: Forces, laws: Laws, reads: FloatArray) -> FloatArray:
    """What ``reads`` (S, 2n) read off the deviation that weak forces make, to first order in them, (M, S).

    Raises
    ------
    ConfigError : more than ``MOST_FORCES`` forces.
    """
    steps = motion.steps
    taps = steps.placed(reads / steps.unit)
    deviation = np.empty((motion.states.shape[0] // 2 + 1, taps.shape[0]))
    along_of(steps.half_size)(
        (0,) * steps.half_size,
        *_compiled(forces),
        laws,
        steps.half,
        steps.half @ steps.half,
        steps.scale,
        steps.step_s,
        steps.substeps,
        steps.coordinates,
        motion.drive,
        steps.sloped,
        motion.states,
        taps,
        deviation,
    )
    return deviation
