"""Loop over the samples of a record: the motion that forces cause along a known linear motion, to first order.

Conventions are those of ``kernels``.
"""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray, IntArray
from ...device.force_law import Laws, push
from .kernels import read_taps, summed


def first_order_deviation(
    shape: tuple[int, ...],
    more: tuple[int, ...],
    forces: IntArray,
    p: FloatArray,
    ends: IntArray,
    laws: Laws,
    half: FloatArray,
    whole: FloatArray,
    beside: FloatArray,
    inverse: float,
    step_s: float,
    substeps: int,
    n: int,
    m: int,
    drive: FloatArray,
    sloped: bool,
    states: FloatArray,
    taps: FloatArray,
    deviation: FloatArray,
) -> None:
    """Fill ``deviation`` (M, T), the taps of the motion [V] that forces cause, to first order in the forces.

    The forces k1 .. k4 act along the known linear ``states`` (2M - 1, 2H), at the start, middle (twice) and end of a substep:

        d <- E^2 d + h/6 (E^2 k1 + 2 E (k2 + k3) + k4)

    Beside the n known coordinates, m others that the linear motion does not move follow their own forces by Lawson-RK4.
    Without them k3 is k2, and k1 is k4 of the substep before (Simpson's rule).

    Parameters
    ----------
    shape, more : tuples of H and of W zeros, m <= W.
    forces, p, ends, laws, half, inverse, step_s, substeps, drive, sloped, taps : as in ``kernels.deviation_from_linear``.
    whole, beside : E^2, and E (2W, 2W) of the others.
    n, m : numbers of known coordinates and of the others, which follow them in the forces.
    """
    half_size, wide = len(shape), len(more)
    size, double = 2 * half_size, 2 * wide
    drives = drive.shape[1]
    h = step_s / substeps
    sixth = h * (1.0 / 6.0)
    # The compiler knows W, and leaves out what is not needed without others.
    middle, last_middle = (2.0 * sixth, 2) if wide > 0 else (4.0 * sixth, 1)
    q, qd, out, u, slope = np.empty(n + m), np.empty(n + m), np.zeros(n + m), np.empty(drives), np.empty(drives)
    # The deviation, with the force at the start of a substep, and the response to the forces in its middle.
    impulse, d, grown = np.empty((1, half_size)), np.empty((2, size)), np.empty((1, size))
    # Of the others: forces k1 .. k3; motion at the start, middle and end of a substep without the forces since its start; what
    # k1 and k3 grow to in half a substep.
    k, free, own = np.zeros((3, wide)), np.zeros((3, double)), np.zeros((2, double))
    for i in range(size):
        d[0, i] = 0.0
    for i in range(half_size):
        impulse[0, i] = 0.0
    read_taps(size, taps, d, 0, deviation, 0)
    for sample in range(drive.shape[0] - 1):
        for j in range(drives):
            slope[j] = (drive[sample + 1, j] - drive[sample, j]) / step_s if sloped else 0.0
        for sub in range(substeps):
            point = sample * substeps + sub
            t = laws.elapsed_s + sample * step_s + sub * h
            for stage in range(4):
                if stage == 2 and wide == 0:
                    continue
                node = (stage + 1) // 2
                if wide > 0:
                    if stage == 1 or stage == 3:
                        summed(double, beside, 0, double, free, node - 1, free, node)
                        summed(double, beside, wide, wide, k, stage - 1, own, node - 1)
                        for i in range(m):
                            q[n + i] = (free[node, i] + 0.5 * node * h * own[node - 1, i]) * inverse
                            qd[n + i] = free[node, wide + i] + 0.5 * node * h * own[node - 1, wide + i]
                    else:
                        for i in range(m):
                            q[n + i], qd[n + i] = free[node, i] * inverse, free[node, wide + i]
                            if stage == 2:
                                qd[n + i] += 0.5 * h * k[1, i]
                # The forces at the end of the last substep are reused, unless a held drive has jumped since.
                if wide > 0 or stage > 0 or sub == 0:
                    for i in range(n):
                        q[i], qd[i] = states[2 * point + node, i] * inverse, states[2 * point + node, half_size + i]
                    for i in range(n + m):
                        out[i] = 0.0
                    for j in range(drives):
                        u[j] = drive[sample, j] + slope[j] * (sub + 0.5 * node) * h
                    for f in range(forces.size):
                        push(forces[f], t + 0.5 * node * h, q, qd, u, p, ends[f], ends[f + 1], laws, out)
                if wide > 0 and stage < 3:
                    for i in range(m):
                        k[stage, i] = out[n + i]
                if stage == 1 or stage == 2:
                    for i in range(n):
                        impulse[0, i] = middle * out[i] + (impulse[0, i] if stage == 2 else 0.0)
                    if stage < last_middle:
                        continue
                    summed(size, half, half_size, half_size, impulse, 0, grown, 0)
                    for i in range(size):
                        d[0, i] += grown[0, i]
                    continue
                for i in range(n):
                    d[0, half_size + i] += sixth * out[i]
                if stage == 0:
                    for i in range(size):
                        d[1, i] = d[0, i]
                    summed(size, whole, 0, size, d, 1, d, 0)
            if wide > 0:
                for i in range(m):
                    own[0, wide + i] += 2.0 * (k[1, i] + k[2, i])
                summed(double, beside, 0, double, own, 0, own, 1)
                for i in range(double):
                    free[0, i] = free[2, i] + sixth * own[1, i]
                for i in range(m):
                    free[0, wide + i] += sixth * out[n + i]
            read_taps(size, taps, d, 0, deviation, point + 1)
