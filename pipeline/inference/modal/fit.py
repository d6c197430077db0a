"""Plant "gyro" without effects, fitted to a modal record.

A mode is (s R1 + R0)/d(s) in the record and R/(s - p) + conj in the model, so R1 = 2 Re R, R0 = -2 Re(R conj p).
The complex residues at resonance, C_i = i w_i R1_i + R0_i, are compared, each mode in units of its measured norm:

    relative_error^2 = 1/n sum_i |C_i - C_i(model)|^2 / |C_i|^2          over the n = 3 modes

Frequencies and damping ratios are those of the record.  Free parameters: theta, rocking and up-down gain, both imbalances.
The common relative sd of the residues is estimated from the residual r: sd^2 = |r|^2 / (24 - 5).

Shapes: n modes in the order of the record; S = D = 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...axial import wrap
from ...device.gyro import gyro_modes
from ...experiment.antialias import behind_filter
from ...experiment.instrument import AntiAlias
from ...identification.route import RouteResult

_FREE = ("theta_deg", "rocking_gain", "updown_gain", "sense_imbalance", "drive_imbalance")
_PLACES = (6, 8, 9, 10, 11)


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Values and sd by parameter name, relative error, and residuals (3, 2, 2) in units of each mode's norm."""

    values: dict[str, float]
    sd: dict[str, float]
    relative_error: float
    residuals: ComplexArray


def residues_at_resonance(poles: ComplexArray, residues: ComplexArray) -> ComplexArray:
    """C (n, S, D) [1/s^2] of modes R/(s - p) + conj at s = i |p|; poles (n,) [rad/s], residues (n, S, D) [1/s]."""
    r1 = 2.0 * residues.real
    r0 = -2.0 * np.real(residues * np.conj(poles)[:, None, None])
    return 1j * np.abs(poles)[:, None, None] * r1 + r0


def fit_modal(route: RouteResult, antialias: AntiAlias | None) -> ModalFit:
    """Fit plant "gyro" without effects to the modes of ``route``, by least squares (scipy).

    Parameters
    ----------
    route : of the record, by :func:`pipeline.identification.route.identify_modal`.
    antialias : the filter that the record includes.
    """
    # Loading scipy.optimize takes a fifth of a second.
    from scipy.optimize import least_squares

    measured = residues_at_resonance(route.poles, route.residues_filtered)
    norms = np.linalg.norm(measured, axis=(1, 2))[:, None, None]
    physical = np.zeros(12)
    physical[:3], physical[3:6] = route.f_hz, route.zeta

    def residuals(free: FloatArray) -> ComplexArray:
        trial = physical.copy()
        trial[list(_PLACES)] = free
        bank = behind_filter(gyro_modes(trial[None]), antialias)
        model = residues_at_resonance(bank.poles[0, :3], bank.residues[0, :3])
        return np.asarray((measured - model) / norms)

    def stacked(free: FloatArray) -> FloatArray:
        r = residuals(free).ravel()
        return np.concatenate([r.real, r.imag])

    rocking = np.linalg.norm(route.M[:2], axis=(1, 2)).mean() / 2.0
    start = [
        route.axes.mean_deg,
        rocking,
        np.linalg.norm(route.M[2]) / 2.0,
        route.gains.sense_imbalance,
        route.gains.drive_imbalance,
    ]
    found = least_squares(stacked, start, x_scale=[1.0, 1.0, 1.0, 0.01, 0.01], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    rest = residuals(found.x)
    squared = float(np.sum(np.abs(rest) ** 2))
    variance = squared / (2 * rest.size - len(_FREE))
    slope: FloatArray = np.asarray(found.jac, dtype=np.float64)
    covariance = variance * np.linalg.inv(slope.T @ slope)
    values = dict(zip(_FREE, (float(v) for v in found.x)))
    values["theta_deg"] = float(wrap(values["theta_deg"]))
    sd = dict(zip(_FREE, (float(v) for v in np.sqrt(np.diag(covariance)))))
    return ModalFit(values, sd, float(np.sqrt(squared / measured.shape[0])), rest)
