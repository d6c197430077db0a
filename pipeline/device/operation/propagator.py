"""Propagator of the rocking plant under modulated torques over one step of the controller.

    psi'' + (C + 2 kappa Omega J) psi' + K psi = Re(W exp(j omega t)),    J = [[0, -1], [1, 0]]    (the paper, eq. 1)

The complex torques W, Omega and omega are constant over a step T.  With the modulated torques p + j q = W exp(j omega t) as
states,

    d/dt (psi, psi', p, q) = (A0 + a E1 + b E2) (psi, psi', p, q),   a = 2 kappa Omega,   b = omega - omega_c

and exp(T (A0 + a E1 + b E2)) is needed at every step for new values of a and b.  It is expanded to second order in (a T, b T),
which stay below 1e-2; the truncation error is 1e-5 of the effect of rate and detuning (1e-7 where these are below 1e-3).  The
coefficients are exact: a and b are replaced by commuting nilpotent matrices of the algebra R[a, b] / (degree > 2), so that one
matrix exponential gives all six.

State (psi_x, psi_y, psi_x', psi_y', p_x, p_y, q_x, q_y).  Shapes: B devices.  Units: psi in V s, torques in V/s.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from ...arrays import FloatArray

#: Monomials 1, a, b, a^2, a b, b^2, in the order of the coefficients.
_MONOMIALS: tuple[tuple[int, int], ...] = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
_J: FloatArray = np.array([[0.0, -1.0], [1.0, 0.0]])


def _multiplication(a: int, b: int) -> FloatArray:
    """Matrix (6, 6) of the multiplication by a^i b^j in the algebra, with exponents ``a`` and ``b``."""
    out = np.zeros((6, 6))
    for column, (i, j) in enumerate(_MONOMIALS):
        if (i + a, j + b) in _MONOMIALS:
            out[_MONOMIALS.index((i + a, j + b)), column] = 1.0
    return out


def propagators(damping: FloatArray, stiffness: FloatArray, carrier: FloatArray, step_s: float) -> FloatArray:
    """(psi, psi') after a step = sum_m a^i b^j P_m (psi, psi', p, q): the coefficients P_m (B, 6, 4, 8) [units of the states].

    Parameters
    ----------
    damping : C (B, 2, 2) [1/s].
    stiffness : K (B, 2, 2) [1/s^2].
    carrier : omega_c (B,) [rad/s].
    step_s : T [s].
    """
    eye = np.eye(2)
    rate, detuning = np.zeros((8, 8)), np.zeros((8, 8))
    rate[2:4, 2:4] = -_J
    detuning[4:6, 6:8], detuning[6:8, 4:6] = -eye, eye
    plain = np.zeros((damping.shape[0], 8, 8))
    plain[:, :2, 2:4] = eye
    plain[:, 2:4, :2] = -stiffness
    plain[:, 2:4, 2:4] = -damping
    plain[:, 2:4, 4:6] = eye
    plain += carrier[:, None, None] * detuning
    changing = np.kron(_multiplication(1, 0), rate) + np.kron(_multiplication(0, 1), detuning)
    whole = expm(step_s * (np.stack([np.kron(np.eye(6), one) for one in plain]) + changing))
    # The first block column holds the coefficients of the six monomials.
    return np.ascontiguousarray(whole.reshape(-1, 6, 8, 6, 8)[:, :, :4, 0, :])
