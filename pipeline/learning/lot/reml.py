"""Restricted maximum likelihood of the variances of a lot's random parts.

    g_c = 1/2 (y' P V_c P y - tr P V_c)      in ln v_c, V_c the part of V that v_c multiplies
    A_cd = 1/2 y' P V_c P V_d P y            average information

Steps are Newton steps in ln v with A, damped until the likelihood rises.  A variance that falls to ``FLOOR`` of its start is at
its boundary, zero, and has an upper limit only.

Source: Gilmour, Thompson, Cullis, Biometrics 51 (1995) 1440 (average information); Satterthwaite, Biometrics Bull. 2 (1946) 110
(chi-square interval of a variance with matched moments).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2, norm

from ...arrays import BoolArray, FloatArray
from ...errors import MeasurementError
from .derivatives import derivatives
from .design import LotDesign, arranged
from .elimination import LotFactor, LotSolution, factorised, log_likelihood, solved
from .measured import MeasuredLot
from .model import LotModel

#: Variances are bounded to this factor below and above 1; below it a spread is 1e-4 of the one that its columns were made for.
FLOOR, CEILING = 1e-8, 1e8
STEPS = 60
#: The fit ends where a step would raise ln L by less than this: a variance is then within 1e-4 of its sd of the maximum.
TOLERANCE = 1e-10
#: Relative rounding of ln L: V spans 10 decades, and steps at the maximum lower ln L by as much.  Compared exactly, one lot in
#: four ended with a damping that only grew, and a fit at its maximum was reported as failed.
ROUNDING = 1e-9
#: Three steps in a row that raise ln L by less than this each end the fit, too: 2e-5 of what one sd of a parameter costs.
LEVEL = 2e-5
#: A fit that used all its steps has converged if the last ``SETTLED`` that counted raised ln L by less than ``LEVELLED``.
SETTLED, LEVELLED = 10, 5e-2
#: sd of v over that with all other variances known, above which the part shares a sum with others.
RIDGE = 1.5
#: Largest step of ln v that is drawn: a spread that one or two units determine may be anything.
MOST = 3.0
#: Likelihoods for one end of a profile.
ENDS = 10


@dataclass(frozen=True, eq=False)
class LotFit:
    """A fitted model.

    Parameters
    ----------
    lot, model : the data of the fit.
    variances : (C,) v of each random part.
    log_likelihood : restricted, at the end.
    information : (C, C) average information in ln v.
    score : (C,) derivative in ln v.
    converged : whether the last step was too small to matter.
    """

    lot: MeasuredLot
    design: LotDesign
    variances: FloatArray
    log_likelihood: float
    information: FloatArray
    score: FloatArray
    converged: bool

    @property
    def model(self) -> LotModel:
        """The model."""
        return self.design.model

    @cached_property
    def factor(self) -> LotFactor:
        """Factors of V."""
        return factorised(self.design, self.variances)

    @cached_property
    def solution(self) -> LotSolution:
        """Predictions for the measured values."""
        return solved(self.factor, centred(self.lot, self.model)[..., None])

    @property
    def at_zero(self) -> BoolArray:
        """(C,) whether a variance is at its boundary."""
        return np.asarray((self.variances <= 10.0 * FLOOR) | (self.score < 0.0) & (self.variances <= 1e-5))

    def at(self, variances: FloatArray) -> float:
        """Restricted log likelihood at other variances (C,)."""
        return _value(self.design, variances, self.lot)

    @cached_property
    def log_covariance(self) -> FloatArray:
        """(C, C) covariance of ln v; zero for those at the boundary."""
        free = np.flatnonzero(~self.at_zero & (np.diag(self.information) > 0.0))
        found = np.zeros_like(self.information)
        found[np.ix_(free, free)] = np.linalg.pinv(self.information[np.ix_(free, free)], rcond=1e-12, hermitian=True)
        return found

    def log_sd(self) -> FloatArray:
        """(C,) sd of ln v, infinite at the boundary."""
        variance = np.diag(self.log_covariance)
        return np.where(variance > 0.0, np.sqrt(np.maximum(variance, 0.0)), np.inf)

    @cached_property
    def _normalised(self) -> tuple[FloatArray, FloatArray]:
        """Information in v with a diagonal of 1 (C, C), and the root of its diagonal (C,), which does not vanish with v."""
        root = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        return self.information / np.outer(root, root), root / self.variances

    @cached_property
    def on_ridge(self) -> BoolArray:
        """(C,) whether a part shares a sum with others that are nearly alike, so that the sum alone is known."""
        inflation = np.diag(np.linalg.pinv(self._normalised[0], rcond=1e-10, hermitian=True))
        return np.asarray(np.sqrt(np.maximum(inflation, 0.0)) > RIDGE)

    def drawn(self, generator: np.random.Generator) -> FloatArray:
        """(C,) variances as well as they are known: nu v / chi2_nu as in ``interval``, correlated as ln v is by a normal copula;
        normal in v along a ridge, where the sum is linear in v."""
        values, vectors = np.linalg.eigh(self.log_covariance)
        step = vectors @ (np.sqrt(np.maximum(values, 0.0)) * generator.standard_normal(len(values)))
        sd = np.sqrt(np.maximum(np.diag(self.log_covariance), 1e-12))
        nu = 2.0 / sd**2
        ratio = nu / np.maximum(chi2.isf(norm.cdf(step / sd), nu), 1e-300)
        moved = np.where(self.on_ridge, np.maximum(1.0 + step, 0.0), np.clip(ratio, np.exp(-MOST), np.exp(MOST)))
        return np.asarray(np.clip(self.variances * moved, FLOOR, CEILING))

    def interval(self, level: float = 0.90) -> FloatArray:
        """(C, 2) interval of sqrt(v).

        nu v / chi2_nu with nu = 2 / Var(ln v), where few units of the level limit what is known.  At the boundary, and where
        parts that are nearly alike share a sum, the ends of the profile likelihood.
        """
        tail = 0.5 * (1.0 - level)
        drop = 0.5 * float(chi2.ppf(level, 1))
        found = np.empty((len(self.variances), 2))
        ridge = self.at_zero | self.on_ridge
        for k, (v, sd) in enumerate(zip(self.variances, self.log_sd())):
            if ridge[k] or not np.isfinite(sd):
                found[k] = self._end(k, drop, lower=True), self._end(k, drop, lower=False)
            else:
                nu = 2.0 / max(sd * sd, 1e-12)
                found[k] = np.sqrt(nu * v / np.maximum(chi2.ppf([1.0 - tail, tail], nu), 1e-12))
        return found

    def _end(self, k: int, drop: float, lower: bool) -> float:
        """sqrt(v_k) at which the profile of ln L has fallen by ``drop``; 0 or infinity where it does not."""
        v = float(self.variances[k])
        if lower and (v <= 10.0 * FLOOR or self._fall(k, FLOOR) < drop):
            return 0.0
        # Distances from v in the direction asked for: ``inside`` costs too little, ``outside`` too much.
        inside, outside = 0.0, v if lower else np.inf
        far = min(2.0 * v / np.sqrt(max(float(self.information[k, k]), 1e-300)), 0.5 * outside)
        for _ in range(ENDS):
            fall = self._fall(k, v - far if lower else v + far)
            if abs(fall - drop) < 0.1 * drop:
                break
            inside, outside = (far, outside) if fall < drop else (inside, far)
            # A parabola through the maximum and this point, or the middle where it leaves the bracket.
            guess = far * float(np.clip(np.sqrt(drop / max(fall, 1e-12)), 0.2, 5.0))
            far = guess if inside < guess < outside else 0.5 * (inside + outside)
            if far > CEILING:
                return float("inf")
        return float(np.sqrt(v - far if lower else v + far))

    def _fall(self, k: int, value: float) -> float:
        """Fall of ln L where v_k is ``value`` and the others follow, as their average information says."""
        v = self.variances
        matrix, scale = self._normalised
        steps = np.zeros_like(v)
        steps[k] = value - v[k]
        others = np.flatnonzero(np.arange(len(v)) != k)
        while others.size:
            given = np.setdiff1d(np.arange(len(v)), others)
            right = -matrix[np.ix_(others, given)] @ (scale[given] * steps[given])
            steps[others] = np.linalg.lstsq(matrix[np.ix_(others, others)], right, rcond=1e-9)[0] / scale[others]
            below = others[v[others] + steps[others] < 0.0]
            if not below.size:
                break
            # A variance that would become negative is zero, and the rest follow with it.
            steps[below] = FLOOR - v[below]
            others = np.setdiff1d(others, below)
        trial = v + steps
        try:
            return self.log_likelihood - _value(self.design, np.clip(trial, FLOOR, CEILING), self.lot)
        except np.linalg.LinAlgError:
            return float("inf")


def centred(lot: MeasuredLot, model: LotModel) -> FloatArray:
    """(n, q) values less the prediction of the population; zero where nothing was seen."""
    return np.where(lot.seen, np.nan_to_num(lot.values) - model.offset, 0.0)


def _value(design: LotDesign, variances: FloatArray, lot: MeasuredLot) -> float:
    factor = factorised(design, variances)
    solution = solved(factor, centred(lot, design.model)[..., None])
    return log_likelihood(factor, float(solution.quadratic[0]))


def fitted(lot: MeasuredLot, model: LotModel, start: FloatArray | None = None) -> LotFit:
    """Fit the variances of ``model`` to the devices of ``lot``; held-out wafers are not looked for here.

    Raises
    ------
    MeasurementError : V is singular, or a mean is not determined.
    """
    design = arranged(lot, model)
    y = centred(lot, model)[..., None]
    v = np.array([part.start for part in model.random]) if start is None else np.array(start, dtype=np.float64)
    v = np.clip(v, FLOOR, CEILING)
    damping, converged, level = 1e-3, False, 0
    values: list[float] = []
    try:
        factor = factorised(design, v)
    except np.linalg.LinAlgError:
        raise MeasurementError(
            f"lot {lot.name} does not determine the means of its quantities",
            value=", ".join(lot.quantities)[:120],
            allowed="quantities that were measured on wafers that are not held out, with a spread or an sd",
            next_step="leave a quantity out, or hold other wafers out with [hold]",
        ) from None
    solution = solved(factor, y)
    value = log_likelihood(factor, float(solution.quadratic[0]))
    values.append(value)
    score, information = derivatives(factor, solution)
    for _ in range(STEPS):
        free = ~((v <= FLOOR) & (score < 0.0)) & ~((v >= CEILING) & (score > 0.0))
        step = np.zeros_like(v)
        falling = _falling(v, score, information)
        if level >= 3:
            step[falling] = np.log(FLOOR)
        elif np.any(free):
            inner = information[np.ix_(free, free)]
            inner = inner + np.diag(damping * np.diag(inner) + 1e-6 + np.maximum(-score[free], 0.0) * 0.5)
            step[free] = np.clip(np.linalg.solve(inner, score[free]), -4.0, 2.0)
        trial = np.clip(v * np.exp(step), FLOOR, CEILING)
        promised = abs(float(np.vdot(score, np.log(trial / v))))
        if promised < TOLERANCE:
            # The derivative in ln v vanishes as v falls to zero, so that the last decades are jumped over.
            if not np.any(falling):
                converged = True
                break
            trial = np.where(falling, FLOOR, v)
        try:
            other = factorised(design, trial)
        except np.linalg.LinAlgError:  # variances so far apart that rounding makes V indefinite
            damping = max(damping * 10.0, 1e-2)
            continue
        found = solved(other, y)
        higher = log_likelihood(other, float(found.quadratic[0]))
        if higher > value - ROUNDING * abs(value):
            # Along a ridge of parts that are nearly alike, steps stay long while the likelihood is level.
            level = level + 1 if higher - value < LEVEL else 0
            v, factor, solution, value = trial, other, found, higher
            values.append(value)
            damping = max(damping / 5.0, 1e-6)
            score, information = derivatives(factor, solution)
            if level >= 3 and not np.any(_falling(v, score, information)):
                converged = True
                break
            if level >= 10:
                break
        else:
            damping = max(damping * 10.0, 1e-2)
            if damping > 1e6 or not np.any(step):
                converged = promised < LEVEL
                break
    # A ridge is level although its end is not reached: the parts there share a sum, which the interval says.
    converged = converged or value - values[-min(len(values), SETTLED)] < LEVELLED
    return LotFit(lot, design, v, value, information, score, converged)


def _falling(v: FloatArray, score: FloatArray, information: FloatArray) -> BoolArray:
    """(C,) small variances that the likelihood pushes to zero.

    On the way to zero the score vanishes with v and the information with v^2; at a maximum above zero the score alone vanishes.
    """
    return np.asarray((v > FLOOR) & (v < 1e-3) & (score < 0.0) & (np.diag(information) < -score))
