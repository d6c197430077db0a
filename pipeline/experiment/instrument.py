"""The instrument: hold, bias, anti-alias filter and ADC.

    drive samples v[n] --hold--> v(t) --device--> S(t) --anti-alias--> sampled at f_s --ADC--> record

A displacement pick-off is a velocity pick-off whose current a charge amplifier integrates (``AntiAlias.integrates``).
Units: volts, hertz.  The drive samples do not contain the bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Hold = Literal["zoh", "foh", "bandlimited"]
Pickoff = Literal["velocity", "displacement"]
HOLDS: tuple[Hold, ...] = ("zoh", "foh", "bandlimited")


@dataclass(frozen=True)
class AntiAlias:
    """Analog low-pass filter before the ADC, unit gain at zero frequency, -3 dB at ``corner_hz`` [Hz]; order 0 is none.

    ``integrates``: a charge amplifier integrates the current of the pick-off, so that the record is displacement: the filter is
    followed by 1/s, and the gains of the plant are then in 1/s^2.
    """

    kind: Literal["butterworth"] = "butterworth"
    order: int = 8
    corner_hz: float = 4800.0
    integrates: bool = False

    @property
    def table(self) -> dict[str, str | int | float]:
        """The keys of ``antialias = {..}`` in a TOML file; what integrates is stated with the device."""
        return {"kind": self.kind, "order": self.order, "corner_hz": self.corner_hz}


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

    @property
    def pickoff(self) -> Pickoff:
        """What the record is proportional to."""
        return "displacement" if self.antialias is not None and self.antialias.integrates else "velocity"

    def with_pickoff(self, pickoff: Pickoff) -> Instrument:
        """The same instrument with this pick-off."""
        bare = (
            None if self.antialias is None or self.antialias.order == 0 else replace(self.antialias, integrates=False)
        )
        if pickoff == "velocity":
            return replace(self, antialias=bare)
        return replace(self, antialias=replace(bare or AntiAlias(order=0), integrates=True))
