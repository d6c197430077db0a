"""Gains from the up-down mode and the four thetas from the rocking modes, Section 4.2 of the paper.

    M_3 = nu K_S (1, 1)^T (1, 1) K_D,        K_S = diag(1 - s, 1 + s),  K_D = diag(1 - d, 1 + d)         (18)
    Mtilde_i = (K_S M_S)^-1 M_i (M_D K_D)^-1 = sigma_i u_i v_i^T + small
    u_1 = (cos, sin) theta,   u_2 = (-sin, cos) theta,  the same for v; an axis, so modulo 180 deg

Units: degrees; the M_i in 1/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..axial import mean_axis, wrap
from ..device.gyro import M_D, M_S

_M_S_INVERSE, _M_D_INVERSE = np.linalg.inv(M_S), np.linalg.inv(M_D)
_EIGHTH = math.pi / 4.0
#: u_2 = (-sin, cos) theta is (cos, sin) of theta + 90 deg.
_TURN_DEG = np.array([0.0, 0.0, 90.0, 90.0])


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


def _principal(m: FloatArray) -> tuple[float, float, float, float]:
    """Singular values of m (2, 2) and the angles [rad] of its first left and right singular vectors, (cos, sin).

    m = Rot(phi) diag(a + b, a - b) Rot(phi'),   a exp(i (phi + phi')) = (m00 + m11 + i (m10 - m01)) / 2,
    b exp(i (phi - phi')) = (m00 - m11 + i (m10 + m01)) / 2;   Blinn, IEEE Comput. Graph. Appl. 16-2 (1996) 82.
    """
    (m00, m01), (m10, m11) = m.tolist()
    a, b = math.hypot(m00 + m11, m10 - m01) / 2.0, math.hypot(m00 - m11, m10 + m01) / 2.0
    whole, difference = math.atan2(m10 - m01, m00 + m11), math.atan2(m10 + m01, m00 - m11)
    return a + b, abs(a - b), (whole + difference) / 2.0, (difference - whole) / 2.0


def gains_from_updown(M3: FloatArray) -> Gains:
    """Gains from the rank-one part of M_3 (2, 2) [1/s], eq. (18)."""
    first, second, left, right = _principal(M3)
    # (sin a - cos a) / (sin a + cos a) and the mean of (cos a, sin a).
    mean = math.cos(left - _EIGHTH) * math.cos(right - _EIGHTH) / 2.0
    return Gains(
        sense_imbalance=math.tan(left - _EIGHTH),
        drive_imbalance=math.tan(right - _EIGHTH),
        updown_gain=first * mean,
        condition=first / max(second, 1e-300),
    )


def axes(M1: FloatArray, M2: FloatArray, gains: Gains) -> Axes:
    """The four thetas from the rocking modes M_1 (lower), M_2 (upper), both (2, 2) [1/s]; Section 4.2 of the paper."""
    lower, upper = (_principal(_M_S_INVERSE / gains.sense @ (M / gains.drive) @ _M_D_INVERSE) for M in (M1, M2))
    u1, v1, u2, v2 = wrap(np.rad2deg([*lower[2:], *upper[2:]]) - _TURN_DEG).tolist()
    return Axes(u1, v1, u2, v2, singular_values=(lower[:2], upper[:2]))
