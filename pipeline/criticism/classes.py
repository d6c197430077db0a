"""Terms that these data cannot tell from the one that was found.

    T(A|B) = fall of chi2 when A joins B.      A and B are one class when T(A|B) and T(B|A) are both insignificant:
    either alone explains the evidence.

First by projection, at the fit with A: the scores of all columns with A's size put back, s + G_A theta_A, given B.  Those
that come near are refitted in A's place; then T(A|B) = chi2_B - chi2_A + T(B|A).  The class is made of those that cannot be
told from the winner; it is not chained through its members.

    sin(angle) between the signatures of A and B, baseline projected out; 5 sigma apart needs an SNR of about 5 / sin(angle)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from .problem import FitResult, Signatures
from .projection import Projected, baseline, project

_RANK = 1e-9


@dataclass(frozen=True)
class Rival:
    """A term beside the winner.

    ``sin_angle`` between their signatures; ``snr_needed`` to tell them apart at 5 sigma; ``left`` = T(winner | rival), as
    projected; ``joint`` = T(rival | winner).
    """

    name: str
    sin_angle: float
    snr_needed: float
    left: float
    joint: float


def rivals(fit: FitResult, term: str, signatures: Signatures) -> tuple[Rival, ...]:
    """Every absent term against one that is in the fit, the nearest first.

    Parameters
    ----------
    fit : with ``term`` in its model.
    term : the winner.
    signatures : of the absent terms, at this fit.
    """
    own = list(fit.columns[term])
    k = len(own)
    winner = tuple(jac[:, own] for jac in fit.jacobian)
    projected = project(baseline(fit, tuple(own)), signatures.blocks, signatures.grams, winner)
    size = _sizes(fit, term, projected.norms[:k])
    score = projected.score + projected.gram[:, :k] @ size
    whole = float(score[:k] @ _pinv(projected.gram[:k, :k]) @ score[:k])
    found = []
    for candidate in signatures.candidates:
        left, joint, sine = np.inf, 0.0, 1.0
        for cell in candidate.cells:
            columns = np.arange(k, projected.score.size)[cell]
            left_cell, joint_cell, sine_cell = _against(projected, score, k, columns, whole)
            if left_cell < left:
                left, sine = left_cell, sine_cell
            joint = max(joint, joint_cell)
        found.append(Rival(candidate.name, sine, 5.0 / max(sine, 1e-12), left, joint))
    return tuple(sorted(found, key=lambda rival: rival.left))


def _against(
    projected: Projected, score: FloatArray, k: int, columns: IntArray, whole: float
) -> tuple[float, float, float]:
    """T(A|B), T(B|A) and the sine of the smallest principal angle; A are the first k columns."""
    a = projected.gram[:k, :k]
    b = projected.gram[np.ix_(columns, columns)]
    ab = projected.gram[:k][:, columns]
    b_inverse, a_inverse = _pinv(b), _pinv(a)
    both = np.concatenate([np.arange(k), columns])
    together = float(score[both] @ _pinv(projected.gram[np.ix_(both, both)]) @ score[both])
    alone = float(score[columns] @ b_inverse @ score[columns])
    # A loses to B whatever direction of A the fit did not use: the angle is that of the fitted direction of A.
    direction = a_inverse @ score[:k]
    length = float(direction @ a @ direction)
    shadow = float(direction @ ab @ b_inverse @ ab.T @ direction)
    sine = float(np.sqrt(max(1.0 - shadow / max(length, 1e-300), 0.0)))
    return max(together - alone, 0.0), max(together - whole, 0.0), sine


def _sizes(fit: FitResult, term: str, norms: FloatArray) -> FloatArray:
    """(value - null) of the term's parameters, in the scaled units of the projected scores."""
    return np.asarray(fit.shifts[term], dtype=np.float64) * norms


def _pinv(gram: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(gram, rcond=_RANK, hermitian=True))
