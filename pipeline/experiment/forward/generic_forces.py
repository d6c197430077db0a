"""Motion of records, and their response to given forces on the coordinates of the plant or volts at the pick-offs.

    q'' + (C + G) q' + K q = f(t),      y = read-out of (V q' + D q)

Motion and forces are taken at the samples.

Shapes: N samples, n coordinates, D drives, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray
from ..instrument import Hold
from .drive_groups import DriveGroup
from .integrate import trajectory
from .linear import SampleClock, linear_response
from .response import Starts, after_readout, force_drive, full_start
from .system import System


@dataclass(frozen=True, eq=False)
class RecordMotion:
    """Motion of one record at its samples.

    Parameters
    ----------
    q, qd : (N, n) [V s], [V] of the coordinates of the plant.
    u : (N, D) [V], the drive as forces see it.
    x, xd : (N, S) [V s], [V], motion of the sense electrodes.
    driven : (N, D) [V s], motion of the drive electrodes.
    t : (N,) [s] from the first sample.
    omega : (n,) [rad/s], sqrt of the diagonal of K.
    axes : nonlinear laws act on the first ``axes`` coordinates.
    """

    q: FloatArray
    qd: FloatArray
    u: FloatArray
    x: FloatArray
    xd: FloatArray
    driven: FloatArray
    t: FloatArray
    omega: FloatArray
    axes: int


def record_motion(system: System, group: DriveGroup, record: int, starts: Starts) -> RecordMotion:
    """Motion of one record of a group under the forces of the system, one step of the integrator per step of the clock.

    Parameters
    ----------
    system, group : the assembled system and its records.
    record : index in the group.
    starts : state (2n,) of each record at its first sample; ``None`` is rest.

    Raises
    ------
    ConfigError : as ``integrate.trajectory``.
    """
    whole, clock, start = system.integrated, group.clock, starts[record]
    u = force_drive(whole, group, record)
    forces = [(effect.force, p) for effect, p in whole.forces]
    state = None if start is None else full_start(whole, start)
    linear, deviation = trajectory(whole.mechanics, forces, whole.laws, u, clock.step_s, clock.hold, state, 1)
    states, u = (linear + deviation)[:: clock.stride], u[:: clock.stride]
    n = whole.mechanics.stiffness.shape[1]
    x, xd = states[:, :n] @ whole.sense_motion.T, states[:, n:] @ whole.sense_motion.T
    # What effects append is sensed by no electrode.
    own = int(np.flatnonzero(np.any(whole.sense_motion, axis=0))[-1]) + 1
    omega = np.sqrt(np.diagonal(whole.mechanics.stiffness[0])[:own])
    t = np.arange(states.shape[0]) / group.sample_rate_hz
    driven = states[:, :n] @ whole.drive_motion.T
    return RecordMotion(states[:, :own], states[:, n : n + own], u, x, xd, driven, t, omega, whole.axes)


class Push(NamedTuple):
    """A part of a force: gain times ``waveform`` (N,) [V/s] on one coordinate of the plant."""

    coordinate: int
    gain: float
    waveform: FloatArray


Force = tuple[Push, ...]


def responses(system: System, group: DriveGroup, forces: Sequence[Force], hold: Hold = "foh") -> FloatArray:
    """Volts (k, N, S) [V] that each of k forces on the coordinates of the plant causes from rest, to first order.

    ``hold`` is that of the forces: "foh" for those that follow the motion, that of the clock for those that follow the drive.
    Forces that hold the same waveform, the same object, share its responses on all coordinates.
    """
    mechanics, clock = system.mechanics, _sampled(group, hold)
    n = mechanics.stiffness.shape[1]
    pushed = replace(mechanics, drive=np.eye(n)[None])
    uses: dict[int, list[tuple[int, Push]]] = {}
    for k, force in enumerate(forces):
        for push in force:
            uses.setdefault(id(push.waveform), []).append((k, push))
    found = np.zeros((len(forces), group.drives[0].shape[0], system.sense_motion.shape[0]))
    for shared in uses.values():
        waveform = shared[0][1].waveform
        if not waveform.any():
            continue
        gains = np.zeros((len(shared), n, 1))
        for row, (_, push) in enumerate(shared):
            gains[row, push.coordinate, 0] = push.gain
        volts = linear_response(pushed, system.readout, waveform[None], gains, clock, feeds=False)
        for (k, _), own in zip(shared, volts):
            found[k] += own
    return found


def read_out(system: System, group: DriveGroup, volts: Sequence[FloatArray]) -> FloatArray:
    """Volts (k, N, S) [V] after the read-out, of k signals (N, S) [V] at the pick-offs."""
    return np.stack([after_readout(system, one, _sampled(group, "foh"), 1) for one in volts])


def _sampled(group: DriveGroup, hold: Hold) -> SampleClock:
    return SampleClock(1.0 / group.sample_rate_hz, hold, 1)
