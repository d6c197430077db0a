"""Gains from the up-down mode and the four thetas from the rocking modes, Section 4.2 of the paper.

    M_3 = nu K_S (1, 1)^T (1, 1) K_D,        K_S = diag(1 - s, 1 + s),  K_D = diag(1 - d, 1 + d)         (18)
    Mtilde_i = (K_S M_S)^-1 M_i (M_D K_D)^-1 = sigma_i u_i v_i^T + small
    u_1 = (cos, sin) theta,   u_2 = (-sin, cos) theta,  the same for v; an axis, so modulo 180 deg

Units: degrees; the M_i in 1/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..axial import mean_axis, wrap
from ..device.gyro import M_D, M_S


@dataclass(frozen=True)
class Gains:
    """sense_imbalance (K_S2 - K_S1)/(K_S2 + K_S1), drive_imbalance likewise; nu = updown_gain [1/s].

    condition : first over second singular value of M_3; large for a pure translation.
    """

    sense_imbalance: float
    drive_imbalance: float
    updown_gain: float
    condition: float

    @property
    def sense(self) -> FloatArray:
        """Diagonal (2,) of K_S [1], mean 1."""
        return np.array([1.0 - self.sense_imbalance, 1.0 + self.sense_imbalance])

    @property
    def drive(self) -> FloatArray:
        """Diagonal (2,) of K_D [1], mean 1."""
        return np.array([1.0 - self.drive_imbalance, 1.0 + self.drive_imbalance])


@dataclass(frozen=True)
class Axes:
    """Four estimates of theta [deg] in (-90, 90]; singular values [1/s] and conditions of Mtilde_1, Mtilde_2."""

    theta_u1_deg: float
    theta_v1_deg: float
    theta_u2_deg: float
    theta_v2_deg: float
    singular_values: tuple[tuple[float, float], tuple[float, float]]

    @property
    def conditions(self) -> tuple[float, float]:
        """First over second singular value; large for a mode that rocks about one axis."""
        (a, b), (c, d) = self.singular_values
        return a / max(b, 1e-300), c / max(d, 1e-300)

    @property
    def theta_deg(self) -> FloatArray:
        """u1, v1, u2, v2 (4,) [deg]."""
        return np.array([self.theta_u1_deg, self.theta_v1_deg, self.theta_u2_deg, self.theta_v2_deg])

    @property
    def mean_deg(self) -> float:
        """Axial mean of the four: half the angle of sum exp(2 i theta) [deg], in (-90, 90]."""
        return mean_axis(self.theta_deg)


def gains_from_updown(M3: FloatArray) -> Gains:
    """Gains from the rank-one part of M_3 (2, 2) [1/s], eq. (18)."""
    u, size, vt = np.linalg.svd(M3)
    sense, drive = u[:, 0], vt[0]
    return Gains(
        sense_imbalance=float((sense[1] - sense[0]) / (sense[1] + sense[0])),
        drive_imbalance=float((drive[1] - drive[0]) / (drive[1] + drive[0])),
        updown_gain=float(size[0] * sense.mean() * drive.mean()),
        condition=float(size[0] / max(size[1], 1e-300)),
    )


def axes(M1: FloatArray, M2: FloatArray, gains: Gains) -> Axes:
    """The four thetas from the rocking modes M_1 (lower), M_2 (upper), both (2, 2) [1/s]; Section 4.2 of the paper."""
    left = np.linalg.inv(gains.sense[:, None] * M_S)
    right = np.linalg.inv(M_D * gains.drive)
    u, size, vt = np.linalg.svd(left @ np.stack([M1, M2]) @ right)
    angles = np.rad2deg(
        [
            np.arctan2(u[0, 1, 0], u[0, 0, 0]),
            np.arctan2(vt[0, 0, 1], vt[0, 0, 0]),
            np.arctan2(-u[1, 0, 0], u[1, 1, 0]),
            np.arctan2(-vt[1, 0, 0], vt[1, 0, 1]),
        ]
    )
    u1, v1, u2, v2 = (float(wrap(angle)) for angle in angles)
    return Axes(
        u1,
        v1,
        u2,
        v2,
        singular_values=((float(size[0, 0]), float(size[0, 1])), (float(size[1, 0]), float(size[1, 1]))),
    )
