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

from ....arrays import BoolArray, FloatArray, IntArray
from ...gate import Undetected

#: 95 % of the noise.
Z95 = 1.959963984540054
#: Share of a signature's energy below which its direction counts as absorbed by the fit: the square of what rounding leaves.
_ABSORBED = 1e-10


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


@dataclass(frozen=True, eq=False)
class _Left:
    """What the fit leaves of unit columns Z: Z~' r (K,), Z~' Z~ (K, K), biases (Q, K), and the range (K,) of their strengths."""

    score: FloatArray
    gram: FloatArray
    bias: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, problem: EffectEvidence) -> _Left:
        products, p = problem.products, problem.projection.whiten.shape[0]
        scale = np.sqrt(np.maximum(products.diagonal()[p:], 1e-300))
        overlap = problem.projection.overlap(products[:p, p:] / scale)
        left = products[p:, p:] / (scale[:, None] * scale) - overlap.T @ overlap
        score, bias, scale = left[0, 1:] * scale[0], problem.projection.bias(overlap[:, 1:]), scale[1:]
        return cls(score, left[1:, 1:], bias, problem.candidates.low * scale, problem.candidates.high * scale)


def judged(problem: EffectEvidence) -> Judged:
    """Scores and bounds of the effects of one device."""
    return judged_together([problem])[0]


def judged_together(problems: Sequence[EffectEvidence]) -> list[Judged]:
    """:func:`judged` of devices with the same effects and quantities.

    Nothing is summed over devices, so that each has the numbers that it has alone, bit for bit.
    """
    every = [_Left.of(problem) for problem in problems]
    score, gram, bias, low, high = (
        np.stack([getattr(one, name) for one in every]) for name in ("score", "gram", "bias", "low", "high")
    )
    dof = np.array([problem.noise_dof for problem in problems])
    effects, single, several = _grouped(problems[0].candidates.effects)
    devices, quantities = len(every), bias.shape[1]
    p_values, explained = np.ones((devices, len(effects))), np.zeros((devices, len(effects)))
    bounds = np.zeros((devices, len(effects), quantities))

    def write(own: IntArray, found: tuple[FloatArray, FloatArray, FloatArray]) -> None:
        for out, values in zip((p_values, explained, bounds), found):
            out[:, own] = values.reshape(devices, own.size, *out.shape[2:])

    if single.effects.size:
        k = single.columns[:, 0]
        of_column = np.swapaxes(bias[:, :, k], 0, 1).reshape(quantities, -1)
        size = gram.diagonal(axis1=1, axis2=2)
        flat = [each[:, k].ravel() for each in (score, size, low, high)]
        write(single.effects, _single(flat[0], flat[1], of_column, flat[2], flat[3], np.repeat(dof, k.size)))
    if several.effects.size:
        own, used = several.columns, several.used
        width = own.shape[1]
        blocks = gram[:, own[:, :, None], own[:, None, :]] * (used[:, :, None] * used[:, None, :])
        reach = np.where(used, np.maximum(np.abs(low), np.abs(high))[:, own], 0.0)
        of_bias = np.swapaxes(bias[:, :, own], 1, 2) * used[:, None]
        count = np.tile(used.sum(axis=1), devices)
        write(
            several.effects,
            _several(
                (score[:, own] * used).reshape(-1, width),
                blocks.reshape(-1, width, width),
                of_bias.reshape(-1, quantities, width),
                reach.reshape(-1, width),
                count,
                np.repeat(dof, own.shape[0]),
            ),
        )
    return [Judged(effects, *each) for each in zip(p_values, explained, bounds)]


@dataclass(frozen=True, eq=False)
class _Group:
    """Numbers (E,) of effects and their columns (E, k); those beyond the last of an effect are not ``used`` (E, k)."""

    effects: IntArray
    columns: IntArray
    used: BoolArray


@lru_cache(maxsize=16)
def _grouped(of_columns: tuple[str, ...]) -> tuple[tuple[str, ...], _Group, _Group]:
    """The effects of columns: their names, those with one column, and those with several."""
    effects = tuple(sorted(set(of_columns)))
    columns = [[k for k, name in enumerate(of_columns) if name == effect] for effect in effects]
    groups = []
    for several in (False, True):
        own = [i for i, one in enumerate(columns) if (len(one) > 1) == several]
        most = max((len(columns[i]) for i in own), default=0)
        padded = [columns[i] + columns[i][:1] * (most - len(columns[i])) for i in own]
        used = [[k < len(columns[i]) for k in range(most)] for i in own]
        shape = (len(own), most)
        groups.append(
            _Group(
                np.array(own, np.int64), np.array(padded, np.int64).reshape(shape), np.array(used, bool).reshape(shape)
            )
        )
    return effects, groups[0], groups[1]


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


def _single(
    score: FloatArray, size: FloatArray, bias: FloatArray, low: FloatArray, high: FloatArray, dof: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """p-values (K,) and T (K,) of effects with one signature of unit norm, ``size`` of which survives; bounds (K, Q)."""
    seen = size > _ABSORBED
    size = np.where(seen, size, 1.0)
    side = np.where(low == 0.0, 1.0, np.where(high == 0.0, -1.0, 0.0))
    strength = np.where(seen, score**2 / size, 0.0)
    p = np.asarray(fdtrc(1.0, dof, strength), dtype=np.float64)
    p = np.where(side == 0.0, p, np.where(side * score > 0.0, 0.5 * p, 1.0))
    p = np.where(seen, p, 1.0)
    estimate = score / size
    estimate = np.abs(np.where(side == 0.0, estimate, np.maximum(side * estimate, 0.0)))
    most = np.where(seen, estimate + Z95 / np.sqrt(size), np.inf)
    most = np.minimum(most, np.maximum(np.abs(low), np.abs(high)))
    # An unlimited size of an effect without bias is no bias.
    return p, strength, np.multiply(np.abs(bias), most, out=np.zeros_like(bias), where=bias != 0.0).T


def _several(
    score: FloatArray, gram: FloatArray, bias: FloatArray, reach: FloatArray, count: IntArray, dof: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """p-values and T (E,) of effects with k signatures of unit norm; bounds (E, Q) of biases (E, Q, k).

    score, reach (E, k): Z~' r and largest strengths; gram (E, k, k); count (E,): of the columns that are not zero.
    """
    within = at_most(bias, reach)
    size, vector = np.linalg.eigh(gram)
    seen = np.asarray(size > _ABSORBED)
    weight = np.where(seen, 1.0 / np.where(seen, size, 1.0), 0.0)
    projected = (score[:, None] @ vector)[:, 0]
    visible = (bias @ vector) * seen[:, None]
    k, total = seen.sum(axis=1), np.sum(projected**2 * weight, axis=1)
    bound = np.abs(visible @ (projected * weight)[:, :, None])[:, :, 0]
    bound += Z95 * np.sqrt(np.sum(visible**2 * weight[:, None], axis=2))
    if np.any(k < count):
        hidden = at_most(bias - visible @ np.swapaxes(vector, 1, 2), reach)
        bound += np.where((k < count)[:, None], hidden, 0.0)
    p = np.where(k > 0, np.asarray(fdtrc(np.maximum(k, 1), dof, total / np.maximum(k, 1)), dtype=np.float64), 1.0)
    return p, total, np.where(k[:, None] > 0, np.minimum(bound, within), within)


def at_most(bias: FloatArray, reach: FloatArray) -> FloatArray:
    """Largest |b' a| (E, Q) for |a| <= ``reach`` (E, k), of biases (E, Q, k); no bias, no effect, however large."""
    most = np.multiply(np.abs(bias), reach[:, None], out=np.zeros_like(bias), where=bias != 0.0)
    return np.asarray(np.sum(most, axis=2))
