"""Slopes at the maximum of the likelihood: of the model's spectrum, and of the quantities.

Shapes: P parameters, S = 2 senses, J features, Q quantities, B devices.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ....arrays import ComplexArray, FloatArray
from ....axial import wrap
from ....quantities import AXES, IDENTIFIED
from ...estimate import RateSettings, cartesian_quantities
from ..fit import Fit
from ..likelihood import FEATURES, STEPS, coefficients
from ..mismatch import MismatchPrior, mean_plant

#: Names of the quantities that are known, and dq/dx (Q, P).
QuantitySlopes = tuple[tuple[str, ...], FloatArray]


def feature_slopes(fit: Fit) -> FloatArray:
    """Slopes (P, S, J), per unit of x, of the coefficients of the model's spectrum in the features of the fit."""
    slopes = np.empty((fit.x.size, 2, FEATURES))
    _feature_slopes(fit.x, fit.likelihood.expansion, slopes)
    return slopes


@njit(cache=True)
def _feature_slopes(x: FloatArray, expansion: ComplexArray, out: FloatArray) -> None:
    ahead, behind, shift = np.empty((2, FEATURES)), np.empty((2, FEATURES)), np.empty(3)
    for i in range(x.size):
        moved = x.copy()
        moved[i] = x[i] + STEPS[i]
        coefficients(moved, expansion, ahead, shift)
        moved[i] = x[i] - STEPS[i]
        coefficients(moved, expansion, behind, shift)
        for a in range(2):
            for j in range(FEATURES):
                out[i, a, j] = (ahead[a, j] - behind[a, j]) / (2.0 * STEPS[i])


def quantity_slopes(x: FloatArray, rate: RateSettings, prior: MismatchPrior | None) -> list[QuantitySlopes]:
    """Names of the quantities that are known, and dq/dx (Q, P), of each of the parameters x (B, P)."""
    size = x.shape[1]
    step = STEPS[:size]
    moves = np.concatenate([np.diag(step), -np.diag(step)])
    points = (x[:, None] + moves).reshape(-1, size)
    q = cartesian_quantities(points if prior is None else mean_plant(points, prior), rate)
    names = tuple(quantity.name for quantity in IDENTIFIED)
    both = np.stack([q[name] for name in names]).reshape(len(names), x.shape[0], 2, size)
    change = both[:, :, 0] - both[:, :, 1]
    axes = [names.index(name) for name in AXES]
    change[axes] = wrap(change[axes])
    change /= 2.0 * step
    known = np.asarray(np.isfinite(change).all(axis=2))
    return [
        (tuple(name for name, is_known in zip(names, own) if is_known), change[own, i]) for i, own in enumerate(known.T)
    ]
