"""What a fitted model says about devices that it has, and has not, seen.

    log score of the held-out devices      ln p(y_held | y_fit) = ln L(all) - ln L(fit),    both restricted, at the same v
    their squared error                    y' P y (all) - y' P y (fit)
    left-out residual of a device          e_i = P_ii^-1 (P y)_i,   Cov e_i = P_ii^-1

Source: Cook, Weisberg, Residuals and Influence in Regression (1982), ch. 2 (left-out residuals); Gneiting, Raftery, JASA 102
(2007) 359 (log score).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import kstest, norm

from ...arrays import BoolArray, FloatArray
from .design import LotDesign, arranged
from .elimination import LotFactor, device_covariance, factorised, log_likelihood, posterior_covariance, solved
from .measured import MeasuredLot
from .model import LotModel
from .null import projected
from .population import DeviceMixture
from .reml import centred

#: A device belongs to a mixture from this probability on.
LIKELY = 0.5


@dataclass(frozen=True)
class HeldOut:
    """Errors [sd] on the fitted and on the held-out devices, and the log score [nats] of a device."""

    error_fit: float
    error_validate: float | None
    log_score_fit: float
    log_score_validate: float | None


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Left-out residuals: (n, q) e, (n, q, q) covariance, both nan or identity where nothing was seen."""

    residual: FloatArray
    covariance: FloatArray
    seen: BoolArray

    @property
    def z(self) -> FloatArray:
        """(n, q) residual over its sd."""
        return np.where(self.seen, self.residual / np.sqrt(np.einsum("nii->ni", self.covariance)), np.nan)

    @property
    def squared(self) -> FloatArray:
        """(n,) Mahalanobis distance squared, chi-square with as many degrees of freedom as quantities were seen."""
        return np.asarray(
            np.einsum("ni,ni->n", self.residual, np.linalg.solve(self.covariance, self.residual[..., None])[..., 0])
        )


def evaluated(lot: MeasuredLot, model: LotModel, variances: FloatArray) -> tuple[LotDesign, LotFactor, float, float]:
    """Design, factors, log likelihood and y' P y of a model at given variances."""
    design = arranged(lot, model)
    factor = factorised(design, variances)
    quadratic = float(solved(factor, centred(lot, model)[..., None]).quadratic[0])
    return design, factor, log_likelihood(factor, quadratic), quadratic


def held_out(lot: MeasuredLot, model: LotModel, variances: FloatArray) -> HeldOut:
    """Errors and log scores at ``variances``; ``lot`` and ``model`` list the held-out devices, too."""
    held = lot.is_held
    fit = lot.subset(~held)
    design, _, value, square = evaluated(fit, model.subset(~held), variances)
    dof = design.rows - design.fixed
    error, score = float(np.sqrt(square / max(dof, 1))), value / len(fit.device)
    if not np.any(held):
        return HeldOut(error, None, score, None)
    whole, _, value_all, square_all = evaluated(lot, model, variances)
    rows = whole.rows - design.rows
    return HeldOut(
        error, float(np.sqrt(max(square_all - square, 0.0) / rows)), score, (value_all - value) / int(held.sum())
    )


def left_out(lot: MeasuredLot, model: LotModel, variances: FloatArray) -> LeftOut:
    """Each device against what all others say of it."""
    design = arranged(lot, model)
    factor = factorised(design, variances)
    solution = solved(factor, centred(lot, model)[..., None])
    p = projected(factor, solution)[..., 0]
    scaled = device_covariance(factor, posterior_covariance(factor)[0])
    own = factor.white.transpose(0, 2, 1) @ scaled @ factor.white
    covariance = np.linalg.inv(own)
    return LeftOut(
        np.asarray(np.einsum("nij,nj->ni", covariance, p)), np.asarray(covariance, dtype=np.float64), design.seen
    )


@dataclass(frozen=True)
class Calibration:
    """PIT of one quantity: sd of the left-out z, share inside the central 90 %, and p of a Kolmogorov-Smirnov test."""

    quantity: str
    sd: float
    inside_90: float
    p_value: float
    devices: int


def calibrations(lot: MeasuredLot, z: FloatArray) -> tuple[Calibration, ...]:
    """Of each quantity, from z (n, q).

    Devices of a wafer share its random parts, so the p-value is a guide and no exact level.
    """
    found = []
    for k, quantity in enumerate(lot.quantities):
        own = z[np.isfinite(z[:, k]), k]
        if own.size:
            test = kstest(norm.cdf(own), "uniform")
            inside = float(np.mean(np.abs(own) < norm.ppf(0.95)))
            found.append(Calibration(quantity, float(np.sqrt(np.mean(own**2))), inside, float(test.pvalue), own.size))
    return tuple(found)


def with_curvature(lot: MeasuredLot, curvature: FloatArray | None) -> MeasuredLot:
    """The lot with what the first order leaves out added to the measurement covariance."""
    return lot if curvature is None else replace(lot, covariance=lot.covariance + curvature)


def with_mixture(lot: MeasuredLot, mixture: DeviceMixture, chosen: BoolArray) -> MeasuredLot:
    """The lot with the change of the devices where ``chosen`` taken out: its mean from the values, its variance in addition."""
    spread = mixture.columns @ mixture.columns.transpose(0, 2, 1)
    return replace(
        lot,
        values=lot.values - np.where(chosen[:, None], mixture.mean, 0.0),
        covariance=lot.covariance + np.where(chosen[:, None, None], spread, 0.0),
    )


def members(lot: MeasuredLot, model: LotModel, variances: FloatArray, mixture: DeviceMixture) -> BoolArray:
    """(n,) devices that more likely than not belong to the mixture, each against what all others say of it."""
    out = left_out(lot, model, variances)
    spread = mixture.columns @ mixture.columns.transpose(0, 2, 1)
    moved = out.residual - mixture.mean
    wider = out.covariance + spread

    def log_density(e: FloatArray, c: FloatArray) -> FloatArray:
        square = np.einsum("ni,ni->n", e, np.linalg.solve(c, e[..., None])[..., 0])
        return np.asarray(-0.5 * (square + np.linalg.slogdet(c)[1]))

    odds = log_density(moved, wider) - log_density(out.residual, out.covariance)
    prior = np.log(mixture.share / max(1.0 - mixture.share, 1e-12))
    return np.asarray(odds + prior > np.log(LIKELY / (1.0 - LIKELY)))
