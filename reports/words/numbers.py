"""Numbers as people write them, in plain text: 1.0684e11 +- 5.5e8, 534.5012 +- 0.0031, 3.167e-4.

The sd has two significant digits, and the value as many decimals.  Powers of ten stand where zeros would: from 10^6, below 10^-3,
and where more than seven decimals would follow a number below 0.01.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

UNKNOWN = "unknown"
_VOLTS = (("V", 1.0), ("mV", 1e3), ("µV", 1e6), ("nV", 1e9))


def number(value: float | None, digits: int = 4) -> str:
    """A number with at most ``digits`` significant digits, or all before the decimal point; "unknown" for none."""
    if value is None or math.isnan(value):
        return UNKNOWN
    if value == 0.0 or math.isinf(value):
        return f"{value:.0f}"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= exponent < 6:
        text = f"{value:.{max(digits - 1 - exponent, 0)}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    return _power(value, digits - 1, strip=True)


def volts(values: Sequence[float]) -> str:
    """Voltages [V] with three digits and a common prefix, by which the largest lies between 1 and 1000: "12.4, 19.4 mV"."""
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    unit, factor = next((one for one in _VOLTS if largest * one[1] >= 1.0), _VOLTS[-1] if largest > 0.0 else _VOLTS[0])
    scaled = [factor * value for value in values]
    texts = [number(one, 3) if one == 0.0 or abs(one) < 1e-3 else f"{one:#.3g}".rstrip(".") for one in scaled]
    return f"{', '.join(texts)} {unit}"


def rounded(value: float, sd: float | None) -> str:
    """``value`` with as many decimals as two significant digits of its sd have."""
    if not math.isfinite(value):
        return UNKNOWN
    if sd is None or not (math.isfinite(sd) and sd > 0.0):
        return number(value, 6)
    decimals = 1 - math.floor(math.log10(float(f"{sd:.1e}")))
    if _as_power(value, sd, decimals):
        size = abs(value) or sd
        return _power(value, max(math.floor(math.log10(size)) + decimals, 0))
    # More than fifteen significant digits are those of the binary number.
    most = 15 - math.floor(math.log10(max(abs(value), 1.0)))
    return f"{round(value, decimals):.{max(min(decimals, most), 0)}f}"


def with_sd(value: float | None, sd: float | None) -> str:
    """ "value +- sd"; "?" for an sd that is not known."""
    if value is None:
        return UNKNOWN
    if sd is None or not (math.isfinite(sd) and sd > 0.0):
        return f"{rounded(value, sd)} +- ?"
    return f"{rounded(value, sd)} +- {sd_text(sd)}"


def sd_text(sd: float | None) -> str:
    """An sd with two significant digits."""
    if sd is None or not math.isfinite(sd):
        return "?"
    if sd == 0.0:
        return "0"
    rough = float(f"{sd:.1e}")
    exponent = math.floor(math.log10(rough))
    return f"{rough:.{max(1 - exponent, 0)}f}" if -4 <= exponent < 6 else _power(rough, 1)


def _as_power(value: float, sd: float, decimals: int) -> bool:
    largest = max(abs(value), sd)
    return largest >= 1e6 or largest < 1e-3 or (decimals > 7 and abs(value) < 1e-2)


def _power(value: float, digits: int, strip: bool = False) -> str:
    mantissa, exponent = f"{value:.{digits}e}".split("e")
    if strip and "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}e{int(exponent)}"
