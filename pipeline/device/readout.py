"""Linear read-out, from pick-off volts to the volts at the input of the ADC.

    G(s) = (sum_j Q_j / (s - q_j) + Q_0) exp(-s tau),     S = H(s) u + (R + s C) v,     y = G(s) S

| symbol | field      | shape     | unit |
|---|---|---|---|
| q_j    | poles      | (J,)      | rad/s, all poles, conjugates included |
| Q_j    | residues   | (J, S, S) | rad/s |
| Q_0    | static     | (S, S)    | 1; zero if there is a low-pass |
| tau    | delay_s    |           | s, >= 0 |
| R      | resistive  | (S, D)    | 1 |
| C      | capacitive | (S, D)    | s |
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Readout:
    """Read-out of one device; symbols, shapes and units at the head of the module."""

    poles: ComplexArray
    residues: ComplexArray
    static: FloatArray
    delay_s: float
    resistive: FloatArray
    capacitive: FloatArray

    def response(self, s: ComplexArray) -> ComplexArray:
        """G(s) without the delay (W, S, S) [1] at complex frequencies ``s`` (W,) [rad/s]."""
        terms = self.residues[None] / (s[:, None] - self.poles)[:, :, None, None]
        return np.asarray(terms.sum(axis=1) + self.static)

    def through(self, matrix: FloatArray) -> Readout:
        """G(s) matrix: the read-out of pick-offs that a static ``matrix`` (S, S) [1] mixes first."""
        return replace(self, residues=self.residues @ matrix, static=self.static @ matrix)

    def with_pole(self, pole: complex) -> Readout:
        """G(s) / (1 - s / pole): one more ``pole`` [rad/s] with unit gain at zero frequency."""
        own = self.response(np.array([pole])) * -pole
        others = self.residues / (1.0 - self.poles / pole)[:, None, None]
        return replace(
            self,
            poles=np.append(self.poles, pole),
            residues=np.concatenate([others, own]),
            static=np.zeros_like(self.static),
        )


def plain_readout(poles: ComplexArray, residues: ComplexArray, senses: int, drives: int) -> Readout:
    """The same filter sum_j r_j / (s - q_j) in every channel; ``poles``, ``residues`` (J,) [rad/s]; no filter if J = 0."""
    eye = np.eye(senses)
    static = eye if poles.size == 0 else np.zeros((senses, senses))
    none = np.zeros((senses, drives))
    return Readout(poles, residues[:, None, None] * eye, static, 0.0, none, none)
