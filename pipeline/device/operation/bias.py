"""Rate biases of a force-rebalanced gyro (the paper, eq. 3 to 6, with the misprints below corrected).

With psi_y' = A cos(omega0 t) held by the drive loop and psi_x held at zero, the rebalance torque over the inertia is

    tau_rb / I = 1/2 (w1^2 - w2^2) sin 2theta psi_y + [1/2 (c11 - c22) sin 2theta + c12 cos 2theta - 2 kappa Omega] psi_y'

Demodulated with cos(omega0 t + phi) and divided by its own response to rate, -kappa cos(phi) A, it indicates at Omega = 0

    quadrature_bias = Omega_Q tan phi,      Omega_Q = (w1^2 - w2^2) sin 2theta / (4 kappa omega0)
    inphase_bias    = -[1/2 (c11 - c22) sin 2theta + c12 cos 2theta] / (2 kappa)

The equations follow from (2).  The paper prints 1/2 c12 cos 2theta in (4) to (6) and A/2 instead of A^2/2 in (6), and omits the
factor 2 before kappa Omega in (5).  kappa = I_p / I_0p is the angular gain.  Shapes: any, broadcast.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...arrays import FloatArray, by_column
from ...axial import double_angle
from ...errors import ConfigError


def rate_biases_dps(
    physical: FloatArray,
    angular_gain: float | FloatArray,
    phase_error_deg: float | FloatArray,
    drive: Literal["f1", "f2"],
) -> dict[str, FloatArray]:
    """quadrature_rate_dps, quadrature_bias_dps, inphase_bias_dps, rate_bias_dps, each (...) [deg/s]; eq. (4) to (6).

    Parameters
    ----------
    physical : (..., 12), the columns of ``pipeline.device.gyro.PHYSICAL``.
    angular_gain, phase_error_deg : kappa and demodulation phase error phi [deg], broadcast against (...).
    drive : the mode that sets omega0.

    Raises
    ------
    ConfigError : the angular gain is not positive, or |phi| >= 90 deg.
    """
    if np.any(np.asarray(angular_gain) <= 0.0):
        raise ConfigError("angular gain must be positive", value=angular_gain, allowed="I_p / I_0p in (0, 1]")
    if np.any(np.abs(phase_error_deg) >= 90.0):
        raise ConfigError("demodulation phase error too large", value=phase_error_deg, allowed="(-90, 90) deg")
    f1, f2, _, zeta1, zeta2, _, theta_deg, c12 = by_column(physical)[:8]
    omega1, omega2 = 2.0 * np.pi * f1, 2.0 * np.pi * f2
    omega0 = omega1 if drive == "f1" else omega2
    cos, sin = double_angle(theta_deg)
    quadrature = (omega1 - omega2) * (omega1 + omega2) * sin / (4.0 * angular_gain * omega0)
    delta = zeta1 * omega1 - zeta2 * omega2
    inphase = -(delta * sin + c12 * cos) / (2.0 * angular_gain)
    leaked = quadrature * np.tan(np.deg2rad(phase_error_deg))
    return {
        "quadrature_rate_dps": np.rad2deg(quadrature),
        "quadrature_bias_dps": np.rad2deg(leaked),
        "inphase_bias_dps": np.rad2deg(inphase),
        "rate_bias_dps": np.rad2deg(leaked + inphase),
    }
