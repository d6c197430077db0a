"""The gate and the status of an estimate: does the model explain the records well enough for its sd to be believed?

    error            = rms((measured - model) / noise), full band, offset and hum lines removed and counted
    theta_bias_bound = sd(theta) sqrt(excess) sqrt(1 - s^2) / s,    excess = max(chi2 - dof - 3 sd(chi2), 0)

sd(chi2) is sqrt(2 dof) for white noise; it is larger where the level of coloured noise in the band is less well known.

The free parameters of a fit absorb most of the signature of a missing effect; at least the share s = 0.16 remains in the
residual (the smallest share of the library, that of damping drift).  The excess measures the part that remains.  The part
that was absorbed may have moved theta by up to the bound.  Error and bound do not depend on the number of samples N: sd
falls as 1/sqrt(N) while the excess grows as N.

Where the effects of the library were scored one by one (``screening.undetected``), the gate refuses a device in which one is
significant, or in which one that is not could still bias a quantity by more than the gate allows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

SURVIVING_SHARE = 0.16

#: Next step where the residual is louder than the noise and shows no effect: refine judges its structure in all records.
LOUDER = "run gyroscreen refine, which tells noise that is louder than measured from a missing effect"

Status = Literal["ok", "not_converged", "fit_failed", "misfit", "lost"]


@dataclass(frozen=True)
class Gate:
    """What makes a device a misfit.

    Parameters
    ----------
    error_max : largest ``error``.
    theta_bias_max_deg : largest bound on the bias of theta [deg].
    bias_max : quantity -> largest bias [its unit] that an undetected effect may cause.
    alpha : family-wise probability that an effect is found significant in a device that has none.
    """

    error_max: float = 1.1
    theta_bias_max_deg: float = 0.5
    bias_max: Mapping[str, float] = field(default_factory=dict)
    alpha: float = 1e-3


@dataclass(frozen=True, eq=False)
class Undetected:
    """What the residual of a device says about the effects that its model lacks.

    Parameters
    ----------
    effect, p_value : the most significant effect, and its family-wise p-value; "" and 1 where none was scored.
    bounds : quantity -> bound of the bias that an effect can cause, in its unit.
    causes : quantity -> the effect that could cause it.
    p_values : effect -> its own p-value.
    """

    effect: str
    p_value: float
    bounds: Mapping[str, float]
    causes: Mapping[str, str]
    p_values: Mapping[str, float]

    def columns(self) -> dict[str, float | str | None]:
        """Columns of the devices table."""
        bounds = {f"{quantity}_bias_bound": bound for quantity, bound in self.bounds.items()}
        return {"closest_effect": self.effect or None, "effect_p_value": self.p_value, **bounds}


@dataclass(frozen=True)
class GoodnessOfFit:
    """How well a model explains the records: full-band error, and chi2 with its degrees of freedom for the bias bound.

    ``chi2_sd`` is the sd of chi2 where the model is right; ``None`` is sqrt(2 dof).
    """

    error: float
    chi2: float
    dof: int
    chi2_sd: float | None = None

    @property
    def chi2_per_dof(self) -> float:
        """chi2 / dof."""
        return self.chi2 / self.dof

    def theta_bias_bound_deg(self, theta_sd_deg: float) -> float:
        """Bound on the bias of theta [deg] from the sd of theta [deg]; 0 without significant excess."""
        excess = max(self.chi2 - self.dof - 3.0 * (self.chi2_sd or math.sqrt(2.0 * self.dof)), 0.0)
        return theta_sd_deg * math.sqrt(excess * (1.0 - SURVIVING_SHARE**2)) / SURVIVING_SHARE


def _significant(found: Undetected, gate: Gate) -> str | None:
    if not found.p_value <= gate.alpha:
        return None
    p = f"p = {found.p_value:.2g}" if found.p_value > 0.0 else "p < 1e-300"
    return f"effect {found.effect} is significant ({p}): run gyroscreen diagnose"


def _biased(found: Undetected, gate: Gate) -> str | None:
    for quantity, most in {"theta_deg": gate.theta_bias_max_deg, **gate.bias_max}.items():
        bound = found.bounds.get(quantity, 0.0)
        if not bound <= most:
            return (
                f"an undetected {found.causes[quantity]} could bias {quantity} by {bound:.2g}, above {most:.2g}:"
                " run gyroscreen diagnose"
            )
    return None


def misfit_reason(
    goodness: GoodnessOfFit, theta_sd_deg: float | None, gate: Gate, found: Undetected | None = None
) -> str | None:
    """Why the gate refuses the fit, or ``None``.

    The bias of theta by the excess is judged only where the sd of theta [deg] is given, and effects where they were scored.
    """
    effect = None if found is None else _significant(found, gate)
    if not goodness.error <= gate.error_max:
        reason = f"error {goodness.error:.4g} above {gate.error_max:g}: the model does not explain the records"
        if found is None:
            return reason
        return f"{reason}; {effect or f'no effect of the library is significant: {LOUDER}'}"
    if effect is not None:
        return effect
    if found is not None and (biased := _biased(found, gate)) is not None:
        return biased
    if theta_sd_deg is None:
        return None
    bound = goodness.theta_bias_bound_deg(theta_sd_deg)
    if not bound <= gate.theta_bias_max_deg:
        return (
            f"an unmodelled effect of the size of the residual could bias theta by {bound:.2g} deg,"
            f" above {gate.theta_bias_max_deg:g} deg"
        )
    return None


def status_of(
    goodness: GoodnessOfFit | None,
    theta_sd_deg: float | None,
    gate: Gate,
    fit_failed: str | None = None,
    not_converged: str | None = None,
    found: Undetected | None = None,
) -> tuple[Status, str | None]:
    """Status of an estimate and its reason: fit_failed before misfit before not_converged before ok.

    Parameters
    ----------
    goodness : ``None`` where nothing independent of the fit shows the noise level; the gate is then not applied.
    theta_sd_deg : sd of theta [deg]; ``None`` where it is not known.
    gate : its limits.
    fit_failed, not_converged : why the fit failed, or why the posterior is not known well enough; ``None`` where not so.
    found : what is known of effects that the model lacks; ``None`` where they were not scored.
    """
    if fit_failed is not None:
        return "fit_failed", fit_failed
    misfit = None if goodness is None else misfit_reason(goodness, theta_sd_deg, gate, found)
    if misfit is not None:
        return "misfit", misfit
    if not_converged is not None:
        return "not_converged", not_converged
    return "ok", None
