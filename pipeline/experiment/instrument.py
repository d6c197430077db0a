"""The instrument: hold, bias, anti-alias filter and converter.

    drive samples v[n] --hold--> v(t) --device--> S(t) --anti-alias--> sampled at f_s --ADC--> record

Units: volts, hertz.  The bias is not in the drive samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Hold = Literal["zoh", "foh", "bandlimited"]
HOLDS: tuple[Hold, ...] = ("zoh", "foh", "bandlimited")


@dataclass(frozen=True)
class AntiAlias:
    """Analog low-pass in front of the converter; unit gain at zero frequency."""

    kind: Literal["butterworth"] = "butterworth"
    order: int = 8
    corner_hz: float = 4800.0


@dataclass(frozen=True)
class Adc:
    """Mid-tread converter of ``bits`` bits over +- ``full_scale_v`` volts."""

    bits: int = 16
    full_scale_v: float = 10.0

    @property
    def lsb_v(self) -> float:
        """LSB = 2 full_scale / 2^bits, in volts."""
        return 2.0 * self.full_scale_v / 2.0**self.bits


@dataclass(frozen=True)
class Instrument:
    """Everything between the drive samples and the record that is not the device."""

    sample_rate_hz: float = 10_000.0
    hold: Hold = "zoh"
    bias_v: float = 5.0
    antialias: AntiAlias | None = None
    adc: Adc | None = None
