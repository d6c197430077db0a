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
    """Effects that a model lacks: whitened signatures (n, K), the effect of each column, the range (K,) of each strength."""

    effects: tuple[str, ...]
    rows: FloatArray
    low: FloatArray
    high: FloatArray


def undetected(
    jacobian: FloatArray,
    residual: FloatArray,
    candidates: Candidates,
    slopes: Mapping[str, FloatArray],
    noise_dof: float,
) -> Undetected:
    """Scores and bounds.

    Parameters
    ----------
    jacobian, residual : d(model)/dx (n, P) and data - model (n,) at the maximum, in sigmas, with the rows of the prior.
    candidates : columns that are zero in the rows of the prior.
    slopes : quantity -> dq/dx (P,).
    noise_dof : degrees of freedom of the noise level.

    Raises
    ------
    numpy.linalg.LinAlgError : the Jacobian has no full rank.
    """
    p = jacobian.shape[1]
    whole = np.concatenate([jacobian, candidates.rows, residual[:, None]], axis=1)
    scale = np.linalg.norm(whole, axis=0)
    scale[scale == 0.0] = 1.0
    whole /= scale
    products = whole.T @ whole
    # In units of the norms of the columns, J' J loses eight of sixteen digits at most.
    factor = cholesky(products[:p, :p], lower=True)
    overlap = solve_triangular(factor, products[:p, p:], lower=True)
    left = products[p:, p:] - overlap.T @ overlap
    score, gram = left[:-1, -1] * scale[-1], left[:-1, :-1]
    moved = solve_triangular(factor, overlap[:, :-1], lower=True, trans="T") / scale[:p, None]
    names = list(slopes)
    bias = np.stack([slopes[q] for q in names]) @ moved
    low, high = candidates.low * scale[p:-1], candidates.high * scale[p:-1]
    p_values: dict[str, float] = {}
    explained: dict[str, float] = {}
    largest, causes = np.zeros(len(names)), np.zeros(len(names), dtype=np.int64)
    effects = list(dict.fromkeys(candidates.effects))
    for i, effect in enumerate(effects):
        own = [k for k, name in enumerate(candidates.effects) if name == effect]
        p_values[effect], explained[effect], bound = _judged(
            score[own], gram[np.ix_(own, own)], bias[:, own], low[own], high[own], noise_dof
        )
        causes[bound > largest] = i
        largest = np.maximum(bound, largest)
    # Probabilities of loud effects are 0; the one that explains most is then the closest.
    effect = min(p_values, key=lambda name: (p_values[name], -explained[name]))
    family = float(-np.expm1(len(effects) * np.log1p(-min(p_values[effect], 1.0 - 1e-16))))
    by = {name: effects[i] for name, i in zip(names, causes)}
    return Undetected(effect, family, dict(zip(names, largest.tolist())), by, p_values)


def _judged(
    score: FloatArray, gram: FloatArray, bias: FloatArray, low: FloatArray, high: FloatArray, dof: float
) -> tuple[float, float, FloatArray]:
    """p-value and T of one effect with signatures of unit norm, and bounds (Q,) of the biases (Q, k) that it can cause."""
    reach = np.maximum(np.abs(low), np.abs(high))
    within = _at_most(bias, reach)
    size, vector = np.linalg.eigh(gram)
    seen = size > _ABSORBED
    if not seen.any():
        return 1.0, 0.0, within
    vector, size = vector[:, seen], size[seen]
    projected = vector.T @ score
    k, total = int(seen.sum()), float(np.sum(projected**2 / size))
    p = float(fdtrc(k, dof, total / k))
    estimate = vector @ (projected / size)
    if score.size == 1 and (low[0] == 0.0 or high[0] == 0.0):
        sign = 1.0 if low[0] == 0.0 else -1.0
        p = 0.5 * p if sign * score[0] > 0.0 else 1.0
        estimate = sign * np.maximum(sign * estimate, 0.0)
    visible = bias @ vector
    bound = np.abs(bias @ estimate) + _Z * np.sqrt(np.sum(visible**2 / size, axis=1))
    if k < score.size:
        bound += _at_most(bias - visible @ vector.T, reach)
    return p, total, np.minimum(bound, within)


def _at_most(bias: FloatArray, reach: FloatArray) -> FloatArray:
    """Largest |b' a| (Q,) for |a| <= ``reach`` (k,), of biases (Q, k)."""
    return np.asarray(np.sum(np.where(bias == 0.0, 0.0, np.abs(bias) * reach), axis=1))
