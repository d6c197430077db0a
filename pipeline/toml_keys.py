"""What the keys of TOML files mean, stated where each key is declared, and their units.

    frequency_hz: Annotated[Positive, Meaning("undamped frequency")]
    zeta: Annotated[float, Meta(gt=0.0), Meaning("damping ratio", "1")]

The unit of a key is the end of its name; a key without such an end states it.  Counts, ratios and codes have the unit "1".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_type_hints

from msgspec import Struct

#: End of the name of a key -> unit; the longest end that fits holds.
UNITS = {
    "_hz": "Hz",
    "_hz_per_v2": "Hz/V^2",
    "_v": "V",
    "_s": "s",
    "_ms": "ms",
    "_per_s": "1/s",
    "_deg": "deg",
    "_dps": "deg/s",
    "_c": "degC",
    "_k": "K",
    "_ppm": "ppm",
    "_ppm_per_c": "ppm/K",
    "_ppm_per_k": "ppm/K",
    "_db": "dB",
    "_mm": "mm",
    "_um": "um",
    "_mg": "mg",
    "_pa": "Pa",
    "_ohm": "ohm",
}


@dataclass(frozen=True)
class Meaning:
    """What a key means, in a few words, and its unit where the name of the key does not end with it."""

    text: str
    unit: str = ""


def meanings(kind: type[Struct]) -> dict[str, Meaning]:
    """Key -> meaning with its unit, of a struct; a key that a base declares may take the meaning from there.

    The unit is empty for keys that have none, such as names and tables; a key without a meaning has an empty one.
    """
    found = dict.fromkeys(kind.__struct_fields__, Meaning(""))
    for owner in reversed(kind.__mro__):
        if not issubclass(owner, Struct) or owner is Struct:
            continue
        for name, hint in get_type_hints(owner, include_extras=True).items():
            notes = [note for note in getattr(hint, "__metadata__", ()) if isinstance(note, Meaning)]
            if notes and name in found:
                found[name] = notes[-1]
    return {name: Meaning(one.text, one.unit or unit_of(name)) for name, one in found.items()}


def unit_of(name: str) -> str:
    """The unit that is the end of the name of a key; empty where there is none."""
    ends = [end for end in UNITS if name.endswith(end)]
    return UNITS[max(ends, key=len)] if ends else ""
