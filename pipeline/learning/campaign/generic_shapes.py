"""Generic shapes of what a model may lack, in families of few degrees of freedom; none of them is ever named.

A test of 10^4 rows does not see 10 sigmas that lie in one direction.  The families hold the directions in which almost any
missing physics leaves something, to first order along the fitted motion (q, q', u drive, x motion of a sense electrode):

    elastic 3, 4    forces -dV/dq of V = q_i^m q_j^(k - m), k = 3, 4, for each pair of axes
    stiffness       |a|^m q_i, m = -1, 1, 4;   damping  |a|^m q_i', m = -1, 1, 2;   |a|^2 = sum over axes of q^2 w^2 + q'^2
    viscous         q_j' on each coordinate i
    drive           u_k^2, and u_k x_k at each drive electrode, on each coordinate: electrostatic forces of second order
    slow            t^m q_i, t^m q_i', m = 1, 2: frequency and damping that change along the record
    pick-off        x x', x^2 x' in each channel: a gap that is not constant
    path            u_k, and u_k one sample later, in each channel: drive that reaches the read-out directly

The powers m = -1, 1, 2, 4 are those of dry friction, of drag, of a cubic force and of a contact.  Sources: describing functions,
Gelb and Vander Velde (1968); correlation of the residual with past drive, Ljung, System Identification (1999), section 16.6.

Shapes: N samples, n coordinates, S senses, k columns of a family.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ...arrays import FloatArray
from ...experiment.forward.generic_forces import Force, Push, RecordMotion


def force_families(motion: RecordMotion) -> dict[str, list[Force]]:
    """Forces that follow the motion, by family.  Their unit does not matter, but it is the same in all records."""
    q, qd = motion.q * motion.omega, motion.qd
    axes, every = range(motion.axes), range(motion.q.shape[1])
    squares = np.sum(q[:, : motion.axes] ** 2 + qd[:, : motion.axes] ** 2, axis=1)
    # |q_i| <= |a|, so |a|^-1 q_i stays finite; at rest it is zero.
    amplitude = np.maximum(np.sqrt(squares), np.finfo(float).tiny)
    power = {m: amplitude**m for m in (-1, 1, 2, 4)}
    velocity = [np.ascontiguousarray(qd[:, j]) for j in every]
    time = {m: motion.t**m for m in (1, 2)}
    return {
        "elastic force of third order": _potentials(q, axes, 3),
        "elastic force of fourth order": _potentials(q, axes, 4),
        "stiffness that follows the amplitude": [_on(i, power[m] * q[:, i]) for m in (-1, 1, 4) for i in axes],
        "damping that follows the amplitude": [_on(i, power[m] * qd[:, i]) for m in (-1, 1, 2) for i in axes],
        "viscous coupling": [_on(i, velocity[j]) for i in every for j in every],
        "slow change": [_on(i, time[m] * s[:, i]) for m in (1, 2) for s in (q, qd) for i in every],
    }


def drive_families(motion: RecordMotion) -> dict[str, list[Force]]:
    """Forces that follow the drive, by family, in the same unit in all records."""
    every = range(motion.q.shape[1])
    squares = [v * v for v in motion.u.T]
    pulls = [v * x for v, x in zip(motion.u.T, motion.driven.T)]
    return {
        "force of the squared drive": [_on(i, v) for i in every for v in squares],
        "force of drive times motion": [_on(i, v) for i in every for v in pulls],
    }


def volt_families(motion: RecordMotion) -> dict[str, list[FloatArray]]:
    """Volts (N, S) at the pick-offs by family, each in one channel.  Their unit is the same in all records."""
    x, xd, u = motion.x, motion.xd, motion.u
    later, every = np.concatenate([u[:1], u[:-1]]), range(x.shape[1])
    return {
        "pick-off with a gap that changes": [_in(s, x[:, s] ** m * xd[:, s], xd) for m in (1, 2) for s in every],
        "drive in the read-out": [_in(s, v, xd) for drive in (u, later) for v in drive.T for s in every],
    }


def _potentials(q: FloatArray, axes: range, order: int) -> list[Force]:
    """-dV/dq of V = q_i^m q_j^(order - m)."""
    forces: list[Force] = []
    own = {i: q[:, i] ** (order - 1) for i in axes}
    forces += [_on(i, own[i]) for i in axes]
    for i, j in combinations(axes, 2):
        # q_i^m q_j^(order - 1 - m)
        mixed = [own[j], *(q[:, i] ** m * q[:, j] ** (order - 1 - m) for m in range(1, order - 1)), own[i]]
        for m in range(1, order):
            forces.append((Push(i, m, mixed[m - 1]), Push(j, order - m, mixed[m])))
    return forces


def _on(coordinate: int, waveform: FloatArray) -> Force:
    """``waveform`` (N,) on one coordinate."""
    return (Push(coordinate, 1.0, waveform),)


def _in(place: int, values: FloatArray, like: FloatArray) -> FloatArray:
    """``values`` (N,) in one column of zeros like (N, n)."""
    out = np.zeros_like(like)
    out[:, place] = values
    return out
