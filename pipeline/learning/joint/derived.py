"""What follows from the parameters of a fit: quantities with their sd, and modes that are there twice."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...arrays import FloatArray
from ...criticism.problem import FitResult
from ...device.model import Model

#: Least distance of two modes of sweeps, responses and decays over the sum of their half widths: nearer ones have one peak.
#: With 3, as for chirps, 15 of 15 second modes at 1.5 to 3 widths were refused, whose fits were right (sweeps, seed 21).
_APART = 1.0


def derived_of(fit: FitResult, fixed: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Full width at half power 2 zeta f [Hz] of each mode; theta [deg] and split [Hz] of a gyro.

    Parameters
    ----------
    fit : its parameters are the columns of its Jacobian.
    fixed : values of the parameters that were not fitted.
    """
    names = list(fit.parameters)
    values = {**fixed, **{name: value for name, (value, _) in fit.parameters.items()}}
    covariance = _covariance(fit)

    def sd(gradient: Mapping[str, float]) -> float:
        g = np.array([gradient.get(name, 0.0) for name in names])
        return float(np.sqrt(max(float(g @ covariance @ g), 0.0)))

    found: dict[str, tuple[float, float]] = {}
    if {"f1_hz", "f2_hz", "theta_deg"} <= set(names):
        split = values["f2_hz"] - values["f1_hz"]
        found |= {"theta_deg": fit.parameters["theta_deg"], "split_hz": (split, sd({"f2_hz": 1.0, "f1_hz": -1.0}))}
    for name in values:
        zeta = f"zeta{name[1:-3]}"
        if name.endswith("_hz") and zeta in fit.parameters:
            f, z = values[name], values[zeta]
            found[f"width{name[1:-3]}_hz"] = (2.0 * z * f, sd({name: 2.0 * z, zeta: 2.0 * f}))
    return found


def duplicates(fit: FitResult, term: str, model: Model) -> bool:
    """Whether a term of a fit adds a mode in the resonance of a plant mode."""
    mode = model.library[term].mode if term in model.library else None
    values = {name: value for name, (value, _) in fit.parameters.items()}
    if mode is None or mode[0] not in values:
        return False
    f, zeta = values[mode[0]], values.get(mode[1], 0.0)
    others = [(values[n], values[f"zeta{n[1:-3]}"]) for n in values if f"zeta{n[1:-3]}" in values and n.endswith("_hz")]
    return any(abs(f - own) < _APART * (zeta * f + z * own) for own, z in others)


def _covariance(fit: FitResult) -> FloatArray:
    """(P, P) of the free parameters in their units, at the noise level of the rows or, where it is unknown, of the residual."""
    gram = sum((jac.T @ jac for jac in fit.jacobian), np.zeros((fit.jacobian[0].shape[1],) * 2))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    level = 1.0 if fit.noise_known else fit.chi2 / max(fit.dof, 1)
    return np.asarray(np.linalg.pinv(gram / np.outer(size, size), hermitian=True) / np.outer(size, size) * level)
