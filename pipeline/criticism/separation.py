"""How well a planned experiment would tell rival terms apart.

    snr^2(A | B) = chi2_B - chi2_A + min over dp of ( |s_A - s_B - J_B dp|^2 + dp' N_B dp ),      N_B = J_old' J_old

s_A and s_B are the predictions of the new rows by the fits with A and with B, J_B is the jacobian of s_B, all in sigmas; chi2
and N are those of the old rows.  If A is right, a refit of B to the old and new rows, with all its parameters free, is expected
to have a chi2 larger by snr^2 than a refit of A.  A pair is judged by the smaller SNR of its two orders: where B contains A as a
special case, a true A can never be told from B.

The minimum is the square of the last diagonal element of a triangular factor, which is accurate even where all but a millionth
of s_A - s_B is absorbed:

    QR of [[R_B, 0], [J_B, s_A - s_B]],     R_B' R_B = N_B

Without J_B (dp = 0) the result is an upper bound that needs no derivatives.  Shapes: n new rows, P parameters of a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..arrays import FloatArray
from ..errors import NegativeError
from .problem import FitResult, Problem
from .scores import triangle


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of new rows by the fit with one term.

    Parameters
    ----------
    term : the term.
    signal : (n,) new rows [sigma].
    chi2 : of the old rows.
    known : (P, P) R of the old rows, see ``known_of``.
    jacobian : (n, P), or ``None`` for the upper bound.
    """

    term: str
    signal: FloatArray
    chi2: float
    known: FloatArray
    jacobian: FloatArray | None = None


@dataclass(frozen=True)
class Separation:
    """The pairs of a class and their SNR [sigma], smallest first."""

    pairs: tuple[tuple[tuple[str, str], float], ...]

    @property
    def least(self) -> float:
        """Smallest SNR of a pair [sigma]."""
        return self.pairs[0][1]

    def apart(self, snr: float) -> int:
        """Number of pairs whose SNR is at least ``snr`` [sigma]."""
        return sum(value >= snr for _, value in self.pairs)


def known_of(fit: FitResult) -> FloatArray:
    """R (P, P) with R' R = J' J over the fitted blocks; triangular."""
    return triangle(np.concatenate([triangle(block) for block in fit.jacobian]))


def fits_to_separate(problem: Problem, terms: Sequence[str], effect: str) -> tuple[FitResult, FitResult]:
    """The fits with ``terms``, without and with ``effect``.

    Raises
    ------
    NegativeError : one of them fails.
    """
    without = problem.fit(tuple(terms))
    fit = problem.fit((*without.terms, effect), without)
    for one in (without, fit):
        if not one.ok:
            raise NegativeError(f"a fit failed: {one.why}", value=effect, next_step="choose another effect")
    return without, fit


def snr(right: Prediction, wrong: Prediction) -> float:
    """snr(A | B) [sigma] of a right prediction A and a wrong one B, both (n,), as defined at the head of the module.

    Negative, -sqrt(-snr^2), where the wrong one would still fit better; an upper bound without a jacobian.
    """
    difference = right.signal - wrong.signal
    left = float(difference @ difference)
    if wrong.jacobian is not None:
        p = wrong.jacobian.shape[1]
        new = np.concatenate([wrong.jacobian, difference[:, None]], axis=1)
        old = np.concatenate([wrong.known, np.zeros((wrong.known.shape[0], 1))], axis=1)
        stacked = np.concatenate([old, triangle(new)])
        # Parameters have any unit: columns of equal norm keep rounding in the large ones away from the small ones.
        size = np.linalg.norm(stacked[:, :p], axis=0)
        stacked[:, :p] /= np.where(size > 0.0, size, 1.0)
        left = float(triangle(stacked)[p, p] ** 2)
    square = left + wrong.chi2 - right.chi2
    return float(np.copysign(np.sqrt(abs(square)), square))


def separation(predictions: Sequence[Prediction]) -> Separation:
    """All pairs of the predictions, each with the smaller SNR of its two orders."""
    pairs = [((a.term, b.term), min(snr(a, b), snr(b, a))) for a, b in combinations(predictions, 2)]
    return Separation(tuple(sorted(pairs, key=lambda pair: pair[1])))
