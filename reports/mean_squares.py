"""Mean squares of random effects, and the variances that they estimate (Henderson's method III).

    SS of a term = |P(all that do not contain it, and it) y|^2 - |P(the same without it) y|^2,   MS = SS / df
    E SS = sum_j tr(difference of the projections, Z_j Z_j') variance_j + df * variance of the error

Designs may be unbalanced, with missing cells; traces and ranks come from the design itself.

Shapes: N measurements, K terms.  Source: Searle, Casella, McCulloch, Variance Components (1992), ch. 5.5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray, IntArray

REPEATABILITY = "repeatability"


@dataclass(frozen=True, eq=False)
class MeanSquares:
    """Mean squares of K terms, the error last: names, df (K,), MS (K,), and E MS = coefficients (K, K) @ variances."""

    names: tuple[str, ...]
    df: FloatArray
    mean: FloatArray
    coefficients: FloatArray


def mean_squares(
    y: FloatArray, terms: Mapping[str, IntArray], contained_in: Mapping[str, AbstractSet[str]]
) -> MeanSquares:
    """Mean squares of the terms and of what is left; terms without degrees of freedom are left out.

    Parameters
    ----------
    y : measurements (N,).
    terms : name -> group of each measurement (N,).
    contained_in : name -> terms that contain it, which it is not adjusted for.
    """
    designs = {name: (codes[:, None] == np.arange(codes.max() + 1)).astype(np.float64) for name, codes in terms.items()}
    ones = np.ones((y.size, 1))
    # Frequencies differ by 1e-6 of their mean: their squares would lose the differences to rounding.
    y = y - y.mean()
    whole = _basis([ones, *designs.values()])
    rows: list[tuple[str, int, float, FloatArray]] = []
    for name in designs:
        others = [d for other, d in designs.items() if other != name and other not in contained_in.get(name, set())]
        without, with_it = _basis([ones, *others]), _basis([ones, *others, designs[name]])
        df = with_it.shape[1] - without.shape[1]
        if df > 0:
            of = [_sum_of_squares(with_it, d) - _sum_of_squares(without, d) for d in designs.values()]
            square = _sum_of_squares(with_it, y[:, None]) - _sum_of_squares(without, y[:, None])
            rows.append((name, df, square / df, np.array([*of, df]) / df))
    df = y.size - whole.shape[1]
    if df > 0:
        square = float(y @ y) - _sum_of_squares(whole, y[:, None])
        rows.append((REPEATABILITY, df, square / df, np.array([*[0.0] * len(designs), 1.0])))
    kept = [k for k, name in enumerate([*designs, REPEATABILITY]) if name in {row[0] for row in rows}]
    return MeanSquares(
        tuple(row[0] for row in rows),
        np.array([row[1] for row in rows], dtype=np.float64),
        np.array([max(row[2], 0.0) for row in rows]),
        np.array([row[3][kept] for row in rows]),
    )


def _basis(designs: Sequence[FloatArray]) -> FloatArray:
    """Orthonormal columns that span those of the designs (N, rank)."""
    u, s, _ = np.linalg.svd(np.concatenate(designs, axis=1), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def _sum_of_squares(basis: FloatArray, columns: FloatArray) -> float:
    return float(np.sum((basis.T @ columns) ** 2))


def variances_of(squares: MeanSquares, mean: FloatArray) -> FloatArray:
    """Variances (K, D) from mean squares (K, D); negative ones are 0."""
    return np.maximum(np.linalg.solve(squares.coefficients, mean), 0.0)
