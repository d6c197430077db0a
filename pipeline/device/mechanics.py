"""Linear mechanics of a device and its modes.

    q'' + (C + G) q' + K q = F u + a,      S = A q'' + V q' + D q                       (mass-normalised)

                                        = (V - A (C + G)) q' + (D - A K) q + A F u + A a

q (n,) coordinates [V s], u (D,) drive volts, a (n,) nonlinear forces [V/s], S (S,) pick-off volts before the filter; every
array has a leading batch axis B.

| symbol | field              | shape     | unit |
|---|---|---|---|
| C      | damping            | (B, n, n) | 1/s, symmetric |
| G      | gyroscopic         | (B, n, n) | 1/s, antisymmetric |
| K      | stiffness          | (B, n, n) | 1/s^2, symmetric |
| F      | drive              | (B, n, D) | 1/s (q in V s) |
| V      | velocity_sense     | (B, S, n) | 1 |
| D      | position_sense     | (B, S, n) | 1/s |
| A      | acceleration_sense | (B, S, n) | s |

As modes:   H(s) = sum_k R_k / (s - p_k) + conj + A F,   Im p_k > 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from ..arrays import ComplexArray, FloatArray
from ..errors import ConfigError

_ABSENT: FloatArray = np.zeros((1, 1, 1))
_ABSENT.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Mechanics:
    """Mass-normalised second-order mechanics of a batch of devices; symbols, shapes and units at the head of the module.

    ``acceleration_sense`` that is not given is zero.
    """

    damping: FloatArray
    gyroscopic: FloatArray
    stiffness: FloatArray
    drive: FloatArray
    velocity_sense: FloatArray
    position_sense: FloatArray
    acceleration_sense: FloatArray = field(default_factory=lambda: _ABSENT)

    def __post_init__(self) -> None:
        if self.acceleration_sense is _ABSENT:
            object.__setattr__(self, "acceleration_sense", np.zeros_like(self.velocity_sense))

    def of(self, device: int) -> Mechanics:
        """The mechanics of one device, a batch of one."""
        own = slice(device, device + 1)
        return Mechanics(*(getattr(self, name)[own] for name in _ARRAYS))

    @property
    def senses_acceleration(self) -> bool:
        """Whether a pick-off senses acceleration."""
        return bool(np.any(self.acceleration_sense))

    @property
    def derivative(self) -> int:
        """Order of the derivative of the motion that the pick-offs sense."""
        return 2 if self.senses_acceleration else 0 if np.any(self.position_sense) else 1

    @property
    def reads(self) -> FloatArray:
        """[D - A K, V - A (C + G)] (B, S, 2n): pick-off volts from a state (q, q'), without drive and forces."""
        position, velocity = self.position_sense, self.velocity_sense
        if self.senses_acceleration:
            position = position - self.acceleration_sense @ self.stiffness
            velocity = velocity - self.acceleration_sense @ (self.damping + self.gyroscopic)
        return np.concatenate([position, velocity], axis=-1)

    @property
    def direct(self) -> FloatArray:
        """A F (B, S, D) [1]: pick-off volts that follow the drive at once."""
        return np.asarray(self.acceleration_sense @ self.drive)


_ARRAYS = tuple(own.name for own in fields(Mechanics))


@dataclass(frozen=True, eq=False)
class Modes:
    """H(s) = sum_k R_k / (s - p_k) + conj + direct: poles (B, n) [rad/s], Im p > 0, residues (B, n, S, D) [rad/s], (B, S, D)."""

    poles: ComplexArray
    residues: ComplexArray
    direct: FloatArray = field(default_factory=lambda: _ABSENT)

    def response(self, s: ComplexArray) -> ComplexArray:
        """H(s) (B, S, D, W) [1], from drive to pick-off volts, at complex frequencies ``s`` (W,) [rad/s]."""
        p = self.poles[:, :, None, None, None]
        r = self.residues[..., None]
        found = np.sum(r / (s - p) + np.conj(r) / (s - np.conj(p)), axis=1)
        return found + self.direct[..., None] if np.any(self.direct) else found


def state_matrix(mechanics: Mechanics) -> FloatArray:
    """A = [[0, I], [-K, -(C + G)]] (B, 2n, 2n) in d/dt (q, q') = A (q, q') + ...; q [V s], q' [V]."""
    stiffness = mechanics.stiffness
    batch, n, _ = stiffness.shape
    a = np.zeros((batch, 2 * n, 2 * n))
    a[:, :n, n:] = np.eye(n)
    a[:, n:, :n] = -stiffness
    a[:, n:, n:] = -(mechanics.damping + mechanics.gyroscopic)
    return a


def widened(mechanics: Mechanics, n: int) -> Mechanics:
    """``mechanics`` with free coordinates without damping, stiffness, drive and sense appended, ``n`` in all."""
    more = (0, n - mechanics.stiffness.shape[1])

    def wider(name: str) -> FloatArray:
        rows, columns = (0, 0) if name.endswith("_sense") else more, (0, 0) if name == "drive" else more
        return np.pad(getattr(mechanics, name), ((0, 0), rows, columns))

    return Mechanics(*(wider(f.name) for f in fields(Mechanics)))


def modes_of(mechanics: Mechanics) -> Modes:
    """R_k = (A p_k^2 + V p_k + D) x_k (y_k F): poles and residues of ``mechanics`` by the eigenvectors of its state matrix.

    x_k is the position half of the right eigenvector, y_k the velocity half of the left one.

    Raises
    ------
    ConfigError : a mode does not oscillate (overdamped or unstable), so it has no frequency.
    """
    n = mechanics.stiffness.shape[-1]
    poles, right = np.linalg.eig(state_matrix(mechanics))
    oscillating = np.sum(poles.imag > 0.0, axis=-1)
    if np.any(oscillating != n):
        raise ConfigError(
            "a mode does not oscillate",
            value=int(np.argmax(oscillating != n)),
            allowed="positive definite stiffness and damping ratios below 1",
            next_step="check frequencies and damping of this device",
        )
    left = np.linalg.inv(right)
    # Ascending frequency, so that a mode has the same index in all devices of the batch.
    order = np.argsort(np.where(poles.imag > 0.0, poles.imag, np.inf), axis=-1)[:, :n]
    poles = np.take_along_axis(poles, order, axis=-1)
    x = np.take_along_axis(right[:, :n, :], order[:, None, :], axis=-1)
    y = np.take_along_axis(left[:, :, n:], order[:, :, None], axis=1)
    sensed = np.einsum("bsn,bnk->bks", mechanics.velocity_sense, x) * poles[:, :, None]
    sensed = sensed + np.einsum("bsn,bnk->bks", mechanics.position_sense, x)
    if mechanics.senses_acceleration:
        sensed = sensed + np.einsum("bsn,bnk->bks", mechanics.acceleration_sense, x) * poles[:, :, None] ** 2
    driven = np.einsum("bkn,bnd->bkd", y, mechanics.drive)
    return Modes(poles, sensed[:, :, :, None] * driven[:, :, None, :], mechanics.direct)
