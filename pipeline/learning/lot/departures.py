"""How a lot departs from a model all of whose numbers are given: every mean, pattern and spread, tested together.

    mean, pattern   t = X' P y,          b = (X' P X)^-1 t,          t' (X' P X)^-1 t  chi-square
    spread          Q = y' P V_c P y,    E[Q] = tr P V_c + (v - v0) tr (P V_c)^2,      Var Q = 2 tr (P V_c)^2  at v0

so that v = v0 + 2 (Q - E Q) / Var Q is unbiased; v0 is 1 for a spread of the population's file and 0 for one that it lacks.  The
mean and variance of Q are those of lots drawn from the model, its p-value is that of a gamma distribution with their skewness, or
below the mean that of a chi-square one.
The family-wise p-value is 1 - (1 - p)^K, with K the number of independent tests that the smallest p of each drawn lot shows.

Shapes: n devices, q quantities, B draws.
Source: Searle, Casella, McCulloch, Variance Components (1992), ch. 11 (quadratic unbiased estimates); Westfall, Young,
Resampling-Based Multiple Testing (1993); Sidak, JASA 62 (1967) 626.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import chi2, norm

from ...arrays import FloatArray
from .elimination import solved
from .family import family_wise, independent_tests, skewed_log_tail
from .model import FixedPart, RandomPart
from .null import null_draws, projected
from .reml import LotFit
from .scores import statistic_of

DepartureKind = Literal["mean", "pattern", "spread"]
#: Lots drawn for a null: the number of independent tests is then known to 5 %.
DRAWS = 400
#: Smallest p-value that is given.
SMALLEST = 1e-300
#: Share of X' D^-1 X, D the variance of single devices, below which the fixed part of the model absorbs a part.
ABSORBED = 1e-6


@dataclass(frozen=True)
class Departure:
    """One number of the model beside what the lot says.

    Parameters
    ----------
    name : of the part.
    kind, level : what it is, and which units share it ("all": every device).
    stated, estimate, low, high : the number that the model states, the lot's own, and its 90 % interval: the ratio of a spread
        to that of the part's columns, or the coefficient of a pattern or mean [of its columns].
    log_p, p_value : ln of the p-value alone, and family-wise.
    """

    name: str
    kind: DepartureKind
    level: str
    stated: float
    estimate: float
    low: float
    high: float
    log_p: float
    p_value: float = 1.0


@dataclass(frozen=True)
class Tested:
    """All departures, the least probable first; ``tests`` is the number of independent tests among them."""

    departures: tuple[Departure, ...]
    tests: float

    @property
    def p_value(self) -> float:
        """Probability that a lot of the model departs as far in any of them."""
        return min((one.p_value for one in self.departures), default=1.0)


def departures_of(
    fit: LotFit, absent: Sequence[FixedPart | RandomPart], two_sided: bool, others: Sequence[float] = (), seed: int = 0
) -> tuple[Tested, tuple[float, ...]]:
    """Test the spreads of the model of ``fit`` at its variances, and parts that it lacks.

    Parameters
    ----------
    fit : whose variances are taken as given.
    absent : parts with the null value 0.
    two_sided : whether the spreads of the model itself are tested, for being too large or too small.
    others : ln of p-values of further tests of the same family, independent of these.

    Returns
    -------
    The departures, and the family-wise p-values of ``others``.
    """
    draws = null_draws(fit, DRAWS, seed, [statistic_of(part, fit.lot, fit.design) for part in absent])
    tested = list(zip(absent, draws.statistics))
    rows = [_pattern(fit, part, t) for part, t in tested if isinstance(part, FixedPart)]
    if two_sided:
        rows += [_spread(part.name, part.level, draws.squares[k], 1.0, True) for k, part in enumerate(fit.model.random)]
    rows += [_spread(part.name, part.level, q[0], 0.0, False) for part, q in tested if isinstance(part, RandomPart)]
    shown = [row for row in rows if row is not None]
    tests = (independent_tests(np.stack([null for _, null in shown])) if shown else 0.0) + len(others)
    found = sorted((_with_family(one, tests) for one, _ in shown), key=lambda one: one.log_p)
    return Tested(tuple(found), tests), tuple(_family(log_p, tests) for log_p in others)


def smallest_seen(fit: LotFit, part: FixedPart, tests: float, false_alarm: float, power: float = 0.9) -> float:
    """Coefficient of a part of one column that a family of ``tests`` finds with this power."""
    information = float(_information(fit, part)[0][0, 0])
    single = -np.expm1(np.log1p(-false_alarm) / max(tests, 1.0))
    return float((norm.isf(0.5 * single) + norm.ppf(power)) / np.sqrt(information)) if information > 0.0 else np.inf


_Row = tuple[Departure, FloatArray]


def _information(fit: LotFit, part: FixedPart) -> tuple[FloatArray, FloatArray]:
    """X' P X (p, p), and X (n, q, p) where it was seen."""
    x = part.columns * fit.design.seen[..., None]
    image = projected(fit.factor, solved(fit.factor, x))
    found = np.einsum("nqa,nqb->ab", x, image)
    return 0.5 * (found + found.T), x


def _pattern(fit: LotFit, part: FixedPart, t: FloatArray) -> _Row | None:
    information, x = _information(fit, part)
    values, vectors = np.linalg.eigh(information)
    if values.max() <= ABSORBED * float(np.sum((fit.factor.white @ x) ** 2)):
        return None
    keep = values > 1e-9 * values.max()
    squares = np.sum((vectors[:, keep].T @ t) ** 2 / values[keep, None], axis=0)
    log_p = np.asarray(chi2.logsf(squares, int(keep.sum())))
    inverse = vectors[:, keep] / values[keep] @ vectors[:, keep].T
    b = inverse @ t[:, 0]
    half = float(norm.ppf(0.95) * np.sqrt(np.trace(inverse) / len(b)))
    one = float(b[0]) if len(b) == 1 else float(np.linalg.norm(b))
    low = one - half if len(b) == 1 else max(one - half, 0.0)
    kind: DepartureKind = "mean" if part.name.startswith("mean(") else "pattern"
    stated = 0.0 if part.size is None else 1.0
    return Departure(part.name, kind, "all", stated, one + stated, low + stated, one + half + stated, log_p[0]), log_p[
        1:
    ]


def _spread(name: str, level: str, squares: FloatArray, stated: float, two_sided: bool) -> _Row | None:
    null = squares[1:]
    middle, variance = float(null.mean()), float(null.var(ddof=1))
    if variance <= (1e-9 * middle) ** 2:
        return None
    z = (squares - middle) / np.sqrt(variance)
    log_p = skewed_log_tail(z)
    freedom = 2.0 * middle**2 / variance
    if two_sided:
        # Below, a chi-square variable with the mean and variance of Q, which ends at zero as Q does.
        below = chi2.logcdf(np.maximum(squares * freedom / middle, 1e-300), freedom)
        log_p = np.minimum(np.log(2.0) + np.minimum(log_p, below), 0.0)
    ends = squares[0] * freedom / np.maximum(chi2.ppf([0.95, 0.05], freedom), 1e-12)
    sizes = [float(np.sqrt(max(stated + 2.0 * (q - middle) / variance, 0.0))) for q in (squares[0], *ends)]
    estimate, low, high = sizes
    return Departure(name, "spread", level, stated, estimate, low, high, float(log_p[0])), log_p[1:]


def _family(log_p: float, tests: float) -> float:
    return family_wise(max(log_p, float(np.log(SMALLEST))), tests)


def _with_family(one: Departure, tests: float) -> Departure:
    return replace(one, p_value=_family(one.log_p, tests))
