"""Units of columns, and their factors to SI; a unit may stand in brackets behind the name of a column.

Voltage [mV]    a (g)    sense1/V    time_ms        value in SI = factor * value in the file
"""

from __future__ import annotations

import re

#: Unit -> (its unit in SI, factor).
UNITS: dict[str, tuple[str, float]] = {
    **{unit: ("V", factor) for unit, factor in (("V", 1.0), ("mV", 1e-3), ("uV", 1e-6), ("nV", 1e-9), ("kV", 1e3))},
    **dict.fromkeys(("Volt", "Volts", "volt", "volts", "Vrms"), ("V", 1.0)),
    **{unit: ("A", factor) for unit, factor in (("A", 1.0), ("mA", 1e-3), ("uA", 1e-6), ("nA", 1e-9), ("pA", 1e-12))},
    **dict.fromkeys(("m/s^2", "m/s2", "m/s²", "m/s/s", "m s^-2"), ("m/s^2", 1.0)),
    **dict.fromkeys(("g", "gn", "g_n"), ("m/s^2", 9.80665)),
    "mg": ("m/s^2", 9.80665e-3),
    **{unit: ("m/s", factor) for unit, factor in (("m/s", 1.0), ("mm/s", 1e-3), ("um/s", 1e-6))},
    **{unit: ("m", factor) for unit, factor in (("m", 1.0), ("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9))},
    **{unit: ("N", factor) for unit, factor in (("N", 1.0), ("mN", 1e-3), ("uN", 1e-6), ("kN", 1e3))},
    **{unit: ("W", factor) for unit, factor in (("W", 1.0), ("mW", 1e-3), ("uW", 1e-6), ("nW", 1e-9), ("pW", 1e-12))},
    "lbf": ("N", 4.4482216152605),
    **{unit: ("N m", factor) for unit, factor in (("N m", 1.0), ("Nm", 1.0), ("mNm", 1e-3))},
    **{unit: ("Pa", factor) for unit, factor in (("Pa", 1.0), ("kPa", 1e3), ("MPa", 1e6), ("bar", 1e5))},
    **{unit: ("strain", factor) for unit, factor in (("strain", 1.0), ("Strain", 1.0), ("ustrain", 1e-6))},
    **dict.fromkeys(("microstrain", "ue"), ("strain", 1e-06)),
    **{unit: ("rad", factor) for unit, factor in (("rad", 1.0), ("deg", 0.017453292519943295))},
    **dict.fromkeys(("counts", "count", "LSB", "1"), ("counts", 1.0)),
    **{unit: ("s", factor) for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("min", 60.0))},
    **dict.fromkeys(("sec", "Sec", "second", "seconds", "Seconds"), ("s", 1.0)),
    **{unit: ("Hz", factor) for unit, factor in (("mHz", 1e-3), ("Hz", 1.0), ("kHz", 1e3), ("MHz", 1e6), ("GHz", 1e9))},
    **{unit: ("Hz", factor) for unit, factor in (("S/s", 1.0), ("kS/s", 1e3), ("MS/s", 1e6), ("GS/s", 1e9))},
    **dict.fromkeys(("Sa/s", "samples/s"), ("Hz", 1.0)),
}
_MICRO = str.maketrans({"µ": "u", "μ": "u"})
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))\s*$")
_SUFFIX = re.compile(r"^(?P<name>.+?)(?:_|\s*/\s*)(?P<unit>[A-Za-zµμ²^/0-9]+)$")


def known_unit(text: str) -> str | None:
    """The key of :data:`UNITS` for a unit as people write it, or ``None``."""
    unit = text.strip().translate(_MICRO)
    return unit if unit in UNITS else None


def of_any_case(text: str) -> tuple[str, float] | None:
    """Unit in SI and factor of a unit that may be written in other letters; ``None`` where two units fit: MHZ is mHz or MHz."""
    unit = text.strip().translate(_MICRO)
    if unit in UNITS:
        return UNITS[unit]
    meant = {si for known, si in UNITS.items() if known.lower() == unit.lower()}
    return meant.pop() if len(meant) == 1 else None


def is_unit(text: str) -> bool:
    """Whether ``text`` is a unit, in brackets or not."""
    return known_unit(text.strip("()[] ")) is not None


def with_unit(name: str, unit: str) -> str:
    """The name of a column with its unit: "V1", "mV" -> "V1 [mV]"."""
    unit = unit.strip("()[] ")
    return f"{name} [{unit}]" if unit else name


def split_unit(name: str) -> tuple[str, str | None]:
    """The name of a column without its unit, and the unit: "V1 [mV]" -> ("V1", "mV"); ``None`` where there is none."""
    if match := _BRACKETS.match(name):
        unit = known_unit(match["square"] if match["square"] is not None else match["round"])
        if unit is not None:
            return match["name"].strip(), unit
    if match := _SUFFIX.match(name):
        unit = known_unit(match["unit"])
        # "acc_1" and "x_m": a single letter or digit behind a dash is more often an index than a unit.
        if unit is not None and (len(unit) > 1 or unit in "VsA"):
            return match["name"].strip(), unit
    return name, None
