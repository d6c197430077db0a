"""State space of an ARX model, its Hankel singular values and balanced truncation.

    x(t+1) = a x(t) + b u(t),   y(t) = c x(t) + d u(t)
    P = a P a^T + b b^T,   Q = a^T Q a + c^T c,   sigma_k = sqrt(eig_k(P Q))

With P = L_p L_p^T, Q = L_q L_q^T and L_q^T L_p = U diag(sigma) V^T, the states T^-1 x with
T = L_p V diag(sigma)^-1/2 are balanced (square-root method: P Q is never formed), and keeping the first r of them
leaves |H - H_r|_inf <= 2 sum_{k>r} sigma_k.

Source: Green & Limebeer 1995; Laub et al. 1987.  Shapes: S senses, D drives, K = n S states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from ..arrays import ComplexArray, FloatArray
from .arx import ArxModel
from .failure import IdentificationError
from .modes import DiscreteModes


@dataclass(frozen=True, eq=False)
class DiscreteStateSpace:
    """Discrete model: a (K, K), b (K, D), c (S, K), d (S, D); inputs and outputs in [V]."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray


@dataclass(frozen=True, eq=False)
class Balanced:
    """A balanced realisation, states by descending Hankel singular value (K,) [1]."""

    hankel: FloatArray
    system: DiscreteStateSpace


def state_space_of(model: ArxModel) -> DiscreteStateSpace:
    """Observer form of the ARX model: the states are the contributions of past samples to y(t), y(t+1), .., y(t+n-1)."""
    order, senses, _ = model.A.shape
    size = order * senses
    a = np.zeros((size, size))
    a[:, :senses] = -model.A.reshape(size, senses)
    a[:-senses, senses:] = np.eye(size - senses)
    b = (model.B[1:] - model.A @ model.B[0]).reshape(size, -1)
    return DiscreteStateSpace(a, b, np.eye(senses, size), model.B[0])


def _gramian_root(a: FloatArray, b: FloatArray) -> FloatArray:
    """L with L L^T = P = a P a^T + b b^T; negative eigenvalues from rounding are set to zero."""
    gramian = np.asarray(solve_discrete_lyapunov(a, b @ b.T), dtype=np.float64)
    size, vectors = np.linalg.eigh((gramian + gramian.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(size, 0.0)))


def balance(system: DiscreteStateSpace) -> Balanced:
    """Hankel singular values, and the realisation in which each belongs to one state.

    States with a singular value below 1e-13 of the largest are rounding errors and are left out.

    Raises
    ------
    IdentificationError : the model is not stable, so that the Gramians do not exist.
    """
    worst = float(np.abs(np.linalg.eigvals(system.a)).max())
    if not worst < 1.0:
        raise IdentificationError(
            "an unstable ARX model has no Hankel singular values",
            value=f"largest pole modulus {worst:.6f}",
            allowed="below 1",
            next_step="use modal truncation, a larger ridge or a lower order",
        )
    l_p = _gramian_root(system.a, system.b)
    l_q = _gramian_root(system.a.T, system.c.T)
    u, sigma, vt = np.linalg.svd(l_q.T @ l_p)
    kept = int(np.count_nonzero(sigma > 1e-13 * sigma[0]))
    scale = 1.0 / np.sqrt(sigma[:kept])
    into, out_of = l_p @ vt[:kept].T * scale, scale[:, None] * (u[:, :kept].T @ l_q.T)
    balanced = DiscreteStateSpace(out_of @ system.a @ into, out_of @ system.b, system.c @ into, system.d)
    return Balanced(sigma, balanced)


def truncate(balanced: Balanced, states: int) -> DiscreteStateSpace:
    """The first ``states`` balanced states.

    Raises
    ------
    IdentificationError : the model has fewer states than that.
    """
    have = balanced.system.a.shape[0]
    if not 1 <= states <= have:
        raise IdentificationError(
            "the model cannot be truncated to this many states",
            value=states,
            allowed=f"1 to {have}",
            next_step="ask for fewer states",
        )
    s = balanced.system
    return DiscreteStateSpace(s.a[:states, :states], s.b[:states], s.c[:, :states], s.d)


def modes_of_states(system: DiscreteStateSpace) -> DiscreteModes:
    """Oscillating modes (Im z > 0) of a state space by its eigenvectors:  R_k = (c x_k)(y_k b)."""
    poles, right = np.linalg.eig(system.a)
    left = np.linalg.inv(right)
    upper = np.flatnonzero(poles.imag > 0.0)
    upper = upper[np.argsort(np.angle(poles[upper]))]
    residues = np.einsum("sk,kd->ksd", system.c @ right[:, upper], left[upper] @ system.b)
    return DiscreteModes(np.asarray(poles[upper], dtype=np.complex128), residues.astype(np.complex128))


def frequency_response(
    model: ArxModel | DiscreteStateSpace, frequency_hz: FloatArray, sample_rate_hz: float
) -> ComplexArray:
    """H(e^{jwT}) (F, S, D) [1] at the frequencies (F,) [Hz]."""
    z = np.exp(2j * np.pi * frequency_hz / sample_rate_hz)
    if isinstance(model, ArxModel):
        powers = z[:, None] ** -np.arange(model.order + 1)
        left = np.eye(model.A.shape[1]) + np.tensordot(powers[:, 1:], model.A, axes=1)
        return np.asarray(np.linalg.solve(left, np.tensordot(powers, model.B, axes=1)))
    identity = np.eye(model.a.shape[0])
    states = np.linalg.solve(z[:, None, None] * identity - model.a, model.b.astype(np.complex128))
    return np.asarray(model.c @ states + model.d)
