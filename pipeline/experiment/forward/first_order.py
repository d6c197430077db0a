"""Response to weak forces, to first order along the linear motion that all of them share.

    d' = A d + (0, a(t, x_l, u)),      r = (V, D) d + (sense effects)

Coordinates that a force law appends, and that the linear motion does not move, follow their forces along x_l in full: a hidden
mode that is driven by the motion, or the memory of a hysteresis.

Shapes: R records, N samples, M grid points of the integrator, S senses, n coordinates of the linear motion, m appended ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...device.force_law import Laws, acting_forces
from ...device.mechanics import Mechanics
from .compiled import compiled_first_order
from .drive_groups import DriveGroup
from .integrate import Forces, Motion, appended_half, between_samples, forces_alone_move
from .response import after_readout, for_distinct_records, force_volts_along, pickoff_rows, sense_effect_volts
from .system import System


def first_order_response(system: System, group: DriveGroup, motions: Sequence[Motion]) -> FloatArray:
    """As ``nonlinear_response`` (R, N, S) [V], to first order in the force and sense effects.

    ``motions`` are the linear trajectories of the records (``linear_motions``), of a system to which ``system`` appends at most
    coordinates that :func:`is_first_order` allows.
    """
    system = system.integrated
    n = system.mechanics.stiffness.shape[1]

    def one(record: int) -> FloatArray:
        motion = motions[record]
        known = np.arange(motion.steps.coordinates)
        reads = pickoff_rows(system)[:, np.concatenate([known, n + known])]
        r = np.zeros((motion.states.shape[0] // 2 + 1, reads.shape[0]))
        if system.forces:
            forces = [(effect.force, p) for effect, p in system.forces]
            r += perturbed_motion(motion, system.mechanics, forces, system.laws, reads)
            if system.mechanics.senses_acceleration:
                u = between_samples(motion.drive, motion.steps.substeps, motion.steps.sloped)
                r += force_volts_along(system, motion.state, u, group.clock.step_s / motion.steps.substeps)
        if system.senses:
            r += sense_effect_volts(system, motion.state, motion.drive, group.clock, motion.steps.substeps)
        return after_readout(system, r, group.clock, motion.steps.substeps)

    source = [next(k for k, other in enumerate(motions) if other is motion) for motion in motions]
    return np.stack(for_distinct_records(one, source, group.threads))


def is_first_order(system: System, base: System) -> bool:
    """Whether :func:`first_order_response` of ``system`` holds along motions of ``base``.

    It does unless the system appends coordinates that more than its forces move, or whose forces or motion are sensed.
    """
    if system.integrated.mechanics.stiffness.shape == base.mechanics.stiffness.shape:
        return True
    sensed = bool(system.senses) or system.mechanics.senses_acceleration
    return not sensed and only_forces_move(system.integrated.mechanics, base.mechanics)


def perturbed_motion(motion: Motion, mechanics: Mechanics, forces: Forces, laws: Laws, reads: FloatArray) -> FloatArray:
    """Volts (M, S) [V] at the pick-offs due to the deviation that ``forces`` cause along ``motion``, to first order.

    Parameters
    ----------
    motion : the linear motion of the first n coordinates.
    mechanics : a batch of one, of these and of appended coordinates that only the forces move (:func:`only_forces_move`).
    forces, laws : as in ``trajectory``.
    reads : (S, 2 n) pick-off volts from a state of the first n coordinates.
    """
    steps = motion.steps
    taps = steps.padded(reads / steps.factors)
    deviation = np.empty((motion.states.shape[0] // 2 + 1, taps.shape[0]))
    appended, beside = appended_half(mechanics, steps)
    compiled_first_order(steps.half_size, beside.shape[0] // 2)(
        (0,) * steps.half_size,
        (0,) * (beside.shape[0] // 2),
        *acting_forces(forces),
        laws,
        steps.half,
        steps.half @ steps.half,
        beside,
        1.0 / steps.scale,
        steps.step_s,
        steps.substeps,
        steps.coordinates,
        appended,
        motion.drive,
        steps.sloped,
        motion.states,
        taps,
        deviation,
    )
    return deviation


def only_forces_move(larger: Mechanics, mechanics: Mechanics) -> bool:
    """Whether what ``larger`` appends to ``mechanics`` (batches of one) moves by forces alone, and is not sensed."""
    n = mechanics.stiffness.shape[1]
    pairs = (
        (larger.stiffness[0], mechanics.stiffness[0]),
        (larger.damping[0], mechanics.damping[0]),
        (larger.gyroscopic[0], mechanics.gyroscopic[0]),
    )
    same = all(np.array_equal(matrix[:n, :n], one) for matrix, one in pairs)
    return same and forces_alone_move(larger, n, larger.reads[0])
