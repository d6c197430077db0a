"""The goodness-of-fit gate: does the model explain the record well enough for its sd to be believed?

    error            = rms((measured - model) / sigma), full band, offset (and hum lines) removed and counted
    theta_bias_bound = sd(theta) sqrt(excess) sqrt(1 - s^2) / s,   excess = chi2 - dof - 3 sqrt(2 dof), if positive

A fit hides most of a missing effect in its own parameters: of an effect's signature only a share s survives as residual
(0.16 for the worst of the library, damping drift).  What survives is seen as excess; what is hidden may have moved theta by
up to the bound.  Both are free of the number of samples N: sd falls as 1/sqrt(N) while the excess grows as N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..experiment.noise.lines import lines_removed, without_lines

SURVIVING_SHARE = 0.16


@dataclass(frozen=True)
class Gate:
    """Above ``error_max`` or ``theta_bias_max_deg`` a device is a misfit."""

    error_max: float = 1.1
    theta_bias_max_deg: float = 0.5


@dataclass(frozen=True)
class GoodnessOfFit:
    """How well a model explains a record; symbols at the head of the module."""

    error: float
    relative_error: float
    chi2_per_dof: float
    theta_bias_bound_deg: float


def theta_bias_bound_deg(theta_sd_deg: float, chi2: float, dof: int) -> float:
    """The bound of the head of the module [deg]; 0 without significant excess."""
    excess = max(chi2 - dof - 3.0 * math.sqrt(2.0 * dof), 0.0)
    return theta_sd_deg * math.sqrt(excess * (1.0 - SURVIVING_SHARE**2)) / SURVIVING_SHARE


def full_band_error(
    measured_v: FloatArray, model_v: FloatArray, sigma_v: FloatArray, sample_rate_hz: float, line_hz: float | None
) -> tuple[float, float]:
    """error and relative error of one record; measured and model (N, S) [V], sigma (S,) [V]."""
    rest = without_lines(measured_v - model_v, sample_rate_hz, line_hz)
    samples, senses = measured_v.shape
    dof = senses * (samples - lines_removed(samples, sample_rate_hz, line_hz))
    error = np.sqrt(np.sum((rest / sigma_v) ** 2) / dof)
    return float(error), float(np.linalg.norm(rest) / max(float(np.linalg.norm(measured_v)), 1e-300))


def misfit_reason(goodness: GoodnessOfFit, gate: Gate) -> str | None:
    """Why a device is a misfit, or ``None``."""
    if not goodness.error <= gate.error_max:
        return f"error {goodness.error:.4g} above {gate.error_max:g}: the model does not explain the record"
    if not goodness.theta_bias_bound_deg <= gate.theta_bias_max_deg:
        return (
            f"an unmodelled effect of the residual's size could bias theta by {goodness.theta_bias_bound_deg:.2g} deg,"
            f" above {gate.theta_bias_max_deg:g} deg"
        )
    return None
