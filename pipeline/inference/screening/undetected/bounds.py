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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import fdtrc

from ....arrays import FloatArray
from ...gate import Undetected

#: 95 % of the noise.
_Z = 1.959963984540054
#: Share of a signature's energy below which its direction counts as absorbed by the fit: the square of what rounding leaves.
_ABSORBED = 1e-10


@dataclass(frozen=True, eq=False)
class Candidates:
    """Effects that a model lacks: the effect of each column (K,), and the range (K,) of each strength."""

    effects: tuple[str, ...]
    low: FloatArray
    high: FloatArray


def undetected(
    products: FloatArray, candidates: Candidates, slopes: Mapping[str, FloatArray], noise_dof: float
) -> Undetected:
    """Scores and bounds.

    Parameters
    ----------
    products : [J, Z, r]' [J, Z, r] (P + K + 1, P + K + 1), whitened, with the rows of the prior.
    candidates : of the columns of Z.
    slopes : quantity -> dq/dx (P,).
    noise_dof : degrees of freedom of the noise level.

    Raises
    ------
    numpy.linalg.LinAlgError : the Jacobian has no full rank.
    """
    p = products.shape[0] - len(candidates.effects) - 1
    scale = np.sqrt(np.maximum(np.diag(products), 1e-300))
    # In units of the norms of the columns, J' J loses eight of sixteen digits at most.
    unit = products / np.outer(scale, scale)
    factor = cholesky(unit[:p, :p], lower=True)
    overlap = solve_triangular(factor, unit[:p, p:], lower=True)
    left = unit[p:, p:] - overlap.T @ overlap
    score, gram = left[:-1, -1] * scale[-1], left[:-1, :-1]
    moved = solve_triangular(factor, overlap[:, :-1], lower=True, trans="T") / scale[:p, None]
    names = list(slopes)
    bias = np.stack([slopes[q] for q in names]) @ moved
    low, high = candidates.low * scale[p:-1], candidates.high * scale[p:-1]
    effects = list(dict.fromkeys(candidates.effects))
    p_values, explained = np.ones(len(effects)), np.zeros(len(effects))
    bounds = np.zeros((len(effects), len(names)))
    columns = [[k for k, name in enumerate(candidates.effects) if name == effect] for effect in effects]
    alone = [i for i, own in enumerate(columns) if len(own) == 1]
    single = [columns[i][0] for i in alone]
    p_values[alone], explained[alone], bounds[alone] = _single(
        score[single], gram[single, single], bias[:, single], low[single], high[single], noise_dof
    )
    for i, own in enumerate(columns):
        if len(own) > 1:
            block = gram[np.ix_(own, own)]
            p_values[i], explained[i], bounds[i] = _several(
                score[own], block, bias[:, own], np.maximum(np.abs(low[own]), np.abs(high[own])), noise_dof
            )
    # Probabilities of loud effects are 0; the one that explains most is then the closest.
    best = int(np.lexsort((-explained, p_values))[0])
    family = float(-np.expm1(len(effects) * np.log1p(-min(p_values[best], 1.0 - 1e-16))))
    return Undetected(
        effects[best],
        family,
        dict(zip(names, bounds.max(axis=0).tolist())),
        {name: effects[i] for name, i in zip(names, bounds.argmax(axis=0))},
        dict(zip(effects, p_values.tolist())),
    )


def _single(
    score: FloatArray, size: FloatArray, bias: FloatArray, low: FloatArray, high: FloatArray, dof: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """p-values (K,) and T (K,) of effects with one signature of unit norm, ``size`` of which survives; bounds (K, Q)."""
    seen = size > _ABSORBED
    size = np.where(seen, size, 1.0)
    side = np.where(low == 0.0, 1.0, np.where(high == 0.0, -1.0, 0.0))
    strength = np.where(seen, score**2 / size, 0.0)
    p = np.where(seen, fdtrc(1.0, dof, strength), 1.0)
    p = np.where(side == 0.0, p, np.where(side * score > 0.0, 0.5 * p, 1.0))
    estimate = score / size
    estimate = np.abs(np.where(side == 0.0, estimate, np.maximum(side * estimate, 0.0)))
    most = np.where(seen, estimate + _Z / np.sqrt(size), np.inf)
    most = np.minimum(most, np.maximum(np.abs(low), np.abs(high)))
    return p, strength, np.where(bias == 0.0, 0.0, np.abs(bias) * most).T


def _several(
    score: FloatArray, gram: FloatArray, bias: FloatArray, reach: FloatArray, dof: float
) -> tuple[float, float, FloatArray]:
    """p-value and T of an effect with k signatures of unit norm, bounds (Q,) of biases (Q, k); strengths at most ``reach``."""
    within = _at_most(bias, reach)
    size, vector = np.linalg.eigh(gram)
    seen = size > _ABSORBED
    if not seen.any():
        return 1.0, 0.0, within
    vector, size = vector[:, seen], size[seen]
    projected = vector.T @ score
    k, total = int(seen.sum()), float(np.sum(projected**2 / size))
    visible = bias @ vector
    bound = np.abs(visible @ (projected / size)) + _Z * np.sqrt(np.sum(visible**2 / size, axis=1))
    if k < score.size:
        bound += _at_most(bias - visible @ vector.T, reach)
    return float(fdtrc(k, dof, total / k)), total, np.minimum(bound, within)


def _at_most(bias: FloatArray, reach: FloatArray) -> FloatArray:
    """Largest |b' a| (Q,) for |a| <= ``reach`` (k,), of biases (Q, k)."""
    return np.asarray(np.sum(np.where(bias == 0.0, 0.0, np.abs(bias) * reach), axis=1))
