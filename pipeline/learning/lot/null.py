"""What the residual of a fitted lot looks like when nothing is missing: lots drawn from the fitted model.

    y* = sum Z sqrt(v) u* + D^(1/2) e*,      p = P y

P y is all that the data say beyond the fixed columns; every score is a function of it.  The same function of p* has the null
distribution, with the estimated means projected out exactly.  The drawn lots are evaluated in blocks, because those of 20,000
devices with 8 quantities would take 0.5 GB.

Shapes: n devices, q quantities, B draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from .derivatives import squares_of
from .elimination import LotFactor, LotSolution, solved
from .reml import LotFit

#: Values p of drawn lots that are held at once: 128 MiB, of which four arrays stand side by side.
HELD = 2**24

#: A function (k, B) of p (n, q, B).
Statistic = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class NullDraws:
    """The measured lot and B drawn ones, in this order.

    Parameters
    ----------
    squares : (C, 1 + B) y' P V_c P y of each fitted part.
    statistics : (k, 1 + B) each, in the order in which they were asked for.
    """

    squares: FloatArray
    statistics: tuple[FloatArray, ...]


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


def null_draws(fit: LotFit, count: int, seed: int, statistics: Sequence[Statistic]) -> NullDraws:
    """``statistics`` of the measured lot and of ``count`` lots drawn from the fit."""
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    factor, most = fit.factor, max(HELD // fit.design.seen.size, 1)
    p, squares = projected(factor, fit.solution), squares_of(factor, fit.solution)[:, :1]
    found: list[list[FloatArray]] = []
    for first in range(0, count, most):
        solution = solved(factor, drawn_values(factor, min(most, count - first), generator))
        p = np.concatenate([p, projected(factor, solution)], axis=2)
        squares = np.concatenate([squares, squares_of(factor, solution)], axis=1)
        found.append([statistic(p) for statistic in statistics])
        p = p[:, :, :0]
    return NullDraws(squares, tuple(np.concatenate(blocks, axis=1) for blocks in zip(*found)))
