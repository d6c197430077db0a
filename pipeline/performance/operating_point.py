"""How a gyro is operated, as far as its records cannot show it: what the owner of the device declares.

A key that is not declared is ``None``; figures that need it are then unknown, and ``Figure.missing`` names the key.
``bias_v`` and ``angular_gain`` come from [instrument] and [device], the others from [operation].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..arrays import FloatArray


@dataclass(frozen=True)
class DeclaredOperation:
    """What [operation] declares.

    Parameters
    ----------
    drive_amplitude_v : amplitude A [V] of the driven mode in the blend of pick-offs that shows it; S1 + S2 for rocking about y.
    pickoff_noise_v : noise of each pick-off at the drive frequency, one-sided [V/sqrt(Hz)], one number or (...); not declared:
        that of the silent record, where there is one.
    softening_hz_per_v2 : shift of the rocking modes by the bias on both drive electrodes [Hz/V^2], negative.
    gap_um : gap of the drive electrodes at the bias [um].
    mass_mg : effective mass of rocking at an electrode, I_0p / l^2 [mg].
    temperature_c : of the device in operation [degC].
    damping_ppm_per_c : temperature coefficient of the damping rates [ppm/K].
    shock_ms : duration of a half-sine shock along z [ms].
    """

    drive_amplitude_v: float | None = None
    pickoff_noise_v: float | FloatArray | None = None
    softening_hz_per_v2: float | None = None
    gap_um: float | None = None
    mass_mg: float | None = None
    temperature_c: float | None = None
    damping_ppm_per_c: float | None = None
    shock_ms: float | None = None


#: Nothing is declared.
UNDECLARED = DeclaredOperation()


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """All that the figures need beside the identified quantities.

    Parameters
    ----------
    operation : the [operation] table.
    angular_gain : kappa = I_p / I_0p [1], one number or (...); ``None``: unknown.
    bias_v : bias of the drive electrodes during the identification [V]; ``None``: unknown.
    drive : the mode that is driven.
    displacement : whether the pick-offs sense displacement; gains are then in 1/s^2.
    tcf_ppm_per_c : temperature coefficient of the mode frequencies [ppm/K].
    """

    operation: DeclaredOperation = UNDECLARED
    angular_gain: float | FloatArray | None = None
    bias_v: float | None = None
    drive: Literal["f1", "f2"] = "f1"
    displacement: bool = False
    tcf_ppm_per_c: float = 0.0

    def declared(self, key: str) -> bool:
        """Whether a key of ``Figure.needs`` is known."""
        owner = self if key in ("angular_gain", "bias_v") else self.operation
        return getattr(owner, key) is not None
