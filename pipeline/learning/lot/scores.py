"""Score tests of what a lot's model lacks, without refits, against a simulated null.

    random part:  Q = |Z' p|^2,     E = Q - b' squares,   b the regression of Q on the squares of the fitted parts over draws
    fixed part:   t = X' p,         chi2 = t' Cov(t)^-1 t

E is the efficient score: what is left of Q once the fitted variances may adapt.  A variance cannot be negative, so that only
a large E counts.  Its p-value is that of a gamma distribution with the mean, sd and skewness of the drawn E; the family-wise one
comes from the smallest p-value of each drawn lot, p_family = 1 - (1 - p)^K with K the number of independent tests that fits it.

Shapes: n devices, q quantities, B draws.
Source: Verbeke, Molenberghs, Biometrics 59 (2003) 254 (score tests of variance components); Sidak, JASA 62 (1967) 626.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from ...arrays import BoolArray, FloatArray
from .design import LotDesign, field_roots
from .family import family_wise, independent_tests, skewed_log_tail
from .measured import MeasuredLot
from .model import FixedPart, RandomPart
from .null import NullDraws, Statistic

Part = RandomPart | FixedPart
#: Share of a score's sd that the fitted variances leave, below which this lot cannot show the part.
INVISIBLE = 0.02
#: Relative size of a fixed column beside the fitted ones, below which it is absorbed.
ABSORBED = 1e-3


@dataclass(frozen=True)
class LotScore:
    """Score of one part.

    Parameters
    ----------
    name : of the part.
    z : efficient score in sds of the null, or the root of chi2 for a fixed part.
    log_p : ln of its p-value alone.
    p_value : family-wise.
    surviving_share : share of the score's sd that the fitted parts do not absorb.
    """

    name: str
    z: float
    log_p: float
    p_value: float
    surviving_share: float

    @property
    def visible(self) -> bool:
        """Whether this lot could show the part."""
        return self.surviving_share > INVISIBLE


def statistic_of(part: Part, lot: MeasuredLot, design: LotDesign) -> Statistic:
    """t (k, B) of a fixed part, |Z' p|^2 (1, B) of a random one."""
    if isinstance(part, FixedPart):
        x = part.columns * design.seen[..., None]
        used = np.flatnonzero(np.any(x != 0.0, axis=(0, 2)))
        flat = x[:, used].reshape(-1, x.shape[2]).T
        return lambda p: np.asarray(flat @ p[:, used].reshape(-1, p.shape[2]))
    return lambda p: squares_of_part(part, lot, design, p)[None]


def scored(design: LotDesign, draws: NullDraws, parts: Sequence[Part], active: BoolArray) -> tuple[LotScore, ...]:
    """Scores of absent parts, in their order.

    Parameters
    ----------
    draws : with the ``statistic_of`` each part.
    active : (C,) the fitted parts whose variance is not at zero, and adapts.
    """
    nuisance = draws.squares[active]
    basis = np.linalg.qr(design.columns[:, :, design.ends[2] :].reshape(-1, design.fixed))[0]
    rows = [
        _of_fixed(part, design, t, basis) if isinstance(part, FixedPart) else _of_random(t[0], nuisance)
        for part, t in zip(parts, draws.statistics)
    ]
    if not rows:
        return ()
    log_p = np.stack([row[0] for row in rows])  # (parts, 1 + B)
    visible = np.array([row[2] > INVISIBLE for row in rows])
    tests = independent_tests(log_p[visible, 1:]) if np.any(visible) else 1.0
    return tuple(
        LotScore(
            name=part.name,
            z=float(z),
            log_p=float(one[0]),
            p_value=family_wise(float(one[0]), tests) if share > INVISIBLE else 1.0,
            surviving_share=float(share),
        )
        for part, (one, z, share) in zip(parts, rows)
    )


def _of_fixed(part: FixedPart, design: LotDesign, t: FloatArray, basis: FloatArray) -> tuple[FloatArray, float, float]:
    x = part.columns * design.seen[..., None]
    # Cov(t) = X' P X, measured on the drawn lots; its scale without the fitted columns shows what they absorb.
    covariance = np.atleast_2d(np.cov(t[:, 1:]))
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-12 * max(float(values.max()), 1e-300)
    flat = x.reshape(-1, x.shape[2])
    left = flat - basis @ (basis.T @ flat)
    share = float(np.sqrt(np.sum(left**2) / max(float(np.sum(flat**2)), 1e-300)))
    if share < ABSORBED or not np.any(keep):
        return np.zeros(t.shape[1]), 0.0, 0.0
    squares = np.sum((vectors[:, keep].T @ t) ** 2 / values[keep, None], axis=0)
    log_p = np.asarray(chi2.logsf(squares, int(keep.sum())))
    return log_p, float(-norm.ppf(max(np.exp(log_p[0]), 1e-300))), 1.0


def _of_random(q: FloatArray, nuisance: FloatArray) -> tuple[FloatArray, float, float]:
    null = q[1:]
    middle = nuisance[:, 1:].mean(axis=1, keepdims=True)
    known = nuisance - middle
    b = np.linalg.lstsq(known[:, 1:].T, null - null.mean(), rcond=1e-8)[0] if len(known) else np.zeros(0)
    efficient = q - null.mean() - b @ known
    sd = float(np.std(efficient[1:]))
    whole = float(np.std(null))
    if whole == 0.0 or sd / whole < INVISIBLE:
        return np.zeros(q.size), 0.0, 0.0 if whole == 0.0 else sd / whole
    z = efficient / sd
    return skewed_log_tail(z), float(z[0]), sd / whole


def squares_of_part(part: RandomPart, lot: MeasuredLot, design: LotDesign, p: FloatArray) -> FloatArray:
    """|Z' p|^2 (B,) of a part, for p (n, q, B)."""
    seen = part.columns * design.seen[..., None]
    used = np.flatnonzero(np.any(seen != 0.0, axis=(0, 2)))
    # (n, m, B): most parts act on one or two quantities only.
    own = np.einsum("nqm,nqb->nmb", seen[:, used], p[:, used], optimize=True)
    if part.level == "device":
        return np.asarray(np.einsum("nmb,nmb->b", own, own))
    if part.field_mm is not None:
        roots = field_roots(lot, design.slots, part.field_mm)
        total = np.zeros(p.shape[2])
        for row in design.slots:
            mine = row[row >= 0]
            sums = roots[mine, : len(mine)].T @ own[mine, 0]
            total += np.sum(sums**2, axis=0)
        return total
    codes = np.zeros(len(p), dtype=np.int64) if part.level == "all" else lot.codes(part.level)
    order = np.argsort(codes, kind="stable")
    starts = np.flatnonzero(np.diff(codes[order], prepend=-1))
    sums = np.add.reduceat(own[order], starts, axis=0)
    return np.asarray(np.einsum("umb,umb->b", sums, sums))
