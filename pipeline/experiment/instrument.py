"""The instrument: hold, bias, anti-alias filter and ADC.

    drive samples v[n] --hold--> v(t) --device--> S(t) --anti-alias--> sampled at f_s --ADC--> record

Units: volts, hertz.  The drive samples do not contain the bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Hold = Literal["zoh", "foh", "bandlimited"]
HOLDS: tuple[Hold, ...] = ("zoh", "foh", "bandlimited")


@dataclass(frozen=True)
class AntiAlias:
    """Analog low-pass filter before the ADC, unit gain at zero frequency, -3 dB at ``corner_hz`` [Hz]."""

    kind: Literal["butterworth"] = "butterworth"
    order: int = 8
    corner_hz: float = 4800.0


@dataclass(frozen=True)
class Adc:
    """Mid-tread ADC of ``bits`` bits over +- ``full_scale_v`` [V]."""

    bits: int = 16
    full_scale_v: float = 10.0

    @property
    def lsb_v(self) -> float:
        """LSB = 2 full_scale / 2^bits [V]."""
        return 2.0 * self.full_scale_v / 2.0**self.bits


@dataclass(frozen=True)
class Instrument:
    """Everything between the drive samples and the record except the device.

    hold : how drive samples become volts between samples ("zoh", "foh", "bandlimited"); antialias, adc : ``None`` is none.
    sample_rate_hz : f_s [Hz]; bias_v : bias of the electrodes [V].
    """

    sample_rate_hz: float = 10_000.0
    hold: Hold = "zoh"
    bias_v: float = 5.0
    antialias: AntiAlias | None = None
    adc: Adc | None = None
