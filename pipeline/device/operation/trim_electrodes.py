"""Trim electrode pairs: azimuths, gains, and the uncertainty of the gains.

    k_e = 4 pi omega |s|   [(rad/s)^2 / V^2],      s = d f / d(V^2) of a rocking mode along the pair [Hz/V^2]

Shapes: E electrode pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...errors import ConfigError
from ..gyro import TAU


@dataclass(frozen=True)
class Electrodes:
    """Trim electrode pairs.

    azimuth_deg : beta_e (E,) [deg], modulo 180.
    gain_per_v2 : k_e (E,) [(rad/s)^2 / V^2], see :func:`gain_per_v2`.
    gain_sd : relative sd of each k_e.
    most_v : V_max [V].

    Raises
    ------
    ConfigError : lists of different lengths, no pair, or a value out of range.
    """

    azimuth_deg: tuple[float, ...]
    gain_per_v2: tuple[float, ...]
    gain_sd: float = 0.05
    most_v: float = 15.0

    def __post_init__(self) -> None:
        if not self.azimuth_deg or len(self.azimuth_deg) != len(self.gain_per_v2):
            raise ConfigError(
                "trim electrodes need an azimuth and a gain each",
                value=(self.azimuth_deg, self.gain_per_v2),
                allowed="two lists of the same length, one or more",
            )
        if not (np.all(np.isfinite(self.azimuth_deg)) and np.all(np.isfinite(self.gain_per_v2))):
            raise ConfigError("trim electrodes must be finite numbers", value=(self.azimuth_deg, self.gain_per_v2))
        if min(self.gain_per_v2) <= 0.0:
            raise ConfigError("trim gains must be positive", value=self.gain_per_v2, allowed="> 0 (rad/s)^2/V^2")
        if not 0.0 <= self.gain_sd < 1.0:
            raise ConfigError("relative sd of the trim gains", value=self.gain_sd, allowed="[0, 1)")
        if not 0.0 < self.most_v < float("inf"):
            raise ConfigError("the limit of the trim voltages must be positive", value=self.most_v, allowed="> 0 V")

    def directions(self) -> ComplexArray:
        """exp(2 i beta_e) (E,) [1], exact if 2 beta is a multiple of 90 deg."""
        turns = np.mod(np.array(self.azimuth_deg) / 45.0, 4.0)
        whole = np.array([1.0, 1j, -1.0, -1j])[np.round(turns).astype(int) % 4]
        return np.asarray(np.where(turns == np.round(turns), whole, np.exp(0.5j * np.pi * turns)))

    def draw_gains(self, random: np.random.Generator, count: int) -> FloatArray:
        """Ratios of true to nominal gain (count, E) [1]: lognormal with mean 1 and relative sd ``gain_sd``."""
        spread = np.sqrt(np.log1p(self.gain_sd**2))
        return np.asarray(np.exp(spread * random.standard_normal((count, len(self.azimuth_deg))) - spread**2 / 2.0))


def gain_per_v2(softening_hz_per_v2: float, rocking_hz: float) -> float:
    """k_e = 4 pi omega |s| [(rad/s)^2 / V^2] of a pair with softening s [Hz/V^2] on a mode at ``rocking_hz`` [Hz].

    s = -0.03 Hz/V^2 follows from A = 4 mm^2, g = 10 um (assumed).
    """
    return 2.0 * TAU * TAU * rocking_hz * abs(softening_hz_per_v2)


def standard_electrodes(
    azimuth_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0),
    softening_hz_per_v2: float = -0.03,
    rocking_hz: float = 535.5,
    gain_sd: float = 0.05,
    most_v: float = 15.0,
) -> Electrodes:
    """Equal pairs at ``azimuth_deg`` [deg]; four pairs 45 deg apart can correct every anisotropy.

    Raises
    ------
    ConfigError : as in :class:`Electrodes`.
    """
    gain = gain_per_v2(softening_hz_per_v2, rocking_hz)
    return Electrodes(azimuth_deg, (gain,) * len(azimuth_deg), gain_sd, most_v)
