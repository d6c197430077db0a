"""Held-out data: does a model with one more term foretell them better?

    delta = r_before - r_after                         what the term changed, row by row
    fall  = sum(r_before^2 - r_after^2)
    sd    = 2 sqrt(max(level^2 sum(delta^2), sum over chunks of (sum of delta r)^2)),   r of the better of the two

If the better model is right its r is noise, and the fall is +-sum(delta^2) + 2 sum(delta r), whose sd is 2 level sqrt(sum
delta^2) for noise of rms level: 1, or that of the larger model's fit where no noise level is known.  Sums over chunks of
rows let noise that is stronger, coloured or heavy-tailed widen it, never narrow it.  Where chi2 rises they widen it to at most
three times: beyond that r holds a misfit of the better model, which is no excuse for a worse one.  Free amplitudes that the
new model refits on the held-out data are taken off the fall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .problem import ResidualBlock

Standing = Literal["confirmed", "partial", "refused"]
_CHUNK = 256
#: How much louder than its level noise may seem.
_LOUDEST = 3.0


@dataclass(frozen=True)
class Paired:
    """Fall of the held-out chi2 and its sd; ``standing`` at 2 sd either way."""

    fall: float
    sd: float

    @property
    def standing(self) -> Standing:
        """confirmed, refused, or partial in between (and where nothing was held out)."""
        if self.fall > 2.0 * self.sd > 0.0:
            return "confirmed"
        return "refused" if self.fall < -2.0 * self.sd else "partial"


def paired(before: Sequence[ResidualBlock], after: Sequence[ResidualBlock], level: float = 1.0) -> Paired:
    """Compare two models on the same held-out blocks, whose noise has rms ``level``."""
    fall = sum(old.chi2 - new.chi2 - (new.nuisances - old.nuisances) for old, new in zip(before, after))
    better = after if fall > 0.0 else before
    nominal, actual = 0.0, 0.0
    for old, new, right in zip(before, after, better):
        delta = old.rows - new.rows
        nominal += level**2 * float(np.vdot(delta, delta))
        edges = np.arange(0, delta.size, _CHUNK)
        actual += float(np.sum(np.add.reduceat(delta * right.rows, edges) ** 2)) if delta.size else 0.0
    if fall < 0.0:
        actual = min(actual, _LOUDEST**2 * nominal)
    return Paired(fall, 2.0 * float(np.sqrt(max(nominal, actual))))
