"""Is an effect of the library significant in a device, and how far could one that is not still bias its quantities?

With the whitened residual r, the Jacobian J of the fit (rows of its prior included) and the signatures Z of one effect,

    Z~ = Z - J J^+ Z,    G = Z~' Z~,    a^ = G^-1 Z~' r,    T = a^' G a^ ~ chi2(k)
    p  = 1 - (1 - P(chi2_k > T))^E     for the smallest of E effects: family-wise
    bias of q at strength a:  b' a,  b = (dq/dx J^+ Z)'
    bound = min(|b' a^| + z sqrt(b' G^-1 b),  largest |b' a| within the declared range),    z = 1.96

A law with one sign is tested on that side, and its strength is bounded by max(a^, 0) + z / sqrt(G).  G has no inverse where the
fit absorbs a signature; the range alone then bounds the strength.  The noise level has nu degrees of freedom, so T / k is
compared with F.

Shapes: P parameters, k columns of an effect, Q quantities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.special import fdtrc

from ....arrays import FloatArray, IntArray
from ...gate import Undetected
from .left import EffectColumns, left_of, scores_of

#: 95 % of the noise.
Z95 = 1.959963984540054


@dataclass(frozen=True, eq=False)
class Candidates:
    """Effects that a model lacks: the effect of each column (K,), and the range (K,) of each strength."""

    effects: tuple[str, ...]
    low: FloatArray
    high: FloatArray

    @property
    def numbers(self) -> IntArray:
        """The number of the effect of each column (K,)."""
        return _numbered(self.effects)


@lru_cache(maxsize=16)
def _numbered(of_columns: tuple[str, ...]) -> IntArray:
    names = sorted(set(of_columns))
    return np.array([names.index(name) for name in of_columns], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Judged:
    """What is known of effects: their names, p-values (E,), T (E,), and bounds (E, Q) of the biases that each can cause."""

    effects: tuple[str, ...]
    p_values: FloatArray
    explained: FloatArray
    bounds: FloatArray


@dataclass(frozen=True, eq=False)
class Projection:
    """The fit as a projection, J = Q R: R'^-1 (P, P), and dq/dx R^-1 (Q, P) of the quantities.

    Raises
    ------
    numpy.linalg.LinAlgError : the Jacobian has no full rank.
    """

    whiten: FloatArray
    slopes: FloatArray

    @classmethod
    def of(cls, products: FloatArray, slopes: FloatArray) -> Projection:
        """From J' J (P, P).  In units of the norms of the columns it loses eight of sixteen digits at most."""
        scale = np.sqrt(np.maximum(products.diagonal(), 1e-300))
        factor, failed = dpotrf(products / (scale[:, None] * scale), lower=True, clean=True)
        if failed:
            raise np.linalg.LinAlgError("the Jacobian has no full rank")
        whiten = dtrtri(factor, lower=True)[0] / scale
        return cls(whiten, slopes @ whiten.T)

    def overlap(self, products: FloatArray) -> FloatArray:
        """Q' Z (P, K) of J' Z (P, K)."""
        return np.asarray(self.whiten @ products)

    def bias(self, overlap: FloatArray) -> FloatArray:
        """Bias (Q, K) of the quantities by columns of unit strength, from Q' Z (P, K)."""
        return np.asarray(self.slopes @ overlap)


@dataclass(frozen=True, eq=False)
class EffectEvidence:
    """The effects that one device may have.

    Parameters
    ----------
    products : [J, r, Z]' [J, r, Z] (P + 1 + K, P + 1 + K), whitened, with the rows of the prior; only those of Z within an effect
        are used.
    projection, candidates : of the fit; of the columns Z.
    noise_dof : degrees of freedom of the noise level.
    """

    products: FloatArray
    projection: Projection
    candidates: Candidates
    noise_dof: float


def judged(problem: EffectEvidence) -> Judged:
    """Scores and bounds of the effects of one device."""
    return judged_together([problem])[0]


def judged_together(problems: Sequence[EffectEvidence]) -> list[Judged]:
    """:func:`judged` of devices with the same effects and quantities.

    Nothing is summed over devices, so that each has the numbers that it has alone, bit for bit.
    """
    columns = _columns_of(problems[0].candidates.effects)
    left = left_of([(one.products, one.projection.whiten, one.projection.slopes) for one in problems], columns)
    low, high = (np.stack([getattr(one.candidates, end) for one in problems]) * left.scale for end in ("low", "high"))
    scored = scores_of(left, columns, low, high, Z95)
    seen = np.maximum(scored.seen, 1.0)
    dof = np.array([[problem.noise_dof] for problem in problems])
    p_values = np.where(scored.share > 0.0, scored.share * fdtrc(seen, dof, scored.explained / seen), 1.0)
    return [Judged(columns.effects, *each) for each in zip(p_values, scored.explained, scored.bounds)]


@lru_cache(maxsize=16)
def _columns_of(of_columns: tuple[str, ...]) -> EffectColumns:
    """The effects of columns."""
    effects = tuple(sorted(set(of_columns)))
    own = [[k for k, name in enumerate(of_columns) if name == effect] for effect in effects]
    most = max((len(columns) for columns in own), default=1)
    padded = [columns + columns[:1] * (most - len(columns)) for columns in own]
    return EffectColumns(
        effects,
        np.array(padded, np.int64).reshape(len(own), most),
        np.array([len(columns) for columns in own], np.int64),
    )


#: Relative precision of what an effect explains: two versions of the scores, in double and in single precision, agree to 4e-5.
_ROUNDING = 1e-4


def summary(found: Sequence[Judged], quantities: Sequence[str]) -> Undetected:
    """The most significant effect of all, and the largest bound of each of the ``quantities`` (Q,)."""
    effects = [name for one in found for name in one.effects]
    if not effects:
        return Undetected("", 1.0, dict.fromkeys(quantities, 0.0), dict.fromkeys(quantities, ""), {})
    p_values = np.concatenate([one.p_values for one in found])
    explained = np.concatenate([one.explained for one in found])
    bounds = np.concatenate([one.bounds for one in found])
    best = _closest(p_values, explained)
    family = float(-np.expm1(len(effects) * np.log1p(-min(p_values[best], 1.0 - 1e-16))))
    return Undetected(
        effects[best],
        family,
        dict(zip(quantities, bounds.max(axis=0).tolist())),
        {name: effects[i] for name, i in zip(quantities, bounds.argmax(axis=0))},
        dict(zip(effects, p_values.tolist())),
    )


def _closest(p_values: FloatArray, explained: FloatArray) -> int:
    """The most significant effect; the first of those whose scores are equal to rounding.

    A short delay and a fast pole have one signature: without this, rounding named one or the other in 8 of 400 devices.
    """
    # Probabilities of loud effects are 0; the one that explains most is then the closest.
    best = int(np.lexsort((-explained, p_values))[0])
    margin = _ROUNDING * explained[best]
    equal = (explained >= explained[best] - margin) & (p_values <= p_values[best] * np.exp(min(margin, 700.0)))
    return int(np.flatnonzero(equal)[0])
