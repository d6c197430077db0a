"""A sample rate that a file states as one number beside its signals: ``fs = 750``, or a column Fs with one value at its head.

names     fs, Fs, f_s, fsamp, sample_rate, sampling frequency, sr   [Hz];      dt, ts, delta_t, sample interval   [s]
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .units import UNITS, split_unit

_RATE = re.compile(r"(f_?s|f_?samp\w*|sampl\w*[ _-]?(rate|freq\w*)|s_?rate|sr)\W*", re.IGNORECASE)
#: Largest sample rate that a campaign may state [Hz].
_LARGEST_HZ = 1e12
_STEP = re.compile(r"(d_?t|t_?s|delta_?t|sampl\w*[ _-]?(interval|period|time|step))\W*", re.IGNORECASE)


def stated_rate(found: Mapping[str, NDArray[Any]]) -> tuple[str, float] | None:
    """Name of the number among the columns of a file, and the sample rate [Hz]; ``None`` where none states it."""
    for name, values in found.items():
        base, unit = split_unit(name)
        # A group or a struct may stand before the name; "f_s" is no f in seconds.
        unit = None if re.search(r"(^|[./])[fFtT]_s$", name) else unit
        last = re.split(r"[./]", name if unit is None else base)[-1].strip()
        rate, step = _RATE.fullmatch(last), _STEP.fullmatch(last)
        if not (rate or step) or (number := _only_number(np.asarray(values))) is None:
            continue
        si, factor = UNITS[unit] if unit is not None else ("Hz" if rate else "s", 1.0)
        rate_hz = factor * number if si == "Hz" else 1.0 / max(factor * number, 1e-300)
        if si in ("Hz", "s") and rate_hz <= _LARGEST_HZ:
            return name, rate_hz
    return None


def _only_number(values: NDArray[Any]) -> float | None:
    """The one positive number that a column holds, once or in every row; ``None`` for other columns."""
    if values.dtype.kind not in "fiu":
        return None
    finite = values[np.isfinite(values)]
    return float(finite[0]) if finite.size and finite[0] > 0 and np.all(finite == finite[0]) else None
