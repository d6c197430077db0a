"""Judgement of a larger model on held-out data, by the paired difference of chi2.

    delta      = r_before - r_after                           change of the held-out residual, row by row
    delta_chi2 = sum(r_before^2 - r_after^2)
    sd         = 2 sqrt(max(level^2 sum(delta^2), sum over chunks of (sum of delta r)^2)),   r of the better model

If the better model is right, its r is noise and delta_chi2 is +-sum(delta^2) + 2 sum(delta r), with sd 2 level sqrt(sum delta^2)
for noise of rms ``level``: 1, or that of the larger fit where the noise level is unknown.  Sums over chunks of rows widen the sd
where the noise is stronger, coloured or heavy-tailed, and never narrow it.  Where chi2 rises they widen it to three times at
most: beyond that r holds a misfit of the better model, which does not excuse a worse one.  Free amplitudes that the larger model
refits on the held-out data are subtracted from delta_chi2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .goodness import WINDOW
from .problem import FitResult, ResidualBlock

HeldOutStatus = Literal["confirmed", "partial", "refused"]
#: Largest ratio of the observed to the nominal sd where chi2 rises.
_MAX_INFLATION = 3.0


@dataclass(frozen=True)
class PairedDifference:
    """Decrease of the held-out chi2, its sd, and ``change`` = sum(delta^2): the decrease if the larger model is right."""

    delta_chi2: float
    sd: float
    change: float = 0.0

    @property
    def status(self) -> HeldOutStatus:
        """confirmed or refused, else partial (also where nothing was held out).

        Confirmed where chi2 falls by more than 2 sd.  Refused where it rises by more than 2 sd, or where it rises at all
        although the right model would have lowered it by more than 2 sd.
        """
        clear = 2.0 * self.sd
        if self.delta_chi2 > clear > 0.0:
            return "confirmed"
        # Without it, unknown physics gets terms of which held-out data show less than half, each at the cost of all its rivals:
        # two poles and delays beside self-heating, at 24 sd below what they promise (outside 5, seed 2041).
        contradicted = self.delta_chi2 < 0.0 and self.change > clear
        return "refused" if contradicted or self.delta_chi2 < -clear else "partial"


def held_out_difference(before: FitResult, after: FitResult) -> PairedDifference:
    """Compare a fit with a larger one on the held-out data; noise of 1 [sigma], or sqrt(chi2/dof) if not known."""
    level = 1.0 if after.noise_known else float(np.sqrt(after.chi2 / max(after.dof, 1)))
    return paired_difference(before.held, after.held, level)


def paired_difference(
    before: Sequence[ResidualBlock], after: Sequence[ResidualBlock], level: float = 1.0
) -> PairedDifference:
    """delta_chi2 and its sd, as defined at the head of the module, of two models on the same held-out blocks.

    Parameters
    ----------
    before, after : blocks (n, m) of the smaller and of the larger model, in the same order and of the same shapes.
    level : rms of the noise [sigma].
    """
    decrease = sum(old.chi2 - new.chi2 - (new.nuisances - old.nuisances) for old, new in zip(before, after))
    better = after if decrease > 0.0 else before
    change, actual = 0.0, 0.0
    for old, new, right in zip(before, after, better):
        delta = old.rows - new.rows
        change += float(np.vdot(delta, delta))
        edges = np.arange(0, delta.size, WINDOW)
        actual += float(np.sum(np.add.reduceat(delta * right.rows, edges) ** 2)) if delta.size else 0.0
    nominal = level**2 * change
    if decrease < 0.0:
        actual = min(actual, _MAX_INFLATION**2 * nominal)
    return PairedDifference(decrease, 2.0 * float(np.sqrt(max(nominal, actual))), change)
