"""The yield and its uncertainty.

    yield = passed / devices; an undecided device is neither, so yield is bounded by passed / n and (passed
    + undecided) / n

Three separate uncertainties:

- measurement: which of these devices conform.  The number is a sum of independent Bernoulli(p_pass), a
  Poisson-binomial variable: mean sum p, variance sum p (1 - p).
- sampling: how well these devices, as independent draws, represent the process: binomial.
- clustering: devices of a wafer (or lot) are not independent draws of the process; see ``clusters``.

Yields and probabilities are shares of one, not percent.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, ndtri

from pipeline.arrays import FloatArray
from pipeline.errors import UsageError

from .coded import CodedText, IntArray, coded, paired

LEVEL = 0.95
# Products of polynomials up to this length are computed for all pairs at once: one by one, calls outweigh the arithmetic.
_SHORT = 65


@dataclass(frozen=True)
class Interval:
    """low <= value <= high with confidence ``level``, by ``method``."""

    low: float
    high: float
    method: str
    level: float = LEVEL


@dataclass(frozen=True)
class Measurement:
    """The number of conforming devices according to the posteriors.

    Parameters
    ----------
    judged : devices with a probability of conformity.
    unknown : devices without one; they are excluded from all figures here.
    mean, sd : of the number of conforming devices among the judged.
    low, high : central interval of that number at ``LEVEL``.
    """

    judged: int
    unknown: int
    mean: float
    sd: float
    low: int
    high: int


@dataclass(frozen=True)
class Yield:
    """Counts and intervals of one set of devices.

    Parameters
    ----------
    devices, passed, failed, undecided : counts.
    value : passed / devices; nan for no devices.
    bounds : the yield if all undecided failed, and if all passed.
    clopper_pearson, wilson : sampling intervals of ``value``.
    envelope : Clopper-Pearson from its lower end with all undecided failing to its upper with all passing.
    """

    devices: int
    passed: int
    failed: int
    undecided: int
    value: float
    bounds: tuple[float, float]
    clopper_pearson: Interval
    wilson: Interval
    envelope: Interval


@dataclass(frozen=True)
class GroupYield:
    """The yield of one wafer or lot."""

    lot: str
    wafer: str
    result: Yield


def clopper_pearson(count: float, n: float, level: float = LEVEL) -> Interval:
    """Exact binomial interval: low = Beta^-1(a/2; k, n-k+1), high = Beta^-1(1-a/2; k+1, n-k), a = 1 - level.

    ``count`` and ``n`` may be effective (not whole) numbers; n = 0 gives [0, 1].
    Clopper and Pearson 1934, Biometrika 26:404.
    """
    tail = 0.5 * (1.0 - level)
    low = float(betaincinv(count, n - count + 1.0, tail)) if count > 0 else 0.0
    high = float(betaincinv(count + 1.0, n - count, 1.0 - tail)) if count < n else 1.0
    return Interval(low, high, "Clopper-Pearson", level)


def wilson(count: float, n: float, level: float = LEVEL) -> Interval:
    """Score interval: the p with abs(count/n - p) <= z sqrt(p (1 - p)/n); n = 0 gives [0, 1].

    Wilson 1927, J. Am. Stat. Assoc. 22:209.
    """
    if n <= 0:
        return Interval(0.0, 1.0, "Wilson", level)
    z = float(ndtri(0.5 * (1.0 + level)))
    share, z2 = count / n, z * z
    centre = (share + z2 / (2.0 * n)) / (1.0 + z2 / n)
    half = z / (1.0 + z2 / n) * np.sqrt(share * (1.0 - share) / n + z2 / (4.0 * n * n))
    # At 0 and n the exact ends are 0 and 1; rounding would miss them.
    low = 0.0 if count <= 0 else float(centre - half)
    high = 1.0 if count >= n else float(centre + half)
    return Interval(low, high, "Wilson", level)


def yield_of(passed: int, failed: int, undecided: int = 0, level: float = LEVEL) -> Yield:
    """passed / (passed + failed + undecided), its bounds and its sampling intervals.

    Raises
    ------
    UsageError : a count is negative.
    """
    if min(passed, failed, undecided) < 0:
        raise UsageError(
            "counts of devices cannot be negative",
            value=(passed, failed, undecided),
            allowed=">= 0",
            next_step="count the verdicts",
        )
    n = passed + failed + undecided
    most = passed + undecided
    return Yield(
        devices=n,
        passed=passed,
        failed=failed,
        undecided=undecided,
        value=passed / n if n else float("nan"),
        bounds=(passed / n, most / n) if n else (0.0, 1.0),
        clopper_pearson=clopper_pearson(passed, n, level),
        wilson=wilson(passed, n, level),
        envelope=Interval(
            clopper_pearson(passed, n, level).low,
            clopper_pearson(most, n, level).high,
            "Clopper-Pearson, undecided either way",
            level,
        ),
    )


def yield_of_verdicts(verdicts: Sequence[str], level: float = LEVEL) -> Yield:
    """The yield of a list of verdicts; any other value than "pass" or "fail" counts as undecided."""
    counts = coded(verdicts).counts()
    passed, failed = counts.get("pass", 0), counts.get("fail", 0)
    return yield_of(passed, failed, len(verdicts) - passed - failed, level)


def poisson_binomial(probability: FloatArray) -> FloatArray:
    """(n + 1,) P(K = k) of a sum K of independent Bernoulli(p_i), p (n,): coefficients of prod (1 - p_i + p_i x).

    Probabilities below 1e-40 are given as 0; those of all k beyond are then below n 1e-40 together.
    """
    n = probability.size
    # Products of equal degree are cheap and accurate; a device that never conforms (p = 0) changes no product.
    whole = np.zeros(max(1, 1 << max(n - 1, 0).bit_length()))
    whole[:n] = probability
    factors = np.stack([1.0 - whole, whole], axis=1)
    while len(factors) > 1 and factors.shape[1] <= _SHORT:
        a, b = factors[::2], factors[1::2]
        factors = np.zeros((len(a), 2 * a.shape[1] - 1))
        for k in range(a.shape[1]):
            factors[:, k : k + a.shape[1]] += a[:, k : k + 1] * b
    parts = [_trimmed(0, row) for row in factors]
    while len(parts) > 1:
        parts = [
            _trimmed(low + other, np.convolve(a, b))
            for (low, a), (other, b) in zip(parts[::2], parts[1::2], strict=True)
        ]
    first, found = parts[0]
    pmf = np.zeros(max(n + 1, first + found.size))
    pmf[first : first + found.size] = found
    return np.clip(pmf[: n + 1], 0.0, 1.0)


def _trimmed(first: int, pmf: FloatArray) -> tuple[int, FloatArray]:
    """P(K = k) from k = ``first`` on without the negligible ends: of 10^5 devices some 10^4 values of k are left."""
    kept = np.flatnonzero(pmf > 1e-40)
    return first + int(kept[0]), pmf[kept[0] : kept[-1] + 1]


def measurement_uncertainty(p_pass: FloatArray, level: float = LEVEL) -> Measurement:
    """The number of conforming devices given p_pass (B,), nan where unknown: Poisson-binomial, central interval."""
    known = p_pass[np.isfinite(p_pass)]
    # Certain devices only shift the count.
    certain = int(np.sum(known == 1.0))
    uncertain = known[(known > 0.0) & (known < 1.0)]
    cumulative = np.cumsum(poisson_binomial(uncertain))
    tail = 0.5 * (1.0 - level)
    low = int(np.searchsorted(cumulative, tail))
    high = int(np.searchsorted(cumulative, 1.0 - tail))
    return Measurement(
        judged=int(known.size),
        unknown=int(p_pass.size - known.size),
        mean=float(np.sum(known)),
        sd=float(np.sqrt(np.sum(known * (1.0 - known)))),
        low=certain + low,
        high=certain + min(high, uncertain.size),
    )


def by_group(
    verdicts: Sequence[str], lots: Sequence[str], wafers: Sequence[str] | None = None
) -> tuple[GroupYield, ...]:
    """The yield of each lot, or of each wafer of each lot where ``wafers`` are given, in order of name."""
    keys, index = groups_of(lots, wafers)
    found = coded(verdicts)
    number, passed, failed = (
        np.bincount(index[rows], minlength=len(keys))
        for rows in (np.ones(len(found), dtype=np.bool_), found.equals("pass"), found.equals("fail"))
    )
    place = {name: natural(name) for name in {name for key in keys for name in key}}
    order = sorted(range(len(keys)), key=lambda k: (place[keys[k][0]], place[keys[k][1]]))
    return tuple(
        GroupYield(*keys[k], yield_of(int(passed[k]), int(failed[k]), int(number[k] - passed[k] - failed[k])))
        for k in order
    )


def groups_of(lots: Sequence[str], wafers: Sequence[str] | None) -> tuple[tuple[tuple[str, str], ...], IntArray]:
    """Names of the groups, (lot, wafer) or (lot, "") without ``wafers``, and the number (B,) of each device's group."""
    return paired(
        coded(lots), CodedText(("",), np.zeros(len(lots), dtype=np.int64)) if wafers is None else coded(wafers)
    )


def natural(name: str) -> tuple[tuple[int, str], ...]:
    """A sort key for names with numbers: W2 comes before W10."""
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name))
