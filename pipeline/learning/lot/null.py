"""What the residual of a fitted lot looks like when nothing is missing: lots drawn from the fitted model.

    y* = sum Z sqrt(v) u* + D^(1/2) e*,      p = P y

P y is all that the data say beyond the fixed columns; every score is a function of it.  The same function of p* has the null
distribution, with the estimated means projected out exactly.

Shapes: n devices, q quantities, B draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from .derivatives import squares_of
from .elimination import LotFactor, LotSolution, solved
from .reml import LotFit


@dataclass(frozen=True, eq=False)
class NullDraws:
    """The measured lot and B drawn ones, in this order.

    Parameters
    ----------
    projected : (n, q, 1 + B) p.
    squares : (C, 1 + B) y' P V_c P y of each fitted part.
    """

    projected: FloatArray
    squares: FloatArray


def drawn_values(factor: LotFactor, count: int, generator: np.random.Generator) -> FloatArray:
    """(n, q, B) lots from the fitted model, without its fixed part."""
    design = factor.design
    n, q = design.seen.shape
    root = np.linalg.inv(factor.white)
    y = root @ generator.standard_normal((n, q, count))
    scale = np.where(design.part >= 0, np.sqrt(factor.variances[design.part]), 0.0)
    there = design.slots >= 0
    wafer_of = np.empty(n, dtype=np.int64)
    wafer_of[design.slots[there]] = np.nonzero(there)[0]
    a, b, c = design.ends
    units = (wafer_of, design.lot_of[wafer_of], np.zeros(n, dtype=np.int64))
    for unit, low, high in zip(units, (0, a, b), (a, b, c)):
        if high == low:
            continue
        normals = generator.standard_normal((int(unit.max()) + 1, high - low, count))
        for one in range(len(normals)):
            mine = unit == one
            columns = (design.columns[mine][:, :, low:high] * scale[low:high]).reshape(-1, high - low)
            y[mine] += (columns @ normals[one]).reshape(-1, q, count)
    return y * design.seen[..., None]


def projected(factor: LotFactor, solution: LotSolution) -> FloatArray:
    """(n, q, B) P y."""
    return np.einsum("nji,njb->nib", factor.white, factor.design.unpadded(solution.residual))


def null_draws(fit: LotFit, count: int, seed: int) -> NullDraws:
    """The measured lot and ``count`` lots drawn from the fit."""
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    drawn = drawn_values(fit.factor, count, generator)
    solution = solved(fit.factor, drawn)
    own = fit.solution
    return NullDraws(
        np.concatenate([projected(fit.factor, own), projected(fit.factor, solution)], axis=2),
        np.concatenate([squares_of(fit.factor, own)[:, :1], squares_of(fit.factor, solution)], axis=1),
    )
