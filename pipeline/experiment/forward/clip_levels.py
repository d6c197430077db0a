"""Clip levels that are scanned: shares of the largest sample, because one above it changes nothing.

A converter is scanned near its peak: a level far below it would be obvious.  A drive is scanned further down, because records
have several drive levels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...device.effect import Effect
from ...device.parameters import Shape
from ..record import Record

#: Shares of the largest sample, by stage.
_SHARES = {
    "adc": (1.0, 0.997, 0.99, 0.97, 0.93, 0.85, 0.7),
    "drive": (0.995, 0.97, 0.92, 0.85, 0.76, 0.66, 0.56, 0.47, 0.39, 0.32, 0.26, 0.2),
}


def clip_levels(effect: Effect, shape: Shape, records: Sequence[Record]) -> dict[str, tuple[float, ...]]:
    """Name of the parameter 1/level -> values [1/V] to scan for ``records``; empty where the effect does not clip."""
    for stage, shares in _SHARES.items():
        if effect.clips(stage):
            volts = [record.sense_v if stage == "adc" else record.drive_v for record in records]
            peak_v = max(float(np.max(np.abs(v), initial=0.0)) for v in volts)
            if peak_v > 0.0:
                (member,) = effect.members(shape)
                return {member.name: tuple(1.0 / (peak_v * share) for share in shares)}
    return {}
