"""The estimate of a device: from parameter draws to result quantities, intervals and status.

    draws (n, 12)  ->  quantities q (n,)  ->  q, q_sd, q_q05, q_q95
    q_sd(theta), goodness of fit, gate  ->  status and its reason

Intervals of a quantity on the line: median, sd, 5 % and 95 % quantiles.  For an axis (theta, modulo 180 deg) the deviations from
the axial mean  1/2 arg <exp(2 i theta)>  are treated the same way and added to that mean; the interval is an arc that runs from
q05 up to q95 modulo 180.

Shapes: n draws, 12 parameters.  Units: those of ``pipeline.quantities``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.special import ndtri

from ..arrays import FloatArray, by_column
from ..axial import PERIOD_DEG, double_angle, wrap
from ..device.gyro import PHYSICAL, to_physical
from ..device.gyro import split_hz as cartesian_split_hz
from ..device.operation.bias import rate_biases_dps
from ..experiment.instrument import Pickoff
from ..experiment.systematic import EXACT, Systematic
from ..performance.figure import figure_values
from ..performance.operating_point import UNDECLARED, DeclaredOperation, OperatingPoint
from ..quantities import AXES
from .gate import Gate, GoodnessOfFit, Status, Undetected, status_of
from .moments import moments

_BIASES = ("quadrature_rate_dps", "quadrature_bias_dps", "inphase_bias_dps", "rate_bias_dps")


@dataclass(frozen=True)
class RateSettings:
    """Angular gain kappa = I_p / I_0p [1] (``None``: unknown, no rate biases), demodulation phase error [deg], mode driven.

    ``systematic`` are the standard deviations of both, and of what else all devices of the tester share.  ``operation``, the bias
    [V] of the identification and the kind of pick-off are what the performance figures need in addition.
    """

    angular_gain: float | FloatArray | None = None
    phase_error_deg: float | FloatArray = 0.0
    drive: Literal["f1", "f2"] = "f1"
    systematic: Systematic = EXACT
    operation: DeclaredOperation = UNDECLARED
    bias_v: float | None = None
    pickoff: Pickoff = "velocity"

    @property
    def point(self) -> OperatingPoint:
        """What the performance figures need beside the quantities."""
        return OperatingPoint(
            self.operation,
            self.angular_gain,
            self.bias_v or None,
            self.drive,
            self.pickoff == "displacement",
            self.systematic.tcf_ppm_per_c,
        )


@dataclass(frozen=True, eq=False)
class Estimate:
    """Quantities of a device, as its records determine them, in the units of ``pipeline.quantities``.

    Parameters
    ----------
    status, reason : of :func:`pipeline.inference.gate.status_of`.
    columns : <q>, <q>_sd, <q>_q05, <q>_q95 of every quantity, then chi2_per_dof and theta_bias_bound_deg where judged.
    draws : quantity -> (n,); nan where unknown; empty without a posterior.
    """

    status: Status
    reason: str | None
    columns: dict[str, float] = field(default_factory=dict)
    draws: dict[str, FloatArray] = field(default_factory=dict)


def quantities(physical: FloatArray, rate: RateSettings, split_hz: FloatArray | None = None) -> dict[str, FloatArray]:
    """All result quantities (...) by name; parameters and errors as for :func:`identified_quantities`."""
    named = identified_quantities(physical, rate, split_hz)
    return named | figure_values(named, rate.point)


def identified_quantities(
    physical: FloatArray, rate: RateSettings, split_hz: FloatArray | None = None
) -> dict[str, FloatArray]:
    """The quantities ``IDENTIFIED`` (...) by name of physical parameters (..., 12); without an angular gain rate biases are nan.

    Parameters
    ----------
    physical : (..., 12), the columns of ``pipeline.device.gyro.PHYSICAL``.
    rate : angular gain and demodulation.
    split_hz : (...) [Hz] where it is known better than the difference f2 - f1, which suffers from cancellation.

    Raises
    ------
    ConfigError : an angular gain that is not positive, or a phase error of 90 deg or more.
    """
    named = dict(zip(PHYSICAL, by_column(physical)))
    named["split_hz"] = named["f2_hz"] - named["f1_hz"] if split_hz is None else split_hz
    for i in (1, 2, 3):
        named[f"quality{i}"] = 0.5 / named[f"zeta{i}"]
    if rate.angular_gain is None:
        return named | dict.fromkeys(_BIASES, np.full(physical.shape[:-1], np.nan))
    return named | rate_biases_dps(physical, rate.angular_gain, rate.phase_error_deg, rate.drive)


def cartesian_quantities(x: FloatArray, rate: RateSettings) -> dict[str, FloatArray]:
    """As :func:`identified_quantities`, of cartesian parameters (..., 12) [units of ``device.gyro``]; exact split."""
    return identified_quantities(to_physical(x), rate, cartesian_split_hz(x))


def intervals(draws: Mapping[str, FloatArray]) -> dict[str, float]:
    """<q>, <q>_sd, <q>_q05, <q>_q95 [unit of q] of every quantity (n,); those that are nan in all draws are left out."""
    known = {name: values for name, values in draws.items() if values[0] == values[0] or not np.all(np.isnan(values))}
    lines = np.stack(list(known.values()))
    centre = np.zeros(len(known))
    for i, name in enumerate(known):
        if name in AXES:
            centre[i], lines[i] = _unwrapped(lines[i])
    found = _quantiles(lines) + centre
    _, variance = moments(lines)
    sd = np.sqrt(variance)
    out: dict[str, float] = {}
    for i, name in enumerate(known):
        q05, q50, q95 = wrap(found[:, i]) if name in AXES else found[:, i]
        out |= {name: float(q50), f"{name}_sd": float(sd[i]), f"{name}_q05": float(q05), f"{name}_q95": float(q95)}
    return out


def _unwrapped(axis_deg: FloatArray) -> tuple[float, FloatArray]:
    """The axial mean of an axis (n,) and the deviations from it, all [deg].

    Where no draw is farther than 45 deg from the first, that one is the centre: quantiles and sd then do not depend on it.
    """
    away = axis_deg - axis_deg[0]
    away -= PERIOD_DEG * np.rint(away / PERIOD_DEG)
    if np.max(np.abs(away)) < 45.0:
        return float(axis_deg[0]), away
    cos, sin = double_angle(axis_deg)
    centre = float(np.rad2deg(np.arctan2(np.mean(sin), np.mean(cos)))) / 2.0
    return centre, wrap(axis_deg - centre)


def _quantiles(lines: FloatArray) -> FloatArray:
    """5 %, 50 % and 95 % quantiles (3, Q) of lines (Q, n), those of ``numpy.quantile`` bit for bit in a third of its time."""
    n = lines.shape[1]
    at = np.array([0.05, 0.5, 0.95]) * (n - 1)
    below = np.floor(at).astype(np.int64)
    ordered, share = np.sort(lines, axis=1), at - below
    low, high = ordered[:, below], ordered[:, np.minimum(below + 1, n - 1)]
    found = np.where(share < 0.5, low + (high - low) * share, high - (high - low) * (1.0 - share))
    return np.asarray(np.where(np.isnan(ordered[:, -1:]), np.nan, found).T)


def normal_intervals(estimates: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """<q>, <q>_sd, <q>_q05, <q>_q95 [unit of q] of normal distributions, name -> (value, sd): value -+ 1.645 sd."""
    half = float(ndtri(0.95))
    out: dict[str, float] = {}
    for name, (value, sd) in estimates.items():
        out |= {name: value, f"{name}_sd": sd, f"{name}_q05": value - half * sd, f"{name}_q95": value + half * sd}
    return out


def estimate_from(
    draws: dict[str, FloatArray],
    goodness: GoodnessOfFit,
    gate: Gate,
    not_converged: str | None = None,
    found: Undetected | None = None,
) -> Estimate:
    """The estimate from draws of all quantities (n,) [units of ``pipeline.quantities``].

    Parameters
    ----------
    draws : of :func:`quantities` or :func:`cartesian_quantities`.
    goodness, gate : what decides on "misfit".
    not_converged : why the draws are too few or not mixed; ``None`` where they suffice.
    found : what is known of effects that the model lacks; ``None`` where they were not scored.
    """
    columns = intervals(draws)
    theta_sd_deg = columns["theta_deg_sd"]
    status, reason = status_of(goodness, theta_sd_deg, gate, None, not_converged, found)
    columns |= {
        "chi2_per_dof": goodness.chi2_per_dof,
        "theta_bias_bound_deg": goodness.theta_bias_bound_deg(theta_sd_deg),
    }
    return Estimate(status, reason, columns, draws)


def reference_comparison(
    reference: Mapping[str, tuple[float, float]], columns: Mapping[str, Any]
) -> dict[str, dict[str, float]]:
    """Each reference value against <q>, <q>_sd of ``columns``: both with sd, and z = difference / combined sd.

    Parameters
    ----------
    reference : quantity -> (value, sd), the [reference] table of a campaign.
    columns : of an estimate; quantities without value or sd are left out.
    """
    out: dict[str, dict[str, float]] = {}
    for name, (value, sd) in reference.items():
        found, found_sd = columns.get(name), columns.get(f"{name}_sd")
        if not isinstance(found, float) or not isinstance(found_sd, float):
            continue
        difference = found - value
        if name in AXES:
            difference = float(wrap(difference))
        combined = float(np.hypot(sd, found_sd))
        out[name] = {
            "reference": value,
            "reference_sd": sd,
            "posterior": found,
            "posterior_sd": found_sd,
            "z": difference / combined if combined > 0.0 else float("nan"),
        }
    return out
