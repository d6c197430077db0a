"""State-space matrices of linear mechanics, for control design.

    d/dt (q, q') = A (q, q') + B v,     S = C (q, q')                       continuous
    x[n+1] = Ad x[n] + Bd v[n],         S[n] = C x[n]                       zero-order hold at f_s, exact

States: psi_x, psi_y, z and their rates, scaled so that motion is in V s (mean sense gain 1).  Inputs: drive volts without the
bias.  Outputs: pick-off volts before the anti-alias filter, which is exported separately as (kind, order, corner).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ...arrays import FloatArray
from ..mechanics import Mechanics, state_matrix


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A (2n, 2n), B (2n, D), C (S, 2n), D (S, D); discrete Ad (2n, 2n), Bd (2n, D) for a zero-order hold at f_s [Hz].

    Units: states q [V s] and q' [V], inputs and outputs [V], B [1/s]; the blocks of A and C as in ``device.mechanics``.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    Ad: FloatArray
    Bd: FloatArray
    sample_rate_hz: float


def state_space(mechanics: Mechanics, sample_rate_hz: float) -> StateSpace:
    """State-space matrices of the first device of ``mechanics``.

    Parameters
    ----------
    mechanics : a batch; only its first device is used.
    sample_rate_hz : f_s of the zero-order hold [Hz].
    """
    n, drives = mechanics.drive.shape[1:]
    a = state_matrix(mechanics)[0]
    b = np.concatenate([np.zeros((n, drives)), mechanics.drive[0]])
    c = mechanics.reads[0]
    big = np.zeros((2 * n + drives, 2 * n + drives))
    big[: 2 * n, : 2 * n], big[: 2 * n, 2 * n :] = a, b
    step = expm(big / sample_rate_hz)
    return StateSpace(a, b, c, mechanics.direct[0], step[: 2 * n, : 2 * n], step[: 2 * n, 2 * n :], sample_rate_hz)
