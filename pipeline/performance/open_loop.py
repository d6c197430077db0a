"""A gyro in open loop: the drive loop holds one rocking mode at a constant amplitude, the other mode is free.

In the stiffness axes (the paper, eq. 2), with psi_d' = a cos(omega0 t), omega0 = omega_d, the free mode obeys

    psi_s'' + c psi_s' + omega_s^2 psi_s = 2 kappa Omega psi_d',      c = 2 zeta_s omega_s

c12 adds a force in phase with psi_d' that does not depend on Omega: a bias, no scale factor.  The electronics blend the pick-offs
with the signs of the electrodes, V = (M_S e)^T S, so that each blend shows one mode if the electrodes are equal:

    V_e = 2 (1 - s sin 2 alpha) psi_e',     e = (cos alpha, sin alpha),     alpha_1 = theta, alpha_2 = theta + 90 deg

from M_S^T diag(1 - s, 1 + s) M_S = 2 (I - s [[0, 1], [1, 0]]).  For a displacement pick-off, psi' in V becomes psi in V.

White noise n on the force 2 kappa Omega psi_d' cos(omega0 t), of one-sided density S_n, adds n / (2 kappa psi_d') in both
sidebands, so the rate has the two-sided density N^2 = S_n / (2 kappa psi_d')^2, and the angle the variance N^2 t: N is the angle
random walk.  The Brownian acceleration of l psi_s has S_n = 4 k_B T c / m, with m = I_0p / l^2; the blend of two pick-offs has
S_n = 2 e^2.

Source: the paper, eq. (2); Leland, Mechanical-thermal noise in MEMS gyroscopes, IEEE Sensors J. 5 (2005) 493; IEEE Std 1431.

Shapes: any, those of the quantities.  Units: rad/s, 1/s, V; psi in V s; l psi, the motion of an electrode, in m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from .operating_point import OperatingPoint

TAU = 2.0 * np.pi
BOLTZMANN_J_PER_K = 1.380649e-23
#: rad/sqrt(s) -> deg/sqrt(h).
DEG_PER_RTH = 60.0 * 180.0 / np.pi


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """An identified gyro at its operating point; ``q`` are the quantities of ``pipeline.quantities`` by name, each (...)."""

    q: Mapping[str, FloatArray]
    point: OperatingPoint

    @property
    def lower_driven(self) -> bool:
        """Whether mode 1 is the driven one."""
        return self.point.drive == "f1"

    @cached_property
    def omega0(self) -> FloatArray:
        """Frequency of the driven mode [rad/s]."""
        return TAU * self.q["f1_hz" if self.lower_driven else "f2_hz"]

    @cached_property
    def omega_s(self) -> FloatArray:
        """Frequency of the free mode [rad/s]."""
        return TAU * self.q["f2_hz" if self.lower_driven else "f1_hz"]

    @cached_property
    def detuning(self) -> FloatArray:
        """(omega_s^2 - omega0^2) / omega0 [rad/s], about twice the split, free of cancellation."""
        sign = 1.0 if self.lower_driven else -1.0
        return sign * TAU * self.q["split_hz"] * (1.0 + self.omega_s / self.omega0)

    @cached_property
    def damping(self) -> FloatArray:
        """c = 2 zeta_s omega_s of the free mode [1/s]."""
        return 2.0 * self.q["zeta2" if self.lower_driven else "zeta1"] * self.omega_s

    @cached_property
    def _shear(self) -> FloatArray:
        return self.q["sense_imbalance"] * np.sin(np.deg2rad(2.0 * self.q["theta_deg"]))

    @cached_property
    def drive_blend(self) -> FloatArray:
        """V_d / psi_d' [1] of the blend that shows the driven mode."""
        return 2.0 * (1.0 - self._shear if self.lower_driven else 1.0 + self._shear)

    @cached_property
    def sense_blend(self) -> FloatArray:
        """V_s / psi_s' [1] of the blend that shows the free mode."""
        return 2.0 * (1.0 + self._shear if self.lower_driven else 1.0 - self._shear)

    @cached_property
    def volts_per_rad_s(self) -> FloatArray:
        """Amplitude of V_s per rate [V/(rad/s)], 2 kappa A (sense / drive blend) / |D - j c|, D the detuning."""
        kappa, amplitude = self.point.angular_gain, self.point.operation.drive_amplitude_v
        assert kappa is not None
        assert amplitude is not None
        gain = 2.0 * kappa * amplitude * self.sense_blend / self.drive_blend
        return np.asarray(gain / np.sqrt(self.detuning**2 + self.damping**2))

    @cached_property
    def gap(self) -> FloatArray:
        """Gap g of the drive electrodes in units of psi [V s].

        The bias lowers omega_r^2 by 2 G_r V_b / g, which declares g: 8 pi^2 f_r V_b^2 times the softening per V^2.
        """
        softening, bias = self.point.operation.softening_hz_per_v2, self.point.bias_v
        assert softening is not None
        assert bias is not None
        rocking_hz = 0.5 * (self.q["f1_hz"] + self.q["f2_hz"])
        return np.asarray(self.q["rocking_gain"] / (TAU**2 * rocking_hz * abs(softening * bias)))

    @cached_property
    def metres(self) -> FloatArray:
        """Motion of an electrode per unit of psi [m/(V s)]."""
        gap_um = self.point.operation.gap_um
        assert gap_um is not None
        return np.asarray(1e-6 * gap_um / self.gap)

    @cached_property
    def drive_velocity(self) -> FloatArray:
        """Amplitude of the velocity of an electrode in the driven mode, l psi_d' [m/s]."""
        amplitude = self.point.operation.drive_amplitude_v
        assert amplitude is not None
        motion = amplitude / self.drive_blend * (self.omega0 if self.point.displacement else 1.0)
        return np.asarray(motion * self.metres)

    @cached_property
    def thermal_rad_per_rts(self) -> FloatArray:
        """Angle random walk by the Brownian force on the free mode, sqrt(k_B T c / m) / (kappa l psi_d') [rad/sqrt(s)]."""
        celsius, mass_mg = self.point.operation.temperature_c, self.point.operation.mass_mg
        kappa = self.point.angular_gain
        assert kappa is not None
        assert celsius is not None
        assert mass_mg is not None
        energy = BOLTZMANN_J_PER_K * (celsius + 273.15)
        return np.asarray(np.sqrt(energy * self.damping / (1e-6 * mass_mg)) / (kappa * self.drive_velocity))

    @cached_property
    def electronic_rad_per_rts(self) -> FloatArray:
        """Angle random walk by the noise e of each pick-off, sqrt(2) e / (V_s per rad/s) [rad/sqrt(s)]."""
        noise = self.point.operation.pickoff_noise_v
        assert noise is not None
        return np.asarray(np.sqrt(2.0) * noise / self.volts_per_rad_s)

    @property
    def bias_v(self) -> float:
        """|V_b| [V]."""
        bias = self.point.bias_v
        assert bias is not None
        return abs(bias)

    @cached_property
    def _compliance_at_bias(self) -> FloatArray:
        """C_b = G_r (K^-1)_yy + G_z / omega3^2 [s], of the stiffness at the bias; both drive electrodes move alike."""
        theta = np.deg2rad(self.q["theta_deg"])
        low, high, updown = ((TAU * self.q[name]) ** 2 for name in ("f1_hz", "f2_hz", "f3_hz"))
        about_y = np.sin(theta) ** 2 / low + np.cos(theta) ** 2 / high
        return np.asarray(self.q["rocking_gain"] * about_y + self.q["updown_gain"] / updown)

    @cached_property
    def stiffening(self) -> FloatArray:
        """1 + 2 C_b V_b / g [1]: stiffness of the springs alone over that at the bias, for this motion."""
        return np.asarray(1.0 + 2.0 * self._compliance_at_bias * self.bias_v / self.gap)

    @cached_property
    def compliance(self) -> FloatArray:
        """C of the springs alone [s]: the motion of both drive electrodes by a force V^2 / (2 V_b) on each is C V^2 / V_b."""
        return np.asarray(self._compliance_at_bias / self.stiffening)

    @cached_property
    def gap_at_rest(self) -> FloatArray:
        """g0 = g + C V_b, the gap without bias, in units of psi [V s]."""
        return np.asarray(self.gap + self.compliance * self.bias_v)
