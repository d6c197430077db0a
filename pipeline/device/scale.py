"""The scale of a device and its records, to which the ranges, grids and steps of the parameters of effects are relative.

Effects declare numbers for the gyro of the paper: modes near 535 Hz, records of 3 s with some volts, drives of some volts.  For
another device a number with the unit V^a s^b is multiplied by

    volt^a hz^-b            volt, hz: ratios to the gyro of the paper

What V and s mean is declared by ``Parameter.relative_to``:

| relative_to | V                                              | s | for |
|---|---|---|---|
| "motion"    | motion over period, in the unit of q'          | period of the modes | force laws |
| "sense"     | samples of the senses                          | period | clip levels |
| "drive"     | samples of the drives                          | period | clip levels of the drive |
| "transfer"  | the number is proportional to sense over drive | period | gains from drive to sense |
| "record"    | -                                              | duration of the records | drifts |
| "mode"      | -                                              | lowest period of an additional mode | frequency of a mode |
| "absolute"  | the number is not changed                      | - | mains, angular rate |

The ratios are powers of two in wide steps, so that the devices of one kind have the same ranges.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

RelativeTo = Literal["motion", "sense", "drive", "transfer", "record", "mode", "absolute"]
_TOKEN = re.compile(r"(Hz|V|rad|deg|s|1)(?:\^(\d+))?")
#: Frequencies [Hz] of an additional mode in the records of the gyro of the paper, driven from 400 to 700 Hz, 10 kHz.
PAPER_MODES_HZ = (300.0, 1e5)


@dataclass(frozen=True)
class Scale:
    """Ratios to the gyro of the paper.

    Parameters
    ----------
    hz : frequency of the modes.
    motion : motion over period, in the unit of q'.
    sense : samples of the senses.
    transfer : samples of the senses over those of the drives.
    duration : of the records.
    modes_hz : lowest and highest frequency [Hz] of an additional mode.
    """

    hz: float = 1.0
    motion: float = 1.0
    sense: float = 1.0
    transfer: float = 1.0
    duration: float = 1.0
    modes_hz: tuple[float, float] = PAPER_MODES_HZ

    def factor(self, unit: str, relative_to: RelativeTo) -> float:
        """The factor of a number with this ``unit``."""
        if relative_to == "absolute":
            return 1.0
        if relative_to == "mode":
            return self.modes_hz[0] / PAPER_MODES_HZ[0]
        volts, seconds = _exponents(unit)
        if relative_to == "record":
            return float(self.duration**seconds)
        gain = self.transfer if relative_to == "transfer" else 1.0
        volt = {"motion": self.motion, "drive": self.sense / self.transfer}.get(relative_to, self.sense)
        return float(gain * volt**volts * self.hz**-seconds)


PAPER = Scale()


@lru_cache(maxsize=256)
def _exponents(unit: str) -> tuple[int, int]:
    """Exponents of V and of s in a unit such as "1/(V^2 s^4)"; other units count as numbers."""
    volts = seconds = 0
    for part, sign in zip(unit.partition("/")[::2], (1, -1)):
        for name, power in _TOKEN.findall(part):
            exponent = sign * int(power or 1)
            volts += exponent if name == "V" else 0
            seconds += exponent if name == "s" else -exponent if name == "Hz" else 0
    return volts, seconds
