"""The motion that forces leave at the end of a record (``linear``), of several devices at once.

    q(T) = 2 Re sum_k U_k e_k,   q'(T) = 2 Re sum_k p_k U_k e_k,   e_k = sum_n e^{p_k (T - t_n)} f(t_n) dt

Of f(t) = Re{a(t) e^{i w0 t}} only the part that turns with the pole counts: e^{i w0 t} = e^{i w0 T} e^{-i w0 (T - t)}.

All arithmetic acts on each device alone, so a device has the numbers that it has alone, bit for bit.

Shapes: B devices, K forces, R envelopes, 3 modes and coordinates, n points of the grid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, IntArray, RealArray
from .force_loops import end_sums
from .linear import LinearDevice
from .narrow_band import Grid


def ringing(devices: Sequence[LinearDevice], grid: Grid, envelopes: AnyComplexArray, rows: IntArray) -> RealArray:
    """f_s [q'(T) + (C + D) q(T)] and f_s q(T) (B, K, 3, 2) [V/s], C the damping and D the gyroscopic matrix.

    In units of the grid and in single precision.

    Parameters
    ----------
    envelopes : (B, >= R, n) [V/s] in single precision.
    rows : (K, 3) which of the envelopes a force has on each coordinate; -1 where it has none.
    """
    span = grid.band.samples / grid.band.sample_rate_hz
    poles = np.stack([device.poles for device in devices])
    # One more for the coordinates on which a force does not act.
    ends = np.zeros((len(devices), 3, int(rows.max(initial=-1)) + 2), dtype=np.complex64)
    end_sums(envelopes, *grid.decays(poles - 1j * grid.omega), ends[:, :, :-1])
    turned = (0.5 * span / grid.points) * np.exp(1j * grid.omega * span)
    parts: ComplexArray = np.stack([device.parts for device in devices]) * turned
    modal = ends[:, :, rows] @ parts.swapaxes(2, 3)
    place = 2.0 * modal.real.sum(axis=1)
    velocity = 2.0 * (modal * poles[:, :, None, None]).real.sum(axis=1)
    rates = np.stack([device.mechanics.damping[0] + device.mechanics.gyroscopic[0] for device in devices])
    scale = grid.band.sample_rate_hz / grid.bin_scale
    return np.asarray(np.stack([velocity + place @ rates.swapaxes(1, 2), place], axis=3) * scale, dtype=np.float32)
