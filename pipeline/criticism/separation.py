"""How well data that are not there yet would tell rival terms apart.

    snr^2(A | B) = chi2_B - chi2_A + min over dp of ( |s_A - s_B - J_B dp|^2 + dp' N_B dp ),      N_B = J_old' J_old

s_A, s_B are what the fits with A and with B say of the new rows, J_B how the latter moves, all in sigmas; chi2 and N are those of
the old rows.  If A is right, the refit with B on old and new rows, all its parameters free, is expected to be worse than the
refit with A by snr^2.  A pair is as separate as the worse of its two ways round: where B holds A as a special case, a
true A can never be told from B.

The minimum is the last diagonal element of a triangle, so it is right where all but a millionth of s_A - s_B is absorbed:

    QR of [[R_B, 0], [J_B, s_A - s_B]],     R_B' R_B = N_B

Without J_B (dp = 0) the same is a bound from above, which costs no derivatives.  Shapes: n new rows, P parameters of a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..arrays import FloatArray
from .problem import FitResult


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the fit with one term says of new rows.

    Parameters
    ----------
    term : its name.
    signal : (n,) new rows, in sigmas.
    chi2 : of the old rows.
    known : (P, P) = R of the old rows, see ``known_of``.
    jacobian : (n, P), or ``None`` for a bound only.
    """

    term: str
    signal: FloatArray
    chi2: float
    known: FloatArray
    jacobian: FloatArray | None = None


@dataclass(frozen=True)
class Separation:
    """The pairs of a class and their SNR, the least first."""

    pairs: tuple[tuple[tuple[str, str], float], ...]

    @property
    def least(self) -> float:
        """SNR of the pair that is told apart worst."""
        return self.pairs[0][1]

    def apart(self, snr: float) -> int:
        """How many pairs reach ``snr``."""
        return sum(found >= snr for _, found in self.pairs)


def known_of(fit: FitResult) -> FloatArray:
    """R (P, P) with R' R = J' J over the fitted blocks."""
    return _triangle(np.concatenate([_triangle(block) for block in fit.jacobian]))


def snr(right: Prediction, wrong: Prediction) -> float:
    """snr(A | B) of a right and a wrong prediction; below zero (-sqrt) where the wrong one would still fit better."""
    difference = right.signal - wrong.signal
    left = float(difference @ difference)
    if wrong.jacobian is not None:
        p = wrong.jacobian.shape[1]
        new = np.concatenate([wrong.jacobian, difference[:, None]], axis=1)
        old = np.concatenate([wrong.known, np.zeros((wrong.known.shape[0], 1))], axis=1)
        stacked = np.concatenate([old, _triangle(new)])
        # Parameters come in any unit: equal columns, so that rounding in the large ones does not drown the small ones.
        size = np.linalg.norm(stacked[:, :p], axis=0)
        stacked[:, :p] /= np.where(size > 0.0, size, 1.0)
        left = float(_triangle(stacked)[p, p] ** 2)
    square = left + wrong.chi2 - right.chi2
    return float(np.copysign(np.sqrt(abs(square)), square))


def separation(predictions: Sequence[Prediction]) -> Separation:
    """All pairs of some predictions, each with the smaller SNR of its two ways round."""
    pairs = [((a.term, b.term), min(snr(a, b), snr(b, a))) for a, b in combinations(predictions, 2)]
    return Separation(tuple(sorted(pairs, key=lambda pair: pair[1])))


def _triangle(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(matrix, mode="r"))
