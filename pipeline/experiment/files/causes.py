"""Which columns move others: further drives among unnamed columns are those that no drive moves, and that move others.

    y[n] = sum_i a_i y[n-i] + sum_(i,d) b_id u_d[n-i] + e,      i = 1 .. p for y, 0 .. p for u

u moves y if the b are significant (F-test).  The a hold resonances, whose memory is longer than p samples.
Source: Granger, Econometrica 37 (1969) 424.

Shapes: N samples, K columns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import fdtrc

from ...arrays import FloatArray

#: Largest p, and samples that are used: four modes, in well below a second.
_ORDER, _SAMPLES = 12, 20_000
#: Probability of calling noise a cause, over all pairs of columns.
_ALPHA = 1e-3


def moves(drive: FloatArray, sense: FloatArray) -> bool:
    """Whether a drive (N,) moves a sense (N,)."""
    return _p_moved(_scaled(np.stack([drive, sense], axis=1)), 1, [0], ()) < _ALPHA


def further_drives(columns: FloatArray) -> tuple[int, ...]:
    """Indices of the columns (N, K) that are drives beside the first one; they stand next to it, as inputs do in a table."""
    used = _scaled(columns)
    alpha = _ALPHA / max(used.shape[1] * (used.shape[1] - 1), 1)
    drives = [0]
    for k in range(1, used.shape[1] - 1):
        behind = range(k + 1, used.shape[1])
        if _p_moved(used, k, drives, ()) < alpha or all(_p_moved(used, j, [k], drives) >= alpha for j in behind):
            break
        drives.append(k)
    return tuple(drives[1:])


def _scaled(columns: FloatArray) -> FloatArray:
    used = columns[:_SAMPLES]
    scale = used.std(axis=0)
    return np.asarray((used - used.mean(axis=0)) / np.where(scale > 0.0, scale, 1.0))


def _p_moved(columns: FloatArray, moved: int, by: Sequence[int], beside: Sequence[int]) -> float:
    """Probability that noise explains as much of a column as the columns ``by`` do, beside its own past and ``beside``."""
    samples = columns.shape[0]
    order = min(_ORDER, samples // 100)
    rows = samples - order
    if order < 1:
        return 1.0

    def past(k: int, first: int) -> list[FloatArray]:
        return [columns[order - i : samples - i, k] for i in range(first, order + 1)]

    y = columns[order:, moved]
    known = np.stack([*past(moved, 1), *(part for k in beside for part in past(k, 0))], axis=1)
    more = np.stack([part for k in by for part in past(k, 0)], axis=1)
    left = [
        float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=1e-10)[0]) ** 2)) for x in (known, np.hstack([known, more]))
    ]
    free = rows - known.shape[1] - more.shape[1]
    if free < 1 or left[1] <= 1e-20 * rows:
        return 1.0
    return float(fdtrc(more.shape[1], free, (left[0] - left[1]) / more.shape[1] / (left[1] / free)))
