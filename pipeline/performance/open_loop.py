"""A gyro in open loop: the drive loop holds one rocking mode at a constant amplitude, the other mode is free.

In the stiffness axes (the paper, eq. 2), with psi_d' = a cos(omega0 t), omega0 = omega_d, the free mode obeys

    psi_s'' + c psi_s' + omega_s^2 psi_s = 2 kappa Omega psi_d',      c = 2 zeta_s omega_s

c12 adds a force in phase with psi_d' that does not depend on Omega: a bias, no scale factor.  The electronics blend the pick-offs
with the signs of the electrodes, V = (M_S e)^T S, so that each blend shows one mode if the electrodes are equal:

    V_e = 2 (1 - s sin 2 alpha) psi_e',     e = (cos alpha, sin alpha),     alpha_1 = theta, alpha_2 = theta + 90 deg

from M_S^T diag(1 - s, 1 + s) M_S = 2 (I - s [[0, 1], [1, 0]]).  For a displacement pick-off, psi' in V becomes psi in V.

Shapes: any, those of the quantities.  Units: rad/s, 1/s, V; psi in V s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from .operating_point import OperatingPoint

TAU = 2.0 * np.pi


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
        return np.asarray(gain / np.hypot(self.detuning, self.damping))
