"""Derivatives of the restricted likelihood of a lot, from its eliminated levels.

    g_c = 1/2 (y' P V_c P y - tr P V_c),     A_cd = 1/2 y' P V_c P V_d P y        in ln v_c

Shapes: n devices, q quantities, C random parts, B right-hand sides.  Source: see ``reml``.
"""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from .design import LotDesign
from .elimination import LotFactor, LotSolution, device_covariance, posterior_covariance, solved


def derivatives(factor: LotFactor, solution: LotSolution) -> tuple[FloatArray, FloatArray]:
    """Score (C,) and average information (C, C) in ln v, for the first right-hand side of ``solution``."""
    design = factor.design
    count = len(factor.variances)
    squares = squares_of(factor, solution)[:, 0]
    expected = np.zeros(count)
    wafer, lot, whole, _ = posterior_covariance(factor)
    for covariance, (low, high) in zip((wafer, lot, whole), _level_columns(design)):
        size = high - low
        variance = np.einsum("uii->i", covariance[:, :size, :size])
        np.add.at(expected, design.part[low:high], len(covariance) - variance)
    own = device_covariance(factor, wafer)
    for k, part in enumerate(design.own_part.tolist()):
        scaled = factor.white @ design.own[k] @ factor.white.transpose(0, 2, 1)
        expected[part] += factor.variances[part] * float(np.vdot(scaled, own))
    score = 0.5 * (squares - expected)
    worked = working_values(factor, solution)
    again = solved(factor, worked)
    back = np.einsum("nji,njb->nib", factor.white, design.unpadded(again.residual))
    information = 0.5 * np.einsum("nic,nid->cd", worked, back)
    return score, 0.5 * (information + information.T)


def _level_columns(design: LotDesign) -> tuple[tuple[int, int], ...]:
    a, b, c = design.ends
    return (0, a), (a, b), (b, c)


def squares_of(factor: LotFactor, solution: LotSolution) -> FloatArray:
    """(C, B) y' P V_c P y of each part, for each right-hand side."""
    design = factor.design
    found = np.zeros((len(factor.variances), solution.quadratic.size))
    for normals, (low, high) in zip(solution.normals, _level_columns(design)):
        np.add.at(found, design.part[low:high], np.einsum("urb,urb->rb", normals, normals))
    if len(design.own_part):
        back = np.einsum("nji,njb->nib", factor.white, design.unpadded(solution.residual))
        for k, part in enumerate(design.own_part.tolist()):
            found[part] += factor.variances[part] * np.einsum("nib,nib->b", back, design.own[k] @ back)
    return found


def working_values(factor: LotFactor, solution: LotSolution) -> FloatArray:
    """(n, q, C) V_c P y of each part, for the first right-hand side."""
    design = factor.design
    n, q = design.seen.shape
    found = np.zeros((n, q, len(factor.variances)))
    scale = np.where(design.part >= 0, np.sqrt(factor.variances[design.part]), 0.0)
    wafer_of = np.empty(n, dtype=np.int64)
    there = design.slots >= 0
    wafer_of[design.slots[there]] = np.nonzero(there)[0]
    units = (wafer_of, design.lot_of[wafer_of], np.zeros(n, dtype=np.int64))
    for normals, unit, (low, high) in zip(solution.normals, units, _level_columns(design)):
        for part in np.unique(design.part[low:high]).tolist():
            mine = low + np.flatnonzero(design.part[low:high] == part)
            own = normals[unit][:, mine - low, 0] * scale[mine]
            found[:, :, part] += np.einsum("nqr,nr->nq", design.columns[:, :, mine], own)
    back = np.einsum("nji,nj->ni", factor.white, design.unpadded(solution.residual)[..., 0])
    for k, part in enumerate(design.own_part.tolist()):
        found[:, :, part] += factor.variances[part] * np.einsum("nij,nj->ni", design.own[k], back)
    return found
