"""Linear read-out, from pick-off volts to the volts at the input of the ADC.

    G(s) = (sum_j Q_j / (s - q_j) + Q_0) exp(-s tau),     S = H(s) u + (R + s C) v,     y = G(s) S

A channel may be later than the others by tau_s.  Drive d acts, in u and in v, behind exp(-s tau_d) / (1 + s T_d).  A sample that
counts as taken at t after the start of the run is taken at (1 - delta) t.

| symbol | field      | shape     | unit |
|---|---|---|---|
| q_j    | poles      | (J,)      | rad/s, all poles, conjugates included |
| Q_j    | residues   | (J, S, S) | rad/s |
| Q_0    | static     | (S, S)    | 1; zero if there is a low-pass |
| tau    | delay_s    |           | s, >= 0 |
| R      | resistive  | (S, D)    | 1 |
| C      | capacitive | (S, D)    | s |
| tau_s  | channel_delay_s | (S,) | s, either sign |
| tau_d  | drive_delay_s | (D,)   | s, either sign |
| T_d    | drive_time_s | (D,)    | s, >= 0 |
| delta  | clock_offset |         | 1 |
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import ComplexArray, FloatArray

#: Least relative distance of two poles: residues lose seven digits, and a pole that is moved changes G by less than 1e-7.
_APART = 1e-7


@dataclass(frozen=True, eq=False)
class Readout:
    """Read-out of one device; symbols, shapes and units at the head of the module."""

    poles: ComplexArray
    residues: ComplexArray
    static: FloatArray
    delay_s: float
    resistive: FloatArray
    capacitive: FloatArray
    channel_delay_s: FloatArray
    drive_delay_s: FloatArray
    drive_time_s: FloatArray
    clock_offset: float = 0.0

    @property
    def differs(self) -> bool:
        """Whether channels or drives have delays and poles of their own."""
        return bool(np.any(self.channel_delay_s) or np.any(self.drive_delay_s) or np.any(self.drive_time_s))

    def path(self, channel: int, drive: int | None) -> Readout:
        """The read-out of one channel and, unless it is ``None``, one drive, without differences."""
        delay, time_s = self.delay_s + self.channel_delay_s[channel], 0.0
        if drive is not None:
            delay, time_s = delay + self.drive_delay_s[drive], float(self.drive_time_s[drive])
        same = replace(
            self,
            delay_s=float(delay),
            channel_delay_s=np.zeros_like(self.channel_delay_s),
            drive_delay_s=np.zeros_like(self.drive_delay_s),
            drive_time_s=np.zeros_like(self.drive_time_s),
        )
        return same if time_s == 0.0 else same.with_pole(-1.0 / time_s)

    def lag(self, s: ComplexArray) -> ComplexArray:
        """exp(-s (tau + tau_s)) (W, S) [1] at complex frequencies ``s`` (W,) [rad/s]."""
        return np.asarray(np.exp(-s[:, None] * (self.delay_s + self.channel_delay_s)))

    def drive_lag(self, s: ComplexArray) -> ComplexArray:
        """exp(-s tau_d) / (1 + s T_d) (W, D) [1] at complex frequencies ``s`` (W,) [rad/s]."""
        return np.asarray(np.exp(-s[:, None] * self.drive_delay_s) / (1.0 + s[:, None] * self.drive_time_s))

    def response(self, s: ComplexArray) -> ComplexArray:
        """G(s) without the delay (W, S, S) [1] at complex frequencies ``s`` (W,) [rad/s]."""
        terms = self.residues[None] / (s[:, None] - self.poles)[:, :, None, None]
        return np.asarray(terms.sum(axis=1) + self.static)

    def through(self, matrix: FloatArray) -> Readout:
        """G(s) matrix: the read-out of pick-offs that a static ``matrix`` (S, S) [1] mixes first."""
        return replace(self, residues=self.residues @ matrix, static=self.static @ matrix)

    def with_pole(self, pole: complex, channel: int | None = None) -> Readout:
        """G(s) / (1 - s / pole) of one ``channel`` or of all: one more ``pole`` [rad/s] with unit gain at zero frequency.

        A pole that is there already is moved by 1e-7 of itself, because partial fractions need different poles.
        """
        near = self.poles[np.abs(self.poles - pole) < _APART * abs(pole)]
        pole = near[-1] * (1.0 + _APART) if near.size else pole
        acts = (
            np.ones(self.static.shape[0], dtype=bool) if channel is None else np.arange(self.static.shape[0]) == channel
        )
        own = self.response(np.array([pole])) * np.where(acts, -pole, 0.0)[:, None]
        lagged = np.where(acts, (pole - self.poles[:, None]) / pole, 1.0)
        return replace(
            self,
            poles=np.append(self.poles, pole),
            residues=np.concatenate([self.residues / lagged[:, :, None], own]),
            static=np.where(acts[:, None], 0.0, self.static),
        )


def plain_readout(poles: ComplexArray, residues: ComplexArray, senses: int, drives: int) -> Readout:
    """The same filter sum_j r_j / (s - q_j) in every channel; ``poles``, ``residues`` (J,) [rad/s]; no filter if J = 0."""
    eye = np.eye(senses)
    static = eye if poles.size == 0 else np.zeros((senses, senses))
    none = np.zeros((senses, drives))
    each, of_drives = np.zeros(senses), np.zeros(drives)
    return Readout(poles, residues[:, None, None] * eye, static, 0.0, none, none, each, of_drives, of_drives)
