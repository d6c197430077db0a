"""Repeatability and reproducibility of the measurement (gauge R&R) from repeated campaigns of the same devices.

    y = mean + part + tester + session within tester + part x tester + repeatability          (all random, normal)
    sum of squares of a term: what it explains beyond the terms that do not contain it;   MS = SS / df,   E MS = C variances
    variances = C^-1 MS, negative ones 0;   C by traces, so that designs may be unbalanced
    part x tester is left out where its F test has p > 0.25 (AIAG), or nothing is repeated
    reproducibility = tester + session + part x tester,   GRR = repeatability + reproducibility,   TV = GRR + part
    % study variation = 100 sd / sd(TV);   % tolerance = 100 * 6 sd / (high - low), with one limit 100 * 3 sd / abs(limit - mean)
    distinct categories = 1.41 sd(part) / sd(GRR)

Intervals are quantiles of generalized pivotal quantities: MS df / chi2_df in the place of MS, 20,000 times.  They are exact for
repeatability and nearly so for the others in balanced designs; in unbalanced ones they take the mean squares as independent.

Shapes: N measurements.
Source: AIAG, Measurement Systems Analysis, 4th ed. (2010), ch. III B and appendix A; Searle, Casella, McCulloch, Variance
Components (1992), ch. 5 (Henderson's method III); Burdick, Borror, Montgomery, Design and Analysis of Gauge R&R Studies (2005),
ch. 2, 6, 8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from pipeline.arrays import FloatArray, IntArray
from pipeline.axial import difference, mean_axis
from pipeline.errors import UsageError

from .interval_estimate import IntervalEstimate
from .limits import Limit
from .mean_squares import REPEATABILITY, MeanSquares, mean_squares, variances_of
from .yields import LEVEL

#: p above which part x tester is pooled with the repeatability: AIAG's and Minitab's convention.
POOLED_ABOVE = 0.25
_DRAWS, _SEED = 20_000, 20_26
#: The design is held as a matrix of this many rows at most: a study then takes 0.5 s.
_MOST = 3000
PART, TESTER, SESSION, INTERACTION = "part", "tester", "session", "part x tester"
#: The terms that contain a term, and so are not adjusted for when its sum of squares is found.
_CONTAINED_IN = {PART: {INTERACTION}, TESTER: {SESSION, INTERACTION}}


@dataclass(frozen=True, eq=False)
class GaugeData:
    """N measurements of a quantity: value [its unit] and the numbers of part, tester and session, each (N,)."""

    value: FloatArray
    part: IntArray
    tester: IntArray
    session: IntArray


@dataclass(frozen=True)
class GaugeComponent:
    """A source of variation: its degrees of freedom (``None`` for a sum), sd, % study variation and % tolerance.

    ``study`` is in percent of the total sd; ``tolerance`` in percent of the tolerance, ``None`` without limits.
    """

    name: str
    df: int | None
    sd: IntervalEstimate
    study: IntervalEstimate
    tolerance: IntervalEstimate | None


@dataclass(frozen=True)
class GaugeStudy:
    """Gauge R&R of a quantity.

    Parameters
    ----------
    measurements, parts, testers, sessions : counts.
    mean : of all measurements, in the unit of the quantity.
    components : repeatability, the parts of reproducibility, reproducibility, GRR, part, total variation.
    categories : number of distinct categories before truncation.
    pooled : part x tester was left out: it is not significant, or cannot be told from the repeatability.
    unknown : terms that the design does not show.
    """

    quantity: str
    measurements: int
    parts: int
    testers: int
    sessions: int
    mean: float
    components: tuple[GaugeComponent, ...]
    categories: IntervalEstimate
    pooled: bool
    unknown: tuple[str, ...]

    def component(self, name: str) -> GaugeComponent:
        """The component of that name."""
        return next(one for one in self.components if one.name == name)


def gauge_study(quantity: str, data: GaugeData, limit: Limit | None = None, axis: bool = False) -> GaugeStudy:
    """Gauge R&R of the measurements of one quantity.

    Parameters
    ----------
    quantity : its name.
    data : measurements; nan are left out.
    limit : its limits, for % tolerance.
    axis : the quantity is an angle modulo 180 deg.

    Raises
    ------
    UsageError : fewer than two parts, nothing measured twice, or too many measurements.
    """
    known = np.isfinite(data.value)
    part, tester, session = (_renumbered(one[known]) for one in (data.part, data.tester, data.session))
    y = unwrapped(data.value[known], part) if axis else data.value[known]
    _check(quantity, y, part)
    terms = _terms(part, tester, session)
    squares = mean_squares(y, terms, _CONTAINED_IN)
    pooled = INTERACTION in squares.names and _p_value(squares) > POOLED_ABOVE
    if pooled:
        terms = {name: codes for name, codes in terms.items() if name != INTERACTION}
        squares = mean_squares(y, terms, _CONTAINED_IN)
    if REPEATABILITY not in squares.names:
        raise UsageError(
            f"gauge R&R of {quantity}: no measurement is repeated, so that the repeatability is unknown",
            value=f"{y.size} measurements",
            allowed="a part that is measured twice by the same tester in the same session, or all parts by several testers",
            next_step="measure some devices again",
        )
    variances = variances_of(squares, squares.mean[:, None])
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(_SEED)))
    chi2 = random.chisquare(squares.df[:, None], (len(squares.names), _DRAWS))
    draws = variances_of(squares, squares.mean[:, None] * squares.df[:, None] / chi2)
    return _study(quantity, y, (part, tester, session), squares, variances, draws, limit, pooled)


def unwrapped(theta: FloatArray, part: IntArray) -> FloatArray:
    """Axes (N,) [deg] as numbers without a jump: those of a part around its own axis, the parts around their common axis."""
    common = mean_axis(theta)
    out = np.empty_like(theta)
    for one in np.unique(part):
        rows = part == one
        own = mean_axis(theta[rows])
        out[rows] = common + difference(np.array(own), common) + difference(theta[rows], own)
    return out


def _renumbered(codes: IntArray) -> IntArray:
    return np.asarray(np.unique(codes, return_inverse=True)[1], dtype=np.int64)


def _check(quantity: str, y: FloatArray, part: IntArray) -> None:
    parts = int(np.unique(part).size)
    if parts < 2 or y.size < parts + 1:
        raise UsageError(
            f"gauge R&R of {quantity} needs parts that are measured more than once",
            value=f"{y.size} measurements of {parts} parts",
            allowed="two parts or more, one of them measured twice or more",
            next_step="name the device in [conditions] part of each campaign.toml",
        )
    if y.size > _MOST:
        raise UsageError(
            f"gauge R&R of {quantity} has too many measurements",
            value=y.size,
            allowed=f"up to {_MOST}",
            next_step="choose some of the devices",
        )


def _terms(part: IntArray, tester: IntArray, session: IntArray) -> dict[str, IntArray]:
    """The groups of each term that the design can have; a session of one name at two testers is two sessions."""
    within = _renumbered(tester * (session.max() + 1) + session)
    terms = {PART: part}
    if tester.max() > 0:
        terms[TESTER] = tester
    if within.max() > tester.max():
        terms[SESSION] = within
    if tester.max() > 0:
        terms[INTERACTION] = _renumbered(part * (tester.max() + 1) + tester)
    return terms


def _p_value(squares: MeanSquares) -> float:
    """p of the F test of part x tester; 1 where nothing is repeated, as it then cannot be told from the repeatability."""
    if REPEATABILITY not in squares.names:
        return 1.0
    k, error = squares.names.index(INTERACTION), len(squares.names) - 1
    if squares.mean[error] == 0.0:
        return 0.0
    return float(fdtrc(squares.df[k], squares.df[error], squares.mean[k] / squares.mean[error]))


def _study(
    quantity: str,
    y: FloatArray,
    codes: tuple[IntArray, IntArray, IntArray],
    squares: MeanSquares,
    variances: FloatArray,
    draws: FloatArray,
    limit: Limit | None,
    pooled: bool,
) -> GaugeStudy:
    own = dict(zip(squares.names, np.concatenate([variances, draws], axis=1), strict=True))
    nothing = np.zeros(1 + draws.shape[1])
    repeatability = own.get(REPEATABILITY, nothing)
    shown = [name for name in (TESTER, SESSION, INTERACTION) if name in own]
    reproducibility = sum((own[name] for name in shown), nothing)
    grr = repeatability + reproducibility
    total = grr + own.get(PART, nothing)
    table = {
        REPEATABILITY: repeatability,
        **{name: own[name] for name in shown},
        "reproducibility": reproducibility,
        "GRR": grr,
        PART: own.get(PART, nothing),
        "total variation": total,
    }
    df = dict(zip(squares.names, squares.df.astype(int).tolist(), strict=True))
    mean = float(np.mean(y))
    sigmas, width = _tolerance(limit, mean)
    with np.errstate(divide="ignore", invalid="ignore"):
        components = tuple(
            GaugeComponent(
                name,
                df.get(name),
                _interval(np.sqrt(v)),
                _interval(100.0 * np.sqrt(v / total)),
                None if width is None else _interval(100.0 * sigmas * np.sqrt(v) / width),
            )
            for name, v in table.items()
        )
        categories = _interval(1.41 * np.sqrt(table[PART] / grr))
    wanted = (PART, TESTER, SESSION, INTERACTION, REPEATABILITY)
    unknown = tuple(name for name in wanted if name not in own and not (pooled and name == INTERACTION))
    part, tester, session = codes
    parts, testers, sessions = (
        int(np.unique(one, axis=0).shape[0]) for one in (part, tester, np.stack([tester, session], 1))
    )
    return GaugeStudy(quantity, y.size, parts, testers, sessions, mean, components, categories, pooled, unknown)


def _tolerance(limit: Limit | None, mean: float) -> tuple[float, float | None]:
    """The sds that are compared with the tolerance, and its width; from the mean to the limit where there is one."""
    if limit is None:
        return 6.0, None
    if math.isfinite(limit.low) and math.isfinite(limit.high):
        return 6.0, limit.high - limit.low or None
    return 3.0, abs((limit.low if math.isfinite(limit.low) else limit.high) - mean) or None


def _interval(values: FloatArray) -> IntervalEstimate:
    """The first value, with sd and interval of the others."""
    known = values[1:][~np.isnan(values[1:])]
    if not known.size:
        return IntervalEstimate(float(values[0]), math.inf, 0.0, math.inf)
    low, high = np.quantile(known, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)], method="nearest")
    # Ratios and small degrees of freedom have no sd: half of the central 68 % is stated.
    spread = np.quantile(known, [0.1587, 0.8413], method="nearest")
    return IntervalEstimate(float(values[0]), 0.5 * float(spread[1] - spread[0]), float(low), float(high))
